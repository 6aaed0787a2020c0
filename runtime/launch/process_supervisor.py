"""The supervisor of processes: of those of a launch, and of those that are attached to one from elsewhere."""

import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import anyio
import anyio.abc

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, Overhearing, ProcessState, Restarts
from hierax.runtime.launch.frames import ENDED, Frames, NodeOrder
from hierax.schemas.errors import SchemaError

Notify = Callable[[str], None]  # tells people what happens
Fail = Callable[[Exception], None]  # is called with why the processes cannot go on

PAST = 64  # how many processes that are past are remembered: of those that have just ended something may still be said


@dataclass(eq=False)
class ProcessSupervisor(ABC):
    """Starts processes of nodes, listens to them until they end, and ends those that are left."""

    tasks: anyio.abc.TaskGroup  # in which it listens
    overhearing: Overhearing  # takes in what the processes print; to be closed when nobody listens any more
    terms: Callable[[str], ProcessTerms]  # by a node's name, what is done when its process ends
    notify: Notify  # tells people what happens
    fail: Fail  # called with why the processes cannot go on

    def __post_init__(self) -> None:
        self.ending = False  # whether processes may end from now on
        self._children: dict[str, Child] = {}
        self._restarts: dict[str, Restarts] = {}

    @property
    def children(self) -> list[Child]:
        return list(self._children.values())

    def child(self, token: str) -> Child | None:
        """The process with a token, if it was started here."""
        return self._children.get(token)

    def restarts_of(self, name: str) -> int:
        return self._restarts[name].count if name in self._restarts else 0

    async def start(self, order: NodeOrder) -> Child:
        """Start a node's process, and listen to it from now on."""
        return (await self.start_together([order]))[0]

    async def start_together(self, orders: Sequence[NodeOrder]) -> list[Child]:
        """Start a process that nodes share, and listen to it from now on."""
        children = await self._begin(orders)
        self._forget_past()
        for child in children:
            self._children[child.token] = child
            self._restarts.setdefault(child.name, Restarts(self.terms(child.name)))
        self.tasks.start_soon(self._listen, children)
        return children

    def _forget_past(self) -> None:
        """Forget processes that are past but for the last ones: a run may have any number of them."""
        past = [token for token, child in self._children.items() if self._is_past(child)]
        for token in past[: max(len(past) - PAST, 0)]:
            del self._children[token]

    def _is_past(self, child: Child) -> bool:
        """Whether a process has ended, without a report, and nobody counts on it any more."""
        return child.ended.is_set() and child.state is ProcessState.ENDED and child.report is None

    async def end_all(self, timeout_s: float = END_TIMEOUT_S) -> None:
        """End every process that is left: first kindly, then not; for the first, each has this time."""
        self.ending = True
        for child in self.children:
            if child.leads:
                child.send_signal(signal.SIGTERM)
        await self._wait_for_all(timeout_s)
        await self.kill_all()

    async def kill_all(self) -> None:
        for child in self.children:
            child.kill()
        await self._wait_for_all(END_TIMEOUT_S)

    def close(self) -> None:
        for child in self.children:
            child.close()

    async def _wait_for_all(self, timeout_s: float) -> None:
        """Bounded, as a program that a node has started may hold its pipes open when the node is gone."""
        with anyio.move_on_after(timeout_s):
            for child in self.children:
                await child.process.wait()

    async def _listen(self, children: Sequence[Child]) -> None:
        frames, by_token = Frames(), {child.token: child for child in children}
        is_garbled = False

        async def take(data: bytes) -> None:
            nonlocal is_garbled
            try:
                for value in () if is_garbled else frames.feed(data):
                    self._hear(by_token[value["from"]], value)
            except HieraxError:
                raise
            except Exception as error:  # a host may say anything
                if not children[0].is_far:
                    raise
                is_garbled = True
                self._give_up(children, error)

        await children[0].listen(take)
        if children[0].process.returncode is not None:  # else it has to be killed at the end
            children[0].close()  # now: a run may have any number of processes, one after the other
        await self._on_ends([child for child in children if child.code is None])

    def _hear(self, child: Child, value: dict[str, Any]) -> None:
        if value["status"] == ENDED:
            child.code = int(value["code"])
            self.tasks.start_soon(self._on_ends, [child])
        elif not child.take(value):
            self._take(child, value)

    def _give_up(self, children: Sequence[Child], error: Exception) -> None:
        """What a process on another host says cannot be read, nor what it would say further: it counts as lost."""
        first = children[0]
        what = f"what it says cannot be read ({type(error).__name__}: {error})"
        self.notify(f"{first.order.shares or first.name}: its process on host {first.host} is killed: {what}")
        for child in children:
            child.kill()

    async def _on_ends(self, children: Sequence[Child]) -> None:
        for child in children:
            child.state = ProcessState.ENDED
            child.release()
            child.ended.set()
        lost = [child for child in children if child.report is None]
        if lost and not self.ending:
            try:
                await self._on_end_together(lost)
            except (HieraxError, SchemaError) as error:  # no other can be started in its place
                self.fail(error)

    async def _on_end_together(self, children: Sequence[Child]) -> None:
        """A process has ended before its time, with these of its nodes; all that they said is taken in."""
        for child in children:
            await self._on_end(child)

    @abstractmethod
    async def _begin(self, orders: Sequence[NodeOrder]) -> list[Child]:
        """Start the process of some orders, wherever it is to run."""

    @abstractmethod
    def _take(self, child: Child, value: dict[str, Any]) -> None:
        """Take in what a process says that is not about itself."""

    @abstractmethod
    async def _on_end(self, child: Child) -> None:
        """A node's process has ended before its time; all that it said is taken in."""
