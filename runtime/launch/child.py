"""A node's process as its supervisor sees it, and what libraries in C and programs print that the node starts.

The process has a pipe at its descriptors 1 and 2, which its supervisor reads: that is named, and in a log.
"""

import fcntl
import os
import signal
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import anyio
import anyio.abc

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch.fork_server import UNKNOWN, ForkServer
from hierax.runtime.launch.frames import CUT_OFF, DISMISSED, FAILED, RENEW, RENEWED, REPORT, UP, NodeOrder, frame
from hierax.runtime.launch.pipes import READ_BYTES
from hierax.runtime.watch.logs import OUTPUT, LaunchLog, log_of_run
from hierax.runtime.watch.prints import Console, Lines
from hierax.runtime.watch.refused import RefusedLinks, plain, tell_all
from hierax.schemas.values import Value

END_TIMEOUT_S = 1.5  # how long processes may take to end when the run is broken off

CHANNEL = "output"  # the logger's name in such entries
PIPE_BYTES = 1 << 20  # what is printed waits for a supervisor that is stopped, up to here; where there may be so much


class Overhearing:
    """Takes in what the processes of one supervisor print."""

    def __init__(self, run: str, epoch: Callable[[], int]) -> None:
        self._run = run  # its identification
        self._epoch = epoch  # asked at every line
        self._log: LaunchLog | None = None
        self.console = os.dup(2)  # a descriptor for what the processes say themselves; they inherit it
        self._out = Console(self.console)

    def of(self, name: str) -> "Overheard":
        """A pipe for a node's process."""
        links = RefusedLinks(self.refused, by=name)
        return Overheard(
            Lines(name, self._out, lambda line: self.note(name, line), lambda line: links.take(plain(line)))
        )

    def passed_on(self) -> Lines:
        """What takes in lines that are named already, and shows them as they are."""
        return Lines("", self._out, lambda line: None)

    def close(self) -> None:
        self._out.close()
        os.close(self.console)
        if self._log is not None:
            self._log.close()

    def refused(self, what: str) -> None:
        """Somebody was refused a link by a process of a node."""
        tell_all(what)

    def note(self, name: str, line: str) -> None:
        """Have the log hold a line that a node's process has printed."""
        if self._log is None:  # most nodes say nothing in this way
            self._log = log_of_run(self._run, f"{OUTPUT}{os.getpid()}", self._epoch)
        self._log.write(line, name, CHANNEL)


class Overheard:
    """Takes in what one process prints."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines  # take it
        self._is_heard = False
        self._reading, self.writing = os.pipe()
        os.set_blocking(self._reading, False)
        with suppress(OSError):
            fcntl.fcntl(self.writing, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    async def listen(self) -> None:
        """Take in what comes, until nobody has the pipe any more; at last, what is there."""
        self._is_heard = True
        try:
            while self._take():
                await anyio.wait_readable(self._reading)
        finally:
            self._is_heard = False
            self.close()

    def close(self) -> None:
        """Take in the last words of a process that has ended."""
        if self._reading < 0:
            return
        for _ in range(PIPE_BYTES // READ_BYTES):  # what a program that is still there says further is its own matter
            if not self._take():
                break
        if not self._is_heard:  # else who waits for the pipe closes it
            self._lines.end()
            os.close(self._reading)
            self._reading = -1

    def _take(self) -> bool:
        """Take in what is there; whether more may come."""
        try:
            data = os.read(self._reading, READ_BYTES)
        except BlockingIOError:
            return True
        self._lines.write(data)
        return bool(data)


class ProcessState(Enum):
    """Where a process is on its way through a run; a supervisor knows of each the one state that it is in."""

    STARTING = "it has not linked to its neighbours yet"
    UP = "it and its neighbours hear each other, or it has offered itself to the owner"
    LEAVING = "it has said its last word, and exits"
    ENDED = "it has ended, and all that it has said is taken in"
    RESTARTING = "it has ended, and another process is to come in its place"
    ELSEWHERE = "another supervisor has started it"
    CUT_OFF = "another supervisor has started it, and it cannot be reached"


class NodeFailedError(HieraxError):
    """A node's process failed or ended before the run was over."""

    def __init__(self, message: str, where: str = "") -> None:
        self.where = where  # path in the roster of what could not be loaded; may be empty
        super().__init__(message)


class NodeProcess(Protocol):
    """A process of nodes, here or on another host."""

    @property
    def pid(self) -> int:
        """Its number where it runs; 0: it is not known yet."""

    @property
    def returncode(self) -> int | None:
        """Its exit code, negative for a signal's; None: it has not ended, as far as is known."""

    async def wait(self) -> int:
        """Wait for its end; gives its exit code."""

    async def send(self, data: bytes) -> None:
        """Write to what it reads. Raises `OSError` if it does not read any more."""

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""

    def said(self) -> AsyncIterator[bytes]:
        """What it writes, as it comes, until nobody can write there any more."""

    def close(self) -> None:
        """Give up all that leads to it."""


@dataclass(eq=False)
class Child:
    """A node's process and what it has said; where nodes share a process, each is a child, and they are `mates`."""

    order: NodeOrder  # what it was started with
    process: NodeProcess  # its process
    overheard: Overheard  # what it prints, and programs that it has started
    state: ProcessState = ProcessState.STARTING  # where it is on its way
    renewals: int = 0  # how often its certificate was replaced by a new one
    came_up: bool = False  # whether it has ever been `ProcessState.UP`
    ended: anyio.Event = field(default_factory=anyio.Event)  # set when it is `ProcessState.ENDED`
    report: dict[str, Value] | None = None  # its last word
    failure: NodeFailedError | None = None  # why it cannot go on
    final: bool = False  # whether the run cannot, either
    dismissed: str = ""  # why the owner has told it to go
    culprit: str = ""  # why its supervisor has killed it
    placeless: bool = False  # whether it has ended before anybody here knew of its place in the roster, if it has one
    code: int | None = None  # of a node that has ended in a process in which others go on, its exit code
    mates: "list[Child]" = field(default_factory=list)  # all nodes of the process, if it is shared
    host: str = ""  # the host on which it runs; empty: this one, which has no name
    gone: str = ""  # how it was lost with its host

    @property
    def name(self) -> str:
        return self.order.name

    @property
    def token(self) -> str:
        return self.order.process

    @property
    def is_up(self) -> bool:
        return self.state is ProcessState.UP

    @property
    def alive(self) -> bool:
        """Whether it has not ended yet, as far as anybody has noticed."""
        return self.returncode is None

    @property
    def returncode(self) -> int | None:
        return self.process.returncode if self.code is None else self.code

    def take(self, value: Mapping[str, Any]) -> bool:
        """Take in what the process says of itself; whether it was that."""
        status = value["status"]
        if status == UP:
            self.state, self.came_up = ProcessState.UP, True
            return True
        if status == REPORT:
            self.report = dict(value)
        elif status == FAILED:
            self.failure = NodeFailedError(value["message"], value["where"])
            self.final = value["final"]
        elif status == RENEWED:
            self.renewals += 1
            return True
        elif status == DISMISSED:
            self.dismissed = value["why"]
        elif status == CUT_OFF:
            self.culprit = value["why"]
        else:
            return False
        self.state = ProcessState.LEAVING
        return True

    def renewed_secret(self) -> str:
        """What it is to go on with: a certificate that is new."""
        return self.order.admitted().secret

    async def renew(self, secret: str) -> None:
        """Tell it to go on with another certificate, which is in this secret."""
        await self.send({RENEW: secret})

    async def send(self, value: Value) -> bool:
        """Send it a command; whether it listens."""
        return await self.say((self.token, value))

    async def say(self, value: Value) -> bool:
        """Say something to its process; whether that listens."""
        try:
            await self.process.send(frame(value))
        except OSError:
            return False
        return True

    def send_signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def _kill_group(self) -> None:
        """A node's process leads a group, with the programs that the node has started."""
        with suppress(ProcessLookupError):  # all have ended by themselves
            os.killpg(self.process.pid, signal.SIGKILL)

    def kill(self) -> None:
        """Kill the process, with all its nodes; one that has left it is gone already."""
        if self.code is not None:
            return
        if self.alive:  # it still stands for its group
            self._kill_group()
        self.send_signal(signal.SIGKILL)

    @property
    def leads(self) -> bool:
        """Whether it stands for its process, where nodes share it."""
        return not self.mates or self.mates[0] is self

    @property
    def is_silent(self) -> bool:
        """Whether its host says nothing at this moment."""
        return False

    @property
    def is_far(self) -> bool:
        """Whether what it says comes from another machine, which may be somebody else's by now."""
        return False

    def release(self) -> None:
        """Let go of what is held for the node: its process has ended, and another one may come."""

    def close(self) -> None:
        """Give up what the process is held by."""
        if self.leads:
            self.overheard.close()
            self.process.close()

    async def listen(self, take: Callable[[bytes], Awaitable[None]]) -> None:
        """Take in what the process says and prints, until it has ended."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self.cut_off, tasks.cancel_scope)
            tasks.start_soon(self.overheard.listen)
            async for data in self.process.said():
                await take(data)
            with anyio.move_on_after(END_TIMEOUT_S):
                await self.process.wait()
            tasks.cancel_scope.cancel()

    async def cut_off(self, listening: anyio.CancelScope) -> None:
        """What a node has started ends with the node, or it might hold the pipes open, so that no end of them comes.

        Who has forked it has killed it before its number was given back; who was lost could not."""
        if await self.process.wait() == UNKNOWN:
            self._kill_group()
        await anyio.sleep(END_TIMEOUT_S)
        listening.cancel()

    @property
    def was_killed(self) -> bool:
        """Whether it has ended by a signal, with no word of why it could not go on."""
        return self.failure is None and (self.returncode or 0) < 0

    @property
    def last_words(self) -> NodeFailedError:
        """Why it has ended: what it said itself, or else how."""
        return self.failure or NodeFailedError(f"{self.name}: its process ended {self.how}")

    def not_started_again(self, terms: str) -> NodeFailedError:
        """Why the run ends with it: what it said itself, or else how and why it has ended, and by which terms no other
        process comes."""
        why = f" ({self.culprit})" if self.culprit else ""
        what = f"{self.name}: its process ended {self.how}{why}; it is not started again ({terms})"
        return self.failure or NodeFailedError(what)

    def failed_as(self, why: str) -> NodeFailedError:
        """Why the run ends with this node: what it said itself, or else what its owner says, and the host it was on."""
        return self.failure or NodeFailedError(f"{why}; its process ended {self.gone}" if self.gone else why)

    @property
    def how(self) -> str:
        """How it has ended."""
        return self.gone or how_ended(self.returncode)


async def start_process(orders: Sequence[NodeOrder], overhearing: Overhearing, forks: ForkServer) -> list[Child]:
    """Start a process, mostly of one node."""
    overheard = overhearing.of(orders[0].shares or orders[0].name)
    try:
        process = await forks.fork(overheard.writing, overhearing.console)
    except BaseException:
        overheard.close()
        raise
    finally:
        os.close(overheard.writing)
    children = [Child(order, process, overheard) for order in orders]
    for child in children if len(children) > 1 else ():
        child.mates = children
    await children[0].say([order.admitted().plain() for order in orders])
    return children


def how_ended(code: int | None) -> str:
    if code is None:
        return "without an exit code"
    if code >= 0:
        return f"with exit code {code}"
    try:
        return f"by signal {signal.Signals(-code).name}"
    except ValueError:  # most of the real-time ones have no names
        return f"by signal {-code}"


class Restarts:
    """Whether and when another process takes the place of one that has ended."""

    def __init__(self, terms: ProcessTerms) -> None:
        self._terms = terms  # of the node
        self._times: deque[float] = deque()
        self.count = 0
        self.refused = ""  # by which terms there was none, the last time

    def delay_s(self, child: Child) -> float | None:
        """After which delay the next process is started; None: there is none.

        A process that says itself why it cannot go on (an operator has raised) is started
        again only by ``always``: the epoch would be done again with the same inputs.
        """
        terms = self._terms
        failed = child.returncode != 0 or bool(child.culprit)
        self.refused = f"restart_policy: {terms.restart_policy}"
        if terms.restart_policy == "never":
            return None
        if terms.restart_policy == "on-failure" and (not failed or child.failure is not None):
            return None
        now = time.monotonic()
        while self._times and terms.restart_window_s is not None and now - self._times[0] > terms.restart_window_s:
            self._times.popleft()
        if terms.max_restarts and len(self._times) >= terms.max_restarts:
            window = "" if terms.restart_window_s is None else f" in {terms.restart_window_s:g} s"
            self.refused = f"max_restarts: {terms.max_restarts}{window}"
            return None
        delay = min(terms.restart_delay_s * 2 ** min(len(self._times), 60), terms.max_restart_delay_s)
        self._times.append(now)
        self.count += 1
        return 0.0 if self.count == 1 else delay
