"""The processes of a launch: what they say, and what follows when one ends before its time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from secrets import token_hex
from typing import Any

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.deployment.deployment import RestartPolicy
from hierax.runtime.launch.child import END_TIMEOUT_S, Child, NodeFailedError, Restarts, start_child
from hierax.runtime.launch.frames import (
    ANSWER,
    BEAT,
    DISMISS,
    DISMISSED,
    END,
    FINISHED,
    HALT,
    MISSES,
    NEWCOMER,
    NOTE,
    STOP,
    Frames,
    NodeOrder,
)
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.overheard import Overhearing
from hierax.runtime.launch.requests import Requests
from hierax.runtime.launch.steady import SteadyClock
from hierax.runtime.owner.effects import DETACH
from hierax.schemas.control import Census, Control, Dismiss, Lost, encode_control
from hierax.schemas.roster import Roster

BEAT_S = 0.2
"""How often the world's process says something."""

POLL_S = 0.01
"""How often it is looked whether all processes are up."""

COMES_BACK_S = 0.5
"""How long a process that is kept elsewhere may be gone: where the hub was stopped, all seem to be for a moment."""

SILENCE_S = 1.0
"""How long it may say nothing, beyond the epoch's deadline."""


class ProcessSupervisor:
    """Keeps the processes of a launch: starts them, listens to them, and has others come in their place.

    Args:
        orders: what they are started with.
        say: tells people what happens.
        fail: called with why the run cannot go on.

    Attributes:
        tasks: in which everything runs; to be set before the first process is started.
        dismiss_elsewhere: tells a process that is kept elsewhere that it has no place any more, why, and whether
            another one is to come; to be set likewise.
        hears_of: whether a process, by its token, is linked to the hub; to be set likewise.
        introduce: has processes link again of which one misses this other one; to be set likewise.
        begun: set when the run has begun: the world has recorded that, or goes on with a record.
        finished: set when the world has committed its last epoch.
        ending: whether processes may end from now on.
        members: the processes of the roster in force, by node, as the world said last.
        epoch, version, instances: the last committed epoch and the roster's numbers, likewise.
        requests: what others ask for.
        overhearing: of what the processes print.
    """

    tasks: anyio.abc.TaskGroup
    introduce: Callable[[str], None]
    hears_of: Callable[[str], bool]
    dismiss_elsewhere: Callable[[str, str, bool], None]

    def __init__(self, orders: Orders, say: Callable[[str], None], fail: Callable[[Exception], None]) -> None:
        self.orders = orders
        self._say = say
        self._fail = fail
        self._world = orders.deployment.roster.world
        self._children: dict[str, Child] = {}
        self._current: dict[str, Child] = {}
        self._restarts: dict[str, Restarts] = {}
        self._gone: set[str] = set()
        self._coming: set[str] = set()
        self._last_roster: Roster | None = None
        self._heard_s = 0.0
        self._told: Child | None = None
        self._clock = SteadyClock()
        self._beat = anyio.Event()
        self.begun = anyio.Event()
        self.finished = anyio.Event()
        self.ending = False
        self.members: Mapping[str, str] = {}
        self.epoch = 0
        self.version = 0
        self.instances: Mapping[str, int] = {}
        self.requests = Requests(self)
        self.overhearing = Overhearing(orders.run_id, lambda: self.epoch)

    @property
    def children(self) -> list[Child]:
        """All processes that were ever started."""
        return list(self._children.values())

    @property
    def current(self) -> Mapping[str, Child]:
        """The last process of each node."""
        return dict(self._current)

    async def start(self, order: NodeOrder) -> Child:
        """Start a node's process."""
        child = await start_child(order, self.overhearing)
        self._children[child.token] = child
        if order.life != NEWCOMER:
            self._current[child.name] = child
        self._restarts.setdefault(child.name, Restarts(self.orders.policy(child.name)))
        self.tasks.start_soon(self._listen, child)
        return child

    async def begin(self, timeout_s: float) -> list[str]:
        """Wait until all processes are up, and have the world begin the run with those that there are then.

        Until it has, a process that is killed is started anew, and shakes hands anew.

        Args:
            timeout_s: how long they may take.

        Returns:
            The nodes that were not up in time.
        """
        clock = SteadyClock()
        patience = clock() + timeout_s
        while True:
            late = [name for name, child in self._current.items() if self._is_late(child)]
            if not late and self.begun.is_set():
                return []
            if not late and self._told is not self._current[self._world]:
                self._told = self._current[self._world]
                await self.tell_owner(Census({name: child.token for name, child in self._current.items()}))
            if clock() > patience:
                return late or [self._world]
            await anyio.sleep(POLL_S)

    def _is_late(self, child: Child) -> bool:
        if self.begun.is_set():
            return not child.up.is_set() and (child.name in self._coming or not child.heard.is_set())
        return not child.up.is_set() or child.heard.is_set()

    @property
    def present(self) -> list[Child]:
        """The processes of the roster in force that are kept here."""
        return [child for child in self._children.values() if self.members.get(child.name) == child.token]

    async def wait_for_all(self, timeout_s: float = END_TIMEOUT_S) -> None:
        """Bounded, as a program that a node has started may hold its pipes open when the node is gone."""
        with anyio.move_on_after(timeout_s):
            for child in list(self._children.values()):
                await child.process.wait()

    # --- what the processes say

    async def _listen(self, child: Child) -> None:
        """Take in what a child says until its process ends."""
        assert child.process.stdout is not None
        frames = Frames()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(child.cut_off, tasks.cancel_scope)
            tasks.start_soon(child.overheard.listen)
            async for data in child.process.stdout:
                for value in frames.feed(data):
                    self._take(child, value)
            with anyio.move_on_after(END_TIMEOUT_S):
                await child.process.wait()
            tasks.cancel_scope.cancel()
        child.heard.set()
        if not self.ending and child.report is None:
            await self._on_end(child)

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        if child.take(value):
            if value["status"] == DISMISSED:
                self._say(f"{child.name}: its process exits: {child.dismissed}")
        elif value["status"] == MISSES:
            self.tasks.start_soon(anyio.to_thread.run_sync, self.introduce, value["process"])
        elif self._current.get(self._world) is child:
            self._take_from_world(value)

    def _take_from_world(self, value: dict[str, Any]) -> None:
        status = value["status"]
        if status == BEAT:
            self._heard_s = self._clock()
            self.begun.set()
            self.epoch = value["epoch"]
            self.version = value["version"]
            self.instances = value["instances"]
            self._on_members({**self._elsewhere(), **value["processes"]})
            self._beat.set()
            self._beat = anyio.Event()
        elif status == FINISHED:
            self._on_members(value["processes"])
            self._last_roster = Roster.read(value["roster"])
            self.finished.set()
        elif status == NOTE:
            self._say(value["what"])
        elif status == ANSWER:
            self.requests.answer(value["request"], value["epoch"], value["refusal"])
        elif status == END:
            self._kill(value["name"], value["process"], value["why"])
        elif status == DISMISS:
            self.tasks.start_soon(self._dismiss, value["process"], Dismiss(value["why"], value["again"]))
        elif status == HALT:
            child = self._current.get(value["why"].partition(":")[0])
            self._fail((child and child.failure) or NodeFailedError(value["why"]))

    def _elsewhere(self) -> dict[str, str]:
        """The processes kept elsewhere of nodes in force: a new process of the world's names none that is lost."""
        members = self.members.items()
        return {name: token for name, token in members if name in self.instances and token not in self._children}

    def _on_members(self, members: Mapping[str, str]) -> None:
        self.members = members
        for name, token in members.items():
            child = self._children.get(token)
            if child is None:
                continue
            if child.alive:
                self._current[name] = child
            elif child.heard.is_set() and child.report is None and not self._is_replaced(name):
                # the world's process has died before it could say that this one was taken in
                self._current[name] = child
                self.tasks.start_soon(self._on_end, child)

    # --- processes that end

    def _kill(self, name: str, token: str, why: str) -> None:
        """A process hangs: it is killed; that it ends is noticed as always."""
        self._say(f"{name}: its process is killed: {why}")
        child = self._children.get(token)
        if child is not None and child.alive:
            child.culprit = why
            child.kill()
        else:
            self.tasks.start_soon(self.tell_owner, Lost(name, token, True))

    async def _dismiss(self, process: str, word: Dismiss) -> None:
        """Tell a process that it has no place any more; over Zenoh where another keeper keeps it."""
        child = self._children.get(process)
        if child is None:
            self.dismiss_elsewhere(process, word.why, word.again)
        elif child.alive and child.name != self._world:  # that one nobody dismisses
            await child.tell(encode_control(word))

    async def _on_end(self, child: Child) -> None:
        """A process has ended before its time."""
        name = child.name
        if child.final:
            self._fail(child.last_words)
            return
        if child.dismissed:
            await self.tell_owner(Lost(name, child.token, False))
            return
        if self._current.get(name) is not child:
            await self.tell_owner(Lost(name, child.token, True))
            await anyio.sleep(2 * BEAT_S)  # it may have been taken in just now
            if self._current.get(name) is not child:
                self.requests.failed(child)
                return
        self._coming.add(name)
        try:
            await self._replace(child)
        finally:
            self._coming.discard(name)

    async def _replace(self, child: Child) -> None:
        """Have another process come in the place of one that has ended, or end the run."""
        name = child.name
        failure = child.last_words
        if not (child.up.is_set() or child.was_killed or self._restarts[name].count or child.order.request):
            self._fail(failure)
            return
        begun = await self._has_begun()
        delay_s = self._restarts[name].delay_s(child)
        may_lack = begun and name != self._world and self._policy(child).on_loss == DETACH
        if delay_s is None and not may_lack:
            self._fail(failure)
            return
        self._say(f"{failure}" + ("" if delay_s is None else "; it is started again"))
        if begun and name != self._world:
            await self.tell_owner(Lost(name, child.token, delay_s is not None))
        if delay_s is not None:
            await anyio.sleep(delay_s)
            await self._restart(child)

    async def _has_begun(self) -> bool:
        """Whether the run has begun; where the world was told to begin, and has not said so yet, that is waited for."""
        world = self._told
        while world is not None and not self.begun.is_set():
            if world.heard.is_set() and self._told is world:  # it has ended, and all that it said is taken in
                self._told = None
                if self.orders.has_begun(world.token):
                    self.begun.set()
            if self._told is not world:
                break
            await anyio.sleep(POLL_S)
        return self.begun.is_set()

    async def _restart(self, child: Child) -> None:
        name = child.name
        if self.ending:
            return
        token = token_hex(8)
        if not self.begun.is_set():
            self.members = {**self.members, name: token}
            again = await self.start(self.orders.anew(child.order, token))
            for proposal in self.requests.proposals if name == self._world else ():
                await again.tell(proposal)
            return
        if self._last_roster is not None and name != self._world:  # nothing is left to do but to report
            self.members = {**self.members, name: token}
            await self.start(self.orders.to_report(child.order, token, self._last_roster))
            await self._current[name].tell(STOP)
            return
        living = self._living()
        await self.start(self.orders.again(child.order, token, living, self.requests.proposals))
        self._heard_s = self._clock()
        if name == self._world:
            await self._tell_of_deaths(living)

    async def _tell_of_deaths(self, living: Mapping[str, str]) -> None:
        """What a new process of the world's cannot know: who has died since its order was written, or for good."""
        for process in living:
            child = self._children.get(process)
            if child is not None and not child.alive:
                await self.tell_owner(Lost(child.name, process, True))
        for name, member in self.members.items():
            if name != self._world and name not in self._coming and not self._is_kept(name, member):
                await self.tell_owner(Lost(name, "", False))

    def _is_kept(self, name: str, member: str) -> bool:
        """Whether a process runs a node, here or elsewhere."""
        child = self._current.get(name)
        return (child is not None and child.alive) or (member not in self._children and member not in self._gone)

    def _is_replaced(self, name: str) -> bool:
        """Whether another process of a node is there, or comes."""
        current = self._current.get(name)
        return name in self._coming or (current is not None and current.alive)

    def _policy(self, child: Child) -> RestartPolicy:
        """What is done when a process ends; of one whose change is not committed yet, as that has it."""
        asked = self.requests.policies(child.order.request)
        return asked.get(child.name, self.orders.policy(child.name))

    def _living(self) -> dict[str, str]:
        """The processes that live, as far as is known here: of those kept elsewhere, whether they are heard of."""
        here = [token for token, child in self._children.items() if child.alive and child.name != self._world]
        there = [token for token in self.members.values() if token not in self._children and token not in self._gone]
        return {token: token for token in (*here, *there)}

    async def watch_world(self) -> None:
        """The world's process watches the others; here it is watched itself."""
        deadline_s = self.orders.deployment.epoch_deadline_s
        self._heard_s = self._clock()
        if deadline_s is None:
            return
        while True:
            await anyio.sleep(SILENCE_S / 5)
            world = self._current[self._world]
            if world.alive and self._clock() - self._heard_s > max(deadline_s, SILENCE_S):
                self._heard_s = self._clock()
                self._kill(self._world, world.token, "it does not answer")

    # --- what others ask for

    async def on_gone(self, name: str, token: str) -> None:
        """A process is gone, or cut off; what is kept here is noticed more surely by its end."""
        if token in self._children or token in self._gone:
            return
        await anyio.sleep(COMES_BACK_S)
        if self.members.get(name) != token:
            await self.hear_members()  # what is known here may be older than its place in the roster
        if not self.hears_of(token) and token not in self._gone and self.members.get(name) == token:
            self._gone.add(token)
            self._say(f"{name}: its process, kept elsewhere, is gone or cannot be reached")
            await self.tell_owner(Lost(name, token, True))

    async def tell_owner(self, word: Control) -> None:
        """What the world's process does not take in, because it has ended, its next one is told in its order."""
        world = self._current.get(self._world)
        if world is not None and world.alive:
            await world.tell(encode_control(word))

    async def hear_members(self) -> None:
        """Wait until the world has said anew who there is."""
        with anyio.move_on_after(SILENCE_S):
            for _ in range(2):  # the first may have been on its way
                await self._beat.wait()

    def adopt(self, request: str, policies: Mapping[str, RestartPolicy]) -> None:
        """A change is in force, with new nodes."""
        self.orders.adopt(request, policies)
        self._restarts.update({name: Restarts(policy) for name, policy in policies.items()})

    def child(self, token: str) -> Child | None:
        """A process that is kept here."""
        return self._children.get(token)

    def note(self, what: str) -> None:
        """Tell people something."""
        self._say(what)

    def cut_off(self, token: str) -> bool:
        """Whether a process that is kept elsewhere cannot be reached."""
        return token in self._gone

    def restarts_of(self, name: str) -> int:
        """How often a node's process was started again."""
        return self._restarts[name].count if name in self._restarts else 0
