"""The processes of a launch's roster: what they say, and what follows when one ends before its time."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any

import anyio
import anyio.abc
import anyio.to_thread

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.pacemaker import SteadyClock
from hierax.runtime.launch import frames
from hierax.runtime.launch.child import Child, NodeFailedError, Overhearing, ProcessState, Restarts
from hierax.runtime.launch.hosts import Hosts
from hierax.runtime.launch.leftovers import Leftovers
from hierax.runtime.launch.orders import Orders
from hierax.runtime.launch.pending_changes import PendingChanges
from hierax.runtime.launch.process_supervisor import Fail, Notify, ProcessSupervisor
from hierax.runtime.owner.effects import DETACH
from hierax.runtime.transport.hub import Hub
from hierax.schemas.control import Census, Control, Dismiss, Lost, encode_control
from hierax.schemas.roster import Roster

BEAT_S = 0.2  # how often the world's process says something
POLL_S = 0.01  # how often it is looked whether all processes are up

COMES_BACK_S = 0.5
"""How long a process that was started elsewhere may be gone: where the hub was stopped, all seem to be for a moment."""

BEGINS_S = 5.0
"""How long the world's process, once it was told to begin, may take to say that it has, where a signal ends the run."""

SILENCE_S = 1.0  # how long the world's process may say nothing, beyond the epoch's deadline


class RosterSupervisor(ProcessSupervisor):
    """Has a process run for every node of a launch's roster: starts them, and others in their place."""

    def __init__(
        self, tasks: anyio.abc.TaskGroup, orders: Orders, hub: Hub, hosts: Hosts, notify: Notify, fail: Fail
    ) -> None:
        super().__init__(tasks, Overhearing(orders.run_id, lambda: self.epoch), orders.terms, notify, fail)
        self.orders = orders  # what the processes are started with
        self.changes = PendingChanges()  # those that others have asked for
        self.started = anyio.Event()  # set when there are processes of all nodes that the run begins, or goes on, with
        self.begun = anyio.Event()  # set when the run has begun: the world has recorded that, or goes on with a record
        self.finished = anyio.Event()  # set when the world has committed its last epoch
        self.current: dict[str, Child] = {}  # the last process of each node that was started here
        self.members: Mapping[str, str] = {}  # the processes of the roster in force, by node, as the world said last
        self.epoch = 0  # the last one committed, likewise
        self.version = 0  # of the roster, likewise
        self.instances: Mapping[str, int] = {}  # by node, its number in the roster, likewise
        self._hosts = hosts  # where processes are started
        self._hub = hub  # reaches processes that were started elsewhere
        self._world = orders.deployment.roster.world
        self._unreachable: set[str] = set()
        self._last_roster: Roster | None = None
        self._last_nodes: list[str] | None = None
        self._is_saved = True  # whether what it takes to go on with the run is written down as it is
        self._leftovers = Leftovers(self._is_kept)
        self._heard_s = 0.0
        self._told: Child | None = None
        self._clock = SteadyClock()
        self._beat = anyio.Event()

    def state(self, token: str) -> ProcessState:
        child = self.child(token)
        if child is not None:
            return child.state
        return ProcessState.CUT_OFF if token in self._unreachable else ProcessState.ELSEWHERE

    async def start_together(self, orders: Sequence[frames.NodeOrder]) -> list[Child]:
        children = await super().start_together(orders)
        self.current.update({child.name: child for child in children if child.order.life != frames.NEWCOMER})
        return children

    async def _begin(self, orders: Sequence[frames.NodeOrder]) -> list[Child]:
        return await self._hosts.start(orders, self.overhearing)

    async def begin(self, timeout_s: float) -> list[str]:
        """Wait until all processes are up, and have the world begin the run with them; gives the nodes that are late.

        Until it has, a process that is killed is started anew, and shakes hands anew.
        """
        clock = SteadyClock()
        patience = clock() + timeout_s
        while True:
            late = [name for name, child in self.current.items() if self._is_late(child)]
            if not late and self.begun.is_set():
                return []
            if not late and self._told is not self.current[self._world]:
                self._told = self.current[self._world]
                await self.send_to_owner(Census({name: child.token for name, child in self.current.items()}))
            if clock() > patience:
                return late or [self._world]
            await anyio.sleep(POLL_S)

    async def is_under_way(self) -> bool:
        """Whether the run has begun, all processes being started: then there is, or soon will be, what to report."""
        with anyio.move_on_after(BEGINS_S):
            return await self._has_begun()
        return False

    def _is_late(self, child: Child) -> bool:
        if self.begun.is_set():
            return not child.came_up and child.state is not ProcessState.ENDED
        return child.state is not ProcessState.UP

    @property
    def present(self) -> list[Child]:
        """The processes of the roster in force that were started here; of a node of the last one, which has told."""
        if self._last_nodes is None:
            return [child for child in self.children if self.members.get(child.name) == child.token]
        told = {child.name: child for child in self.children if child.report is not None}
        return [told.get(name, self.current[name]) for name in self._last_nodes]

    async def stop(self, child: Child) -> None:
        """Have a process do all up to the run's last epoch, report, and exit. One that came back, and that nobody has
        taken in, as the run was over, reports what its checkpoint tells; for that it needs the last roster."""
        over = self._last_roster if child.order.life == frames.COME_BACK else None
        await child.send({frames.STOP: self.epoch, **({} if over is None else {frames.ROSTER: over.plain()})})

    def _is_past(self, child: Child) -> bool:
        is_counted_on = self.current.get(child.name) is child or self.members.get(child.name) == child.token
        return super()._is_past(child) and not is_counted_on

    # --- what the processes say

    def _take(self, child: Child, value: dict[str, Any]) -> None:
        status = value["status"]
        if status == frames.MISSES:
            self.tasks.start_soon(anyio.to_thread.run_sync, self._hub.introduce, value["process"])
        elif self.current.get(self._world) is not child:
            return
        elif status == frames.BEAT:
            self._heard_s = self._clock()
            self.begun.set()
            self.epoch = value["epoch"]
            self.version = value["version"]
            self.instances = value["instances"]
            self._on_members({**self._elsewhere(), **value["processes"]})
            self._remove_leftovers()
            self._beat.set()
            self._beat = anyio.Event()
            if not self._is_saved:
                self.save()
        elif status == frames.FINISHED:
            self.epoch = value["epoch"]
            self._last_roster = Roster.read(value["roster"])
            if self._last_nodes is None:
                self._last_nodes = self._nodes_here(value["processes"], self._last_roster)
            self._on_members(value["processes"])
            self.finished.set()
        elif status == frames.NOTE:
            self.notify(value["what"])
        elif status == frames.ANSWER:
            self._on_answer(value["request"], value["epoch"], value["refusal"])
        elif status == frames.END:
            self._kill(value["name"], value["process"], value["why"])
        elif status == frames.DISMISS:
            self.tasks.start_soon(self._dismiss, value["process"], Dismiss(value["why"], value["again"]))
        elif status == frames.HALT:
            why, culprit = value["why"], self.current.get(value["why"].partition(":")[0])
            self.fail(culprit.failed_as(why) if culprit else NodeFailedError(why))

    def _nodes_here(self, processes: Mapping[str, str], roster: Roster) -> list[str]:
        """Those of the last nodes that were started here, and are there or come back. A process of the world's that
        comes up after the last epoch knows only of those that live; the one before may have died before it could say
        that it had finished, and others with it."""
        tokens = {**self.members, **processes}
        here = [name for name in roster.nodes if name not in tokens or self.child(tokens[name]) is not None]
        return [name for name in here if name in processes or self._runs(name) or self._comes_back(name)]

    def _elsewhere(self) -> dict[str, str]:
        """The processes started elsewhere of nodes in force: a new process of the world's names none that is lost."""
        members = self.members.items()
        return {name: token for name, token in members if name in self.instances and self.child(token) is None}

    def _on_members(self, members: Mapping[str, str]) -> None:
        self.members = members
        for name, token in members.items():
            child = self.child(token)
            if child is None:
                continue
            if child.alive:
                self.current[name] = child
            elif child.placeless and not (self._comes_back(name) or self._runs(name)):
                # it was taken in: that was on its way, or the world's process has died before it could say so
                self.current[name], child.placeless = child, False
                child.state = ProcessState.RESTARTING
                self.tasks.start_soon(self._replace, [child])

    def _on_answer(self, request: str, epoch: int, refusal: str) -> None:
        """It is known what has become of a change; where it is in force, its new nodes are kept as it says."""
        terms = self.changes.answer(request, epoch, refusal)
        if terms is not None and refusal:
            self._turn_away(request, refusal)
        elif terms is not None:
            self.orders.adopt(request, terms)
            self._restarts.update({name: Restarts(each) for name, each in terms.items()})
            self.save()

    def _turn_away(self, request: str, why: str) -> None:
        """Tell those to go that were started for a change: the owner may not have heard of them, or be a new one."""
        for child in self.children:
            if child.order.request == request and child.alive and self.members.get(child.name) != child.token:
                self.tasks.start_soon(child.send, encode_control(Dismiss(why)))

    def save(self) -> None:
        """Write down what it takes to go on with the run; where that cannot be, the run does without, and it is tried
        again with each beat."""
        was_saved = self._is_saved
        try:
            self.orders.save(self.changes.coming)
            self._is_saved = True
        except HieraxError as error:
            self._is_saved = False
            if was_saved:
                self.orders.outdate()
                self.notify(f"{error}; until it is, the run cannot be resumed")
            return
        if not was_saved:
            self.notify("what it takes to resume the run is written again")

    # --- processes that end

    def _kill(self, name: str, token: str, why: str) -> None:
        """Kill a process that hangs; that it ends is noticed as always."""
        self.notify(f"{name}: its process is killed: {why}")
        child = self.child(token)
        if child is not None and child.alive:
            child.culprit = why
            child.kill()
        else:
            self.tasks.start_soon(self.send_to_owner, Lost(name, token, True))

    async def _dismiss(self, process: str, word: Dismiss) -> None:
        """Tell a process that it has no place any more; over Zenoh where it was started elsewhere."""
        child = self.child(process)
        if child is None:
            self._hub.dismiss(process, word.why, word.again)
        elif child.alive and child.name != self._world:  # that one nobody dismisses
            await child.send(encode_control(word))

    async def _on_end(self, child: Child) -> None:
        name = child.name
        if child.final:
            self.fail(child.last_words)
            return
        if child.dismissed:
            what = "its process exits" if child.code is None else "it leaves its process"
            self.notify(f"{name}: {what}: {child.dismissed}")
            self._leftovers.add(child.order)
            self._remove_leftovers()
            await self.send_to_owner(Lost(name, child.token, False))
            return
        child.placeless = True
        await self.send_to_owner(Lost(name, child.token, True))
        await anyio.sleep(2 * BEAT_S)  # it may have been taken in just now
        if child.placeless:
            await self._on_end_beside(child)

    def _is_kept(self, order: frames.NodeOrder) -> bool:
        return order.name in self.instances and self.orders.is_kept(order)

    def _remove_leftovers(self) -> None:
        living = (child for child in self.children if child.state is not ProcessState.ENDED)
        self._leftovers.remove({child.order.checkpoint for child in living})

    async def _on_end_together(self, children: Sequence[Child]) -> None:
        """Nodes that were lost with one process come back in one; but those that have no place, or none yet."""
        together = [child for child in children if self._is_to_come_back(child)]
        for child in children:
            if child not in together:
                self.tasks.start_soon(self._on_end, child)
        if together:  # at once: nobody may see them ended before it is said that others come
            await self._replace(together)

    def _is_to_come_back(self, child: Child) -> bool:
        return not (child.final or child.dismissed) and self.current.get(child.name) is child

    async def _on_end_beside(self, child: Child) -> None:
        """One has ended that was not taken in yet; or was replaced, and waits for what replaces it to do an epoch."""
        request = child.order.request
        if request and not self.changes.in_force(request):
            self._on_answer(request, 0, str(child.failure or f"{child.name}: its process has ended"))
            return
        delay_s = None if self.ending or self.finished.is_set() else self._restarts[child.name].delay_s(child)
        if delay_s is None:
            await self.send_to_owner(Lost(child.name, child.token, False))
            return
        child.placeless = False
        self.notify(f"{child.last_words}; it is started again")
        await anyio.sleep(delay_s)
        if not self.ending:
            again = self.orders.again(child.order, frames.new_process(child.name), {})
            # the process that it has shared may come back too, with its door
            await super().start_together([replace(again, shares="", door="", doors=())])

    async def _replace(self, children: Sequence[Child]) -> None:
        """Have another process come in the place of one that has ended, with the nodes that it had; or end the run."""
        for child in children:
            child.state = ProcessState.RESTARTING
        try:
            delays_s = await self._delays_s(children)
            if delays_s:
                await anyio.sleep(max(delays_s.values()))
                await self._restart([child for child in children if child.name in delays_s])
        finally:
            for child in children:
                child.state = ProcessState.ENDED

    async def _delays_s(self, children: Sequence[Child]) -> dict[str, float]:
        """By node that is to come back, how long that is waited with; none where the run is ended. Others are told."""
        children = sorted(children, key=lambda child: child.failure is None)  # first who has ended the process
        for child in children:
            tried = self._restarts[child.name].count or child.order.request
            if not (child.came_up or children[0].was_killed or tried):
                self.fail(children[0].last_words)
                return {}
        begun = await self._has_begun()
        delays_s: dict[str, float] = {}
        for child in children:
            delay_s = self._restarts[child.name].delay_s(child)
            if delay_s is not None:
                delays_s[child.name] = delay_s
            elif not (begun and self._may_lack(child)):
                self.fail(child.not_started_again(self._restarts[child.name].refused))
                return {}
        self.notify(_told(children, delays_s))
        for child in children if begun else ():
            if child.name != self._world:
                await self.send_to_owner(Lost(child.name, child.token, child.name in delays_s))
        return delays_s

    def _may_lack(self, child: Child) -> bool:
        """Whether the run goes on without a node; of a process whose change is not committed yet, as that has it."""
        name = child.name
        terms = self.changes.terms(child.order.request).get(name, self.terms(name))
        return name != self._world and terms.on_loss == DETACH

    async def _has_begun(self) -> bool:
        """Whether the run has begun; where the world was told to begin, and has not said so yet, that is waited for."""
        world = self._told
        while world is not None and not self.begun.is_set():
            if world.ended.is_set() and self._told is world:  # all that it said is taken in
                self._told = None
                if self.orders.has_begun(world.token):
                    self.begun.set()
            if self._told is not world:
                break
            await anyio.sleep(POLL_S)
        return self.begun.is_set()

    async def _restart(self, children: Sequence[Child]) -> None:
        for child in children:
            await self._hosts.ready(child.name)
        if self.ending:
            return
        tokens = {child.name: frames.new_process(child.name) for child in children}
        if not self.begun.is_set():
            self.members = {**self.members, **tokens}
            again = await self.start_together([self.orders.anew(each.order, tokens[each.name]) for each in children])
            await self._propose_to(again)
            return
        # those that live, as far as is known here: of those started elsewhere, whether they are heard of
        here = [child.token for child in self.children if child.alive and child.name != self._world]
        there = [token for token in self.members.values() if self.state(token) is ProcessState.ELSEWHERE]
        living = {each: each for each in (*here, *there)}
        again = await self.start_together([self._order_again(child, tokens[child.name], living) for child in children])
        await self._propose_to(again)
        for child in again:
            if child.order.life == frames.TO_REPORT:
                await self.stop(child)
        self._heard_s = self._clock()
        if self._world in tokens:
            await self._send_deaths(living)

    async def _propose_to(self, children: Sequence[Child]) -> None:
        """Tell a new process of the world's, if it is among these, what is asked for."""
        for child in children:
            for proposal in self.changes.proposals if child.name == self._world else ():
                await child.send(proposal)

    def _order_again(self, child: Child, token: str, living: Mapping[str, str]) -> frames.NodeOrder:
        name = child.name
        if self._last_roster is None or name == self._world:
            return self.orders.again(child.order, token, living)
        # nothing is left to do but to report
        self.members = {**self.members, name: token}
        return replace(child.order, process=token, life=frames.TO_REPORT, request="", roster=self._last_roster)

    async def _send_deaths(self, living: Mapping[str, str]) -> None:
        """Tell a new process of the world's who has died since its order was written, or for good."""
        for process in living:
            child = self.child(process)
            if child is not None and not child.alive:
                await self.send_to_owner(Lost(child.name, process, True))
        await self.tell_left()
        for name, token in self.members.items():
            is_there = self._runs(name) or self.state(token) is ProcessState.ELSEWHERE
            if name != self._world and not self._comes_back(name) and not is_there:
                await self.send_to_owner(Lost(name, "", False))

    async def tell_left(self) -> None:
        """Tell the owner of a run that was resumed that what was replaced in the epoch under way does not come back."""
        if self.orders.left is not None:
            await self.send_to_owner(Lost(*self.orders.left, False))

    def _runs(self, name: str) -> bool:
        """Whether the last process of a node that was started here lives."""
        child = self.current.get(name)
        return child is not None and child.alive

    def _comes_back(self, name: str) -> bool:
        """Whether another process of a node is to be started, or may be: its end is just noticed."""
        child = self.current.get(name)
        return child is not None and (child.state is ProcessState.RESTARTING or not child.ended.is_set())

    async def watch_world(self) -> None:
        """Watch the world's process, which watches the others."""
        deadline_s = self.orders.deployment.epoch_deadline_s
        self._heard_s = self._clock()
        if deadline_s is None:
            return
        while True:
            await anyio.sleep(SILENCE_S / 5)
            world = self.current[self._world]
            if world.alive and self._clock() - self._heard_s > max(deadline_s, SILENCE_S):
                self._heard_s = self._clock()
                self._kill(self._world, world.token, "it does not answer")

    # --- processes that were started elsewhere, and the owner

    async def on_gone(self, name: str, token: str) -> None:
        """A process is gone, or cut off; of one that was started here its end is noticed more surely."""
        if self.state(token) is not ProcessState.ELSEWHERE:
            return
        await anyio.sleep(COMES_BACK_S)
        if self.members.get(name) != token:
            await self.hear_members()  # what is known here may be older than its place in the roster
        if self._hub.hears_of(token) or token in self._unreachable or self.members.get(name) != token:
            return
        self._unreachable.add(token)
        self.notify(f"{name}: its process, kept elsewhere, is gone or cannot be reached")
        await self.send_to_owner(Lost(name, token, True))

    async def send_to_owner(self, word: Control) -> None:
        """Send the owner a word; what a process that has ended did not take in, the next one is told, or finds out."""
        if self._runs(self._world):
            await self.current[self._world].send(encode_control(word))

    async def hear_members(self) -> None:
        """Wait until the world has said anew who there is."""
        with anyio.move_on_after(SILENCE_S):
            for _ in range(2):  # the first may have been on its way
                await self._beat.wait()


def _told(children: Sequence[Child], coming: Container[str]) -> str:
    """That a process has ended, and what follows, in one line."""
    first = children[0]
    if len(children) == 1:
        return f"{first.last_words}" + ("; it is started again" if first.name in coming else "")
    names = ", ".join(sorted(child.name for child in children))
    why = first.failure or f"its process ended {first.how}"
    left = sorted(child.name for child in children if child.name not in coming)
    after = f", without {', '.join(left)}" if left else ""
    return f"{first.order.shares} ({names}): {why}; it is started again{after}"
