"""The runners of all nodes in one process, the network between them, and changes of their roster."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.errors import HieraxError, OperatorError
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.deployment.snippet import Scheduled
from hierax.runtime.engine.effects import Committed, Saved
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.checkpoints import taken_over
from hierax.runtime.execution.free import run_freely
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.output_folder import open_probes, state_log
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.report import NodeReport
from hierax.runtime.execution.runner import Host, NodeRunner, World
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.loading.node_loader import NodeLoader, wait_for
from hierax.runtime.owner.roster_changes import ChangeError, Undo, next_roster, touched
from hierax.runtime.transport.port import QUEUE_SIZE, MemoryNetwork
from hierax.schemas.messages import Header
from hierax.schemas.roster import Change, Detach, Replace, Roster, new_nodes

_log = logging.getLogger("hierax")

Schedule = Sequence[Scheduled]  # changes of the roster, by the first epoch under each
Watch = Callable[[str, NodeRunner], None]  # told a node's name and its runner: may have it watched


class RunRecord(Protocol):
    """Takes in what is said in a run, such as `hierax.runtime.recording.recorder.InProcess`."""

    def message(self, header: Header, data: bytes) -> None:
        """A message is on its way."""

    def committed(self, epoch: int, digest: bytes) -> None:
        """An epoch is committed."""

    def watch(self, name: str, runner: NodeRunner, roster: Callable[[], Roster] | None) -> None:
        """Have a node tell its steps; `roster` is the world's, and gives the one in force."""


class _World(World):
    """Begins epochs, and before some of them has the roster changed."""

    def __init__(self, nodes: "SingleNodes") -> None:
        super().__init__(nodes.pacemaker)
        self._nodes = nodes  # of the run
        self.due = {scheduled.epoch for scheduled in nodes.schedule}  # the epochs before which the roster changes
        self.paused = False  # whether it is the others' turn, too: in the last epoch it had nobody to wait for

    def may_begin(self, runner: NodeRunner) -> bool:
        return not self.paused and super().may_begin(runner)

    def committed(self, committed: Committed) -> None:
        super().committed(committed)
        self.paused = not self._nodes.runners[self._nodes.deployment.roster.world].engine.waited

    def begin_next(self, runner: NodeRunner) -> None:
        epoch = runner.engine.epoch + 1
        if epoch in self.due:
            self._nodes.change(epoch)
        runner.drain(self.pacemaker.limit == epoch or epoch + 1 in self.due)
        self.pacemaker.start()
        try:
            runner.engine.begin()
        except OperatorError as error:
            self._nodes.failed(error)

    def act(self, runner: NodeRunner, epoch: int, actions: Elements) -> None:
        if self._nodes.acts:
            super().act(runner, epoch, actions)


@dataclass(frozen=True)
class _Trial:
    """A node that has replaced another one: what that was, for as long as the first epoch is not committed."""

    epoch: int  # the first one
    before: Roster  # the roster before it
    loader: NodeLoader  # of what was replaced
    start: ActiveNode  # the state that it had
    attempt: int  # of the last epoch that it has done
    terms: ProcessTerms  # of its process


@dataclass(eq=False)
class SingleNodes(Host):
    """The runners of all nodes, and the network between them."""

    deployment: Deployment
    seed: int
    pacemaker: Pacemaker
    output: Path | None
    schedule: Schedule
    watch: Watch | None
    record: RunRecord | None
    acts: bool
    turn: Callable[[str], None]

    def __post_init__(self) -> None:
        deployment = self.deployment
        self._setting = OperatorSetting(self.seed, wait_for)
        self._schedule = list(self.schedule)
        self._begins = _World(self)
        self._terms = dict(deployment.terms)
        self._failed: set[str] = set()
        self._trials: dict[str, _Trial] = {}
        self._built: dict[str, NodeLoader] = {}  # of nodes that were asked for, and are yet to come
        self._roster = deployment.roster
        self._world = deployment.roster.world
        self._network = MemoryNetwork(self.seed)
        self._network.overtakes = deployment.staleness.free  # a slow node hears of many epochs between two of its turns
        self._make_room()
        if self.record is not None:
            self._network.tap = self.record.message
        allowance = self._allowance = deployment.allowance
        # that it is one, and what is wrong with the first node that is
        build_hierarchy(self._roster, self._setting, allowance)
        self._loaders = {name: NodeLoader(name, self._setting, allowance) for name in self._roster.nodes}
        self._observers: dict[str, Observers] = {}
        self.runners: dict[str, NodeRunner] = {}
        for name in sorted(self._roster.nodes):
            self.turn(name)
            self.runners[name] = self._run_node(name, self._loaders[name].wiring(self._roster))

    def turns(self) -> Iterator[None]:
        """Run; gives control back after every turn of a node."""
        if self.deployment.staleness.free:
            return run_freely(self.runners, self._world, self._terms, self.seed, self.pacemaker, self.turn)
        return self._deliver_all()

    def ask(self, change: Change, terms: Mapping[str, ProcessTerms]) -> int:
        """Have the roster change with the next epoch; where epochs overlap, the one under way has to be drained."""
        world = self.runners[self._world].engine
        overlaps = world.epoch > 0 and self.deployment.overlaps  # the others may be behind a world that is done
        epoch = world.epoch + 1 + overlaps
        limit = self.pacemaker.limit
        if self.pacemaker.done or (limit is not None and epoch > limit):
            raise ChangeError(f"the run ends before epoch {epoch}, with which that would take effect")
        self._allowance.check_all(change)
        roster = self._roster
        for each in [*(scheduled.change for scheduled in self._schedule if scheduled.epoch <= epoch), change]:
            roster = next_roster(roster, each)
        self._build(change, roster)
        self._schedule.append(Scheduled(epoch, change, terms))
        self._schedule.sort(key=lambda scheduled: scheduled.epoch)
        self._begins.due.add(epoch)
        return epoch

    def _build(self, change: Change, roster: Roster) -> None:
        """Build what a change brings, which its first epoch begins with. Raises `HieraxError` if that cannot be."""
        for name in new_nodes(change):
            loader = NodeLoader(name, self._setting, self._allowance)
            node = loader.wiring(roster).node
            if not isinstance(change, Replace):
                node.initial_belief(0, 0.0)
            elif name in self.runners:
                self._taken_over(name, node)
            self._built[name] = loader
        for name in touched(self._roster, roster) & self._loaders.keys() - new_nodes(change).keys():
            self._loaders[name].wiring(roster)

    def _taken_over(self, name: str, node: BoundNode) -> ActiveNode:
        """The state that a node has of the one that it replaces. Raises `ChangeError` if it does not take it over."""
        try:
            return taken_over(node, self.runners[name].engine.encoded)
        except HieraxError as error:
            raise ChangeError(f"cannot replace {name!r}: {error}") from error

    def reports(self, committed: int | None) -> tuple[dict[str, NodeReport], dict[str, str]]:
        """What the nodes have come to; of a run broken off after a committed epoch also who cannot tell, and why."""
        reports: dict[str, NodeReport] = {}
        unreported: dict[str, str] = {}
        for name, runner in sorted(self.runners.items()):
            try:
                reports[name] = runner.report(committed)
            except HieraxError as error:  # noqa: PERF203 - each for itself
                if committed is None:
                    raise
                unreported[name] = str(error)
        return reports, unreported

    def _deliver_all(self) -> Iterator[None]:
        runners, network, turn = self.runners, self._network, self.turn
        turn(self._world)
        runners[self._world].finish()
        yield  # a world without neighbours is done by now
        while True:
            if self._begins.paused and network.lets_go_on():
                self._begins.paused = False
                turn(self._world)
                runners[self._world].finish()
                yield
                continue
            name = network.next_receiver()
            if name is None:
                break
            message = runners[name].port.receive()
            if message is not None:
                turn(name)
                runners[name].step(message)
                yield
        if not self.pacemaker.done:
            waiting = {name: runner.engine.waits_for for name, runner in runners.items()}
            raise HieraxError(f"nothing is under way any more, but nodes wait: {waiting}")

    def close(self) -> None:
        for observers in self._observers.values():
            observers.close()

    def _run_node(
        self, name: str, wiring: Wiring, saved: Saved | None = None, again: bool = False, joins: bool = False
    ) -> NodeRunner:
        """A node's runner; `again`: behind what another one of the node has written."""
        probes = open_probes(self.deployment.probes, name, self._allowance, self.output, again)
        self._observers[name] = Observers(name, probes, state_log(self.output, name, again))
        runner = NodeRunner(
            wiring,
            self._network.open_port(name),
            self._observers[name],
            self,
            self._begins if name == self._world else None,
            staleness=self.deployment.staleness,
            saved=saved,
            joins=joins,
        )
        if self.watch is not None:
            self.watch(name, runner)
        if self.record is not None:
            self.record.watch(name, runner, (lambda: self._roster) if name == self._world else None)
        return runner

    def log_level(self, header: Header, verdict: Verdict) -> int:
        return logging.INFO if verdict is Verdict.OLD_ROSTER else super().log_level(header, verdict)

    def change(self, epoch: int) -> None:
        """Make the changes that are due before an epoch; every node is done with the last one."""
        while self._schedule and self._schedule[0].epoch <= epoch:
            _, change, terms, _ = self._schedule.pop(0)
            if isinstance(change, Detach) and change.name in self._failed and change.name not in self._roster.nodes:
                continue
            if isinstance(change, Replace) and change.name in self.runners and self._roster.timing is None:
                name, engine = change.name, self.runners[change.name].engine
                was = (self._loaders[name], engine.state, engine.attempt)
                self._trials[name] = _Trial(epoch, self._roster, *was, self._terms[name])
            self._terms.update({name: terms.get(name, ProcessTerms()) for name in new_nodes(change)})
            self._apply(epoch, change)
        self._roster = self._roster.as_of(epoch)

    def failed(self, error: OperatorError) -> None:
        """What fails alone is detached, or undone, and the epoch begun again without it; as in a launch."""
        world = self.runners[self._world].engine
        while True:
            name = self._culprit(error)
            if self._is_tried(name):
                _log.warning("%s; what %s has replaced goes on", error, name)
                self._apply(world.epoch, Undo(name, self._trials[name].before))
            else:
                _log.warning("%s; %s is detached (on_loss)", error, name)
                self._failed.add(name)
                self._apply(world.epoch, Detach(name, cascade=True))
            self._network.drop_all()
            if world.phase is Phase.DONE:  # epochs overlap: the next one is the first without it
                return
            try:
                world.begin_again(world.attempt + 1)
                return
            except OperatorError as again:
                error = again

    def _culprit(self, error: OperatorError) -> str:
        """The node that an error is blamed on. Raises the error, if that node does not fail alone."""
        nodes = [name for name in error.subject.split("->") if name in self._roster.nodes]
        ends = [name for name in nodes if self._terms[name].fails_alone or self._is_tried(name)]
        if not ends:
            raise error
        return max(ends, key=self._roster.instance)  # of two, what came last has brought the edge

    def _is_tried(self, name: str) -> bool:
        """Whether a node has replaced another one with the epoch under way."""
        return name in self._trials and self._trials[name].epoch == self.runners[self._world].engine.epoch

    def _apply(self, epoch: int, change: Change | Undo) -> None:
        old = self._roster
        roster = self._roster = next_roster(old, change)
        version = roster.version
        self._make_room()
        for name in sorted(old.nodes.keys() - roster.nodes.keys()):
            self._close(name)
        for name in sorted(roster.nodes):
            if isinstance(change, Undo) and name == change.name:
                self._come_back(name)
            elif roster.instance(name) == version:
                self._come(name, epoch, isinstance(change, Replace))
            else:
                self.runners[name].engine.prepare(self._loaders[name].wiring(roster))
        self.runners[self._world].engine.rewire(version)
        self.pacemaker.chain.roster_hash = roster.content_hash()

    def _make_room(self) -> None:
        """A node with rates may be as many epochs ahead of others as counts back."""
        rates = self._roster.rates
        if rates is not None:
            self._network.queue_size = max(self._network.queue_size, QUEUE_SIZE + 2 * rates.reach)

    def _come(self, name: str, epoch: int, replaces: bool) -> None:
        built = self._built.pop(name, None)
        loader = self._loaders[name] = built or NodeLoader(name, self._setting, self._allowance)
        wiring = loader.wiring(self._roster)
        saved: Saved | None = None
        if replaces:
            state = self._taken_over(name, wiring.node)
            engine = self.runners[name].engine
            saved = Saved(epoch - 1, engine.attempt, state, state, engine.under_way)
            self._close(name)
        self.runners[name] = self._run_node(name, wiring, saved, again=replaces, joins=saved is None)

    def _come_back(self, name: str) -> None:
        """What was replaced goes on, as if it never had been."""
        trial = self._trials.pop(name)
        self._terms[name] = trial.terms
        self._close(name)
        self._loaders[name] = trial.loader
        saved = Saved(trial.epoch - 1, trial.attempt, trial.start, trial.start)
        self.runners[name] = self._run_node(name, trial.loader.wiring(self._roster), saved, again=True)

    def _close(self, name: str) -> None:
        self._observers.pop(name).close()
        self.runners.pop(name).port.close()
