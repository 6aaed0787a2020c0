"""The keeper of a host: starts and ends processes of nodes there, as a launch on another machine says.

`ssh` starts it, and it is never started by hand. What it is told, and says, are frames, as between a supervisor and
its children (`hierax.runtime.launch.frames`), over its standard input and output:

    {"lost_after_s": 10.0}                       first: how long nothing may be heard until the launch is given up
    {"start": [{…}]}                             starts a process of a node, or of several; it has the first one's token
    {"to": PROCESS, "data": b"…"}                goes to that process's standard input
    {"signal": PROCESS, "number": 15}            9 goes to all that the process has started, too
    {}                                           the launch lives

    {"here": {…}}                                first: which hierax this is, and the two ends of the link
    {"started": PROCESS, "pid": 4711}
    {"from": PROCESS, "data": b"…"}              from that process's standard output
    {"printed": NODE, "line": "…"}               what libraries print, for the launch's log
    {"refused": "…"}                             who was refused a link by a process here
    {"ended": PROCESS, "code": 0}
    {}                                           the keeper lives

When the pipe ends, or nothing comes for too long, all processes are ended, and the keeper exits. What nodes print goes
to its standard error, which `ssh` carries as well.
"""

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from typing import Any

import anyio
import anyio.abc
from anyio.streams.memory import MemoryObjectReceiveStream, MemoryObjectSendStream

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.pacemaker import SteadyClock
from hierax.runtime.host.installed import installed_digest, installed_version
from hierax.runtime.host.streams import own_input, own_output
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, Overhearing, start_process
from hierax.runtime.launch.fork_server import ForkServer
from hierax.runtime.launch.frames import Frames, NodeOrder, frame, next_frames
from hierax.runtime.launch.keeper_link import MARK
from hierax.runtime.launch.pipes import write_whole
from hierax.runtime.transport.zenoh_session import remove_orphaned_segments
from hierax.schemas.values import Value

BEAT_S = 0.5  # how often each end says that it lives
LOOK_S = 0.2
KINDLY_S = 0.7  # how long processes may take to end by themselves when the launch is gone
MAX_LINES = 1024  # how many printed lines wait for the link; what is beyond is told on the console alone


def main() -> None:
    """Obey until the launch is gone."""
    words = own_output()
    orders = own_input()  # processes must not read what is meant for the keeper
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # of `sshd`: the end of the pipe says the same
    os.set_blocking(orders, False)
    os.set_blocking(words, False)
    try:
        with ForkServer().start() as forks:
            anyio.run(_run, orders, words, forks)
    finally:
        remove_orphaned_segments()


async def _run(orders: int, words: int, forks: ForkServer) -> None:
    async with anyio.create_task_group() as tasks:
        keeper = Keeper(tasks, orders, words, forks)
        try:
            await keeper.obey()
        finally:
            with anyio.CancelScope(shield=True):
                await keeper.end_all()
        tasks.cancel_scope.cancel()


class Keeper:
    """Keeps the processes of one launch on this host."""

    def __init__(self, tasks: anyio.abc.TaskGroup, orders: int, words: int, forks: ForkServer) -> None:
        self._tasks = tasks  # in which it listens to processes
        self._forks = forks  # has the processes forked
        self._orders, self._words = orders, words  # descriptors that do not block
        self._children: dict[str, Child] = {}
        self._queues: dict[str, MemoryObjectSendStream[bytes]] = {}
        self._overhearing = _Overhearing(self)
        self._saying = anyio.Lock()
        self._lines = 0
        self._heard_s = 0.0

    async def obey(self) -> None:
        """Do what comes, until nothing comes any more."""
        clock = SteadyClock()
        with anyio.CancelScope() as scope:
            await self._write(MARK)
            await self._say({"here": _here()})
            self._tasks.start_soon(self._beat)
            frames, lost_after_s = Frames(), float("inf")
            while not scope.cancel_called:
                values: list[Value] | None = None
                with anyio.move_on_after(LOOK_S):
                    values = await next_frames(self._orders, frames)
                now = clock()
                if values is None:
                    if now - self._heard_s > lost_after_s:
                        return
                    continue
                if not values:
                    return
                self._heard_s = now
                for value in values:
                    lost_after_s = value.get("lost_after_s", lost_after_s)
                    await self._do(value)

    async def end_all(self) -> None:
        """End every process: first kindly, then not."""
        for child in self._children.values():
            child.send_signal(signal.SIGTERM)
        with anyio.move_on_after(KINDLY_S):
            for child in list(self._children.values()):
                await child.process.wait()
        for child in self._children.values():
            child.kill()
        with anyio.move_on_after(END_TIMEOUT_S):
            for child in list(self._children.values()):
                await child.process.wait()

    async def _start(self, orders: Sequence[NodeOrder]) -> None:
        """Start a process. Where the system refuses one, that one alone has ended."""
        token = orders[0].process
        try:
            child = (await start_process(orders, self._overhearing, self._forks))[0]
        except HieraxError as error:
            print(f"hierax: {orders[0].name}: {error}", file=sys.stderr, flush=True)
            await self._say({"ended": token, "code": 1})
            return
        self._children[token] = child
        self._queues[token], queue = anyio.create_memory_object_stream[bytes](inf)
        self._tasks.start_soon(_feed, child, queue)
        self._tasks.start_soon(self._relay, child)

    async def _do(self, value: Mapping[str, Any]) -> None:
        if "start" in value:
            await self._start([_order(each) for each in value["start"]])
        elif "to" in value and value["to"] in self._children:
            self._queues[value["to"]].send_nowait(value["data"])
        elif "signal" in value and value["signal"] in self._children:
            child = self._children[value["signal"]]
            if value["number"] == signal.SIGKILL:
                child.kill()
            else:
                child.send_signal(signal.Signals(value["number"]))

    async def _relay(self, child: Child) -> None:
        """Pass on what a process says, until it ends."""

        async def pass_on(data: bytes) -> None:
            await self._say({"from": child.token, "data": data})

        await self._say({"started": child.token, "pid": child.process.pid})
        await child.listen(pass_on)
        del self._children[child.token]
        self._queues.pop(child.token).close()
        child.close()
        await self._say({"ended": child.token, "code": child.process.returncode})

    def print(self, line: Mapping[str, Value]) -> None:
        """A line that a library has printed, or what follows from it."""
        if self._lines < MAX_LINES:
            self._lines += 1
            self._tasks.start_soon(self._say_line, line)

    async def _say_line(self, line: Mapping[str, Value]) -> None:
        await self._say(dict(line))
        self._lines -= 1

    async def _beat(self) -> None:
        while True:
            await self._say({})
            await anyio.sleep(BEAT_S)

    async def _say(self, value: Value) -> None:
        await self._write(frame(value))

    async def _write(self, data: bytes) -> None:
        """Say it whole; who has more to say waits meanwhile, as do processes that say more than the link carries."""
        async with self._saying:
            with suppress(BrokenPipeError):  # the launch is gone, and what is read says so, too
                await write_whole(self._words, data)


def _order(value: Value) -> NodeOrder:
    order = NodeOrder.read(value)
    return replace(order, import_paths=tuple(map(os.path.abspath, order.import_paths)))


async def _feed(child: Child, queue: MemoryObjectReceiveStream[bytes]) -> None:
    """Pass on what a process is told; one that does not listen holds up nobody else."""
    with suppress(OSError):
        async for data in queue:
            await child.process.send(data)


class _Overhearing(Overhearing):
    """What processes print is shown here, and goes to the log of the launch, not to one of this host."""

    def __init__(self, keeper: Keeper) -> None:
        super().__init__("", lambda: 0)
        self._keeper = keeper

    def note(self, name: str, line: str) -> None:
        self._keeper.print({"printed": name, "line": line})

    def refused(self, what: str) -> None:
        self._keeper.print({"refused": what})


def _here() -> Value:
    """What is said first. `ssh` tells: address and port of the other end, then of this one."""
    ends = os.environ.get("SSH_CONNECTION", "").split()
    theirs, ours = (ends[0], ends[2]) if len(ends) == 4 else ("", "")
    return {
        "version": installed_version(),
        "digest": installed_digest(),
        "own_address": ours,
        "our_address": theirs,
    }


if __name__ == "__main__":
    main()
