"""Processes of nodes, forked from one that has imported what they need: each is there within milliseconds, and shares
that memory with the others."""

import os
import select
import signal
import socket
import struct
import subprocess
from collections.abc import AsyncIterator
from contextlib import ExitStack, suppress

import anyio

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import python_module, started_deaf
from hierax.runtime.launch.pipes import read_some, write_whole

FORKING = "hierax.runtime.launch.forking"
UNKNOWN = 255  # the exit code where nobody can tell it any more
NUMBER = struct.Struct("<q")  # of a process, or its exit code, negative for a signal's; of the error if there is none
FORK = b"f"
DESCRIPTORS = 5  # that go with it: life, orders, status, what is printed, console

_TRIES = 3
_GIVEN_UP = "its process has been given up"
_END_S = 3.0  # longer than those that it has forked may take when it is left (`forking.LEFT_S`)


class ForkServer:
    """Has processes of nodes forked. What they are forked from is started by `start`, with this process's environment,
    folder and import path, and again where it was killed; it ends with this process, or when this is closed."""

    def __init__(self) -> None:
        self._line: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._was_asked = False  # whether it may have forked something

    def start(self) -> "ForkServer":
        """Start it, unless it is there; it imports while this process goes on."""
        if self._line is not None:
            return self
        line, its_line = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with its_line, started_deaf():
            self._process = subprocess.Popen(
                python_module(FORKING, str(its_line.fileno())),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                pass_fds=(its_line.fileno(),),
            )
        self._line = line
        return self

    async def fork(self, printed: int, console: int) -> "ForkedProcess":
        """A process of a node, which reads its order from what `ForkedProcess.send` gives.

        Args: printed: descriptor to which it, and what it starts, print; console: that of its own words.
        Raises HieraxError: what it is forked from ends again and again, or the system has no room for a process."""
        for _ in range(_TRIES):
            self.start()
            forked = await self._forked(printed, console)
            if forked is not None:
                return forked
            self.close()
        raise HieraxError(f"no process can be started: {FORKING} has ended {_TRIES} times")

    def close(self) -> None:
        """Have no more forked; for when those that were have ended."""
        if self._line is None or self._process is None:
            return
        self._line.close()
        if not self._was_asked:  # it may import still, for nobody
            self._process.kill()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._line = self._process = None
        self._was_asked = False

    def __enter__(self) -> "ForkServer":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    async def _forked(self, printed: int, console: int) -> "ForkedProcess | None":
        """A process; None: there is nobody who forks it."""
        assert self._line is not None
        self._was_asked = True
        life, its_life = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        life.setblocking(False)
        its_orders, orders = os.pipe()
        told, its_told = os.pipe()
        with ExitStack() as unused:
            unused.callback(life.close)
            unused.callback(os.close, orders)
            unused.callback(os.close, told)
            try:
                socket.send_fds(self._line, [FORK], [its_life.fileno(), its_orders, its_told, printed, console])
            except OSError:
                return None
            finally:
                its_life.close()
                os.close(its_orders)
                os.close(its_told)
            await anyio.wait_readable(life)
            with suppress(ConnectionError):
                number, handles, _, _ = socket.recv_fds(life, NUMBER.size, 1)
                if handles:
                    unused.pop_all()
                    return ForkedProcess(NUMBER.unpack(number)[0], handles[0], life, orders, told)
                if number:
                    raise HieraxError(f"no process can be started: {os.strerror(NUMBER.unpack(number)[0])}")
        return None


class ForkedProcess:
    """A process of a node as its supervisor has it, who has to `close` it.

    Args:
        pid: its number.
        handle: a descriptor that stands for it; signals go through it, as it never means another process.
        life: where its exit code comes, once it has ended.
        orders, told: descriptors of what it reads, and what it writes.
    """

    def __init__(self, pid: int, handle: int, life: socket.socket, orders: int, told: int) -> None:
        self.pid, self._handle = pid, handle
        self._end = select.poll()
        self._end.register(handle, select.POLLIN)
        self._life, self._orders, self._told = life, orders, told
        self._code: int | None = None
        self._is_open = True
        self._sending, self._waiting = anyio.Lock(), anyio.Lock()
        os.set_blocking(orders, False)

    @property
    def returncode(self) -> int | None:
        """Its exit code, negative for a signal's; None: it has not ended, as far as is known."""
        if self._code is None and self._is_open and self._end.poll(0):
            with suppress(BlockingIOError):
                self._code = self._take_code()
        return self._code

    async def wait(self) -> int:
        """Wait for its end."""
        async with self._waiting:
            while (code := self.returncode) is None:
                await anyio.wait_readable(self._handle)
                await anyio.wait_readable(self._life)
        return code

    async def send(self, data: bytes) -> None:
        """Write to what it reads. Raises OSError: it does not read any more."""
        async with self._sending:
            if not self._is_open:  # the descriptor's number may be that of something else
                raise BrokenPipeError(_GIVEN_UP)
            try:
                await write_whole(self._orders, data)
            except anyio.ClosedResourceError:
                raise BrokenPipeError(_GIVEN_UP) from None

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        with suppress(ProcessLookupError):
            if self._is_open:
                signal.pidfd_send_signal(self._handle, number)

    async def said(self) -> AsyncIterator[bytes]:
        """What it writes, as it comes, until nobody can write there any more."""
        while data := await read_some(self._told):
            yield data

    def close(self) -> None:
        """Give up all that leads to it; of one that has not ended, nobody can tell its exit code any more."""
        if self._is_open:
            self._code = UNKNOWN if self.returncode is None else self._code
            self._is_open = False
            anyio.notify_closing(self._orders)  # who waits until there is room is not to wait for ever
            self._life.close()
            for descriptor in (self._orders, self._told, self._handle):
                os.close(descriptor)

    def _take_code(self) -> int:
        try:
            data = self._life.recv(NUMBER.size)
        except ConnectionError:
            data = b""
        return int(NUMBER.unpack(data)[0]) if data else UNKNOWN  # who forked it was killed
