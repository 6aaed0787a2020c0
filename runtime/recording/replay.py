"""Replaying a recording: nodes done again on what they were given, by the formal model rather than the engine.

Some nodes are *live*: their operators are called again. The others, by default the world,
give what they gave. A live node gets what live nodes give now, and of the others what was
recorded, each from the epoch and attempt whose message was used then."""

import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path

from hierax.runtime.core.binding import OperatorSetting, epoch_time_s, is_finished
from hierax.runtime.core.digest import NO_DIGEST, cannot_travel, encode_state, epoch_digest
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import World
from hierax.runtime.core.process import ActiveNode, apply, predict, sense
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.secrets import usable
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.checkpoints import taken_over
from hierax.runtime.host.run_folder import NOT_OURS
from hierax.runtime.loading.allowance import ANYTHING, Allowance
from hierax.runtime.loading.loader import build_node
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.loading.node_loader import NodeLoader, wait_for
from hierax.runtime.recording.info import RecordingError, RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replayed_epoch import Exchange, ReplayedEpoch
from hierax.runtime.recording.told import LastTold, is_another
from hierax.runtime.recording.trace import EpochTrace, taking_part
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.rates import EVERY_EPOCH, Turns
from hierax.schemas.roster import Reference, Roster

Rewrite = Callable[[Roster], Roster]  # what replays a roster in place of another: for other parameters or classes


@dataclass
class Replay:
    """Does a recording's epochs again."""

    recording: Recording  # what is replayed
    allowance: Allowance  # which code may be loaded
    _: KW_ONLY
    node: str | None = None  # the one node that is live; None: all but the world
    world: bool = False  # whether the world is live, too
    rewrite: Rewrite | None = None  # other parameters or classes; None: as recorded
    first: int = 1
    last: int | None = None  # of the epochs; None: the last one
    states: dict[str, ActiveNode] = field(default_factory=dict, init=False)  # of the live nodes, after it
    wirings: dict[str, Wiring] = field(default_factory=dict, init=False)  # of all that were live, in their last epoch
    roster: Roster | None = field(default=None, init=False)  # of the last epoch done

    def __post_init__(self) -> None:
        self._barrier = self.recording.info.how_stale.barrier
        self._exchange = Exchange(self._barrier)
        self._loaders: dict[str, NodeLoader] = {}
        self._digest = b""
        self._rewritten: dict[int, Roster] = {}
        self._told = LastTold()

    def epochs(self) -> Iterator[ReplayedEpoch]:
        """Do the epochs again, from the first one before which all states are known; `HieraxError` if one cannot be."""
        before: EpochTrace | None = None
        for recorded in self.recording.epochs(last=self.last):
            follows = before is None or recorded.epoch == before.epoch + 1
            if self.roster is not None and before is not None and not follows:
                what = f"epoch {before.epoch + 1} is not recorded, and the next ones follow from it"
                raise RecordingError(f"{self.recording.path}: {what}")
            roster = self._roster_of(recorded)
            self._exchange.recall(recorded, roster)
            self._told.begin(recorded)
            if self.roster is None:
                begins = recorded.epoch >= self.first and self._knows_start(recorded, before if follows else None)
            if self.roster is not None or begins:
                replayed = self._do(recorded, roster, before if follows else None)
                if replayed is None:
                    return
                yield replayed
            self._told.end(recorded)
            before = recorded

    def live(self, roster: Roster) -> tuple[str, ...]:
        """The nodes whose operators are called."""
        if self.node is None:
            return tuple(sorted(name for name in roster.nodes if self.world or name != roster.world))
        return (self.node,) if self.node in roster.nodes else ()

    # --- an epoch

    def _roster_of(self, recorded: EpochTrace) -> Roster:
        """The roster under which a recorded epoch is done."""
        roster = recorded.roster
        if self.rewrite is None:
            return roster
        if roster.version not in self._rewritten:
            self._rewritten[roster.version] = self.rewrite(roster)
        return self._rewritten[roster.version]

    def _do(self, recorded: EpochTrace, roster: Roster, before: EpochTrace | None) -> ReplayedEpoch | None:
        """Do an epoch again; None: the world, done again, has finished before it."""
        replayed = ReplayedEpoch(recorded, roster, recorded.time_s)
        live = self.live(roster)
        self._take_up(replayed, live, before)
        if roster.world in live and not self._begin_world(replayed):
            return None
        # with the barrier, all whose turn it is have a part in the epoch, told or not
        doing = set(taking_part(roster, recorded.epoch) if self._barrier else recorded.nodes).intersection(live)
        time_s = replayed.time_s if replayed.time_s is not None else 0.0
        for name in replayed.order:
            if name in doing:
                self._sense(replayed, name, time_s)
            if name in doing or (name in live and roster.rates is not None):
                self._send_up(replayed, name, time_s)
        digest = b""  # at last the world's, which all nodes are above
        for name in reversed(replayed.order):
            if name in doing:
                digest = self._predict(replayed, name, time_s)
            else:
                known = recorded.nodes.get(name)
                digest = b"" if known is None else self._exchange.digest(recorded, name, known.step.state)
        self._chain(replayed, digest)
        self.roster = roster
        return replayed

    def _begin_world(self, replayed: ReplayedEpoch) -> bool:
        """Set the epoch's time; whether the world has something left to observe."""
        world = replayed.roster.world
        node = self.wirings[world].node.node
        assert isinstance(node, World)
        belief = self.states[world].belief
        if is_finished(world, node, belief, replayed.epoch - 1):
            return False
        replayed.time_s = epoch_time_s(world, node, belief, replayed.epoch)
        return True

    def _sense(self, replayed: ReplayedEpoch, name: str, time_s: float) -> None:
        epoch, wiring = replayed.epoch, self.wirings[name]
        node = wiring.node
        observations = self._exchange.elements(replayed.recorded, OBSERVATIONS, node.below, name)
        state = self.states[name] = sense(node, self.states[name], observations, epoch, time_s)
        if node.below:
            replayed.sensed[name] = state.belief

    def _send_up(self, replayed: ReplayedEpoch, name: str, time_s: float) -> None:
        epoch, rates = replayed.epoch, replayed.roster.rates
        for upper, function in self.wirings[name].sense:
            if rates is None or rates.is_sensed(name, upper, epoch):
                given = apply(function, epoch, time_s, self.states[name].belief)
                self._exchange.give(replayed, (OBSERVATIONS, name, upper), given)

    def _predict(self, replayed: ReplayedEpoch, name: str, time_s: float) -> bytes:
        """Do a node's prediction, and give its digest."""
        epoch, wiring, sensed = replayed.epoch, self.wirings[name], self.states[name]
        node = wiring.node
        tasks = self._exchange.elements(replayed.recorded, TASKS, wiring.tasking, name)
        context = self._exchange.elements(replayed.recorded, CONTEXT, node.above, name)
        state = predict(node, sensed, tasks, context, epoch, time_s)
        self.states[name] = replayed.states[name] = state
        try:
            digest = self._exchange.digest(replayed.recorded, name, encode_state(*state))
        except SchemaError as error:
            raise cannot_travel(name, epoch, sensed.belief, state, error) from error
        for lower, task in wiring.task:
            self._exchange.give(replayed, (TASKS, name, lower), apply(task, epoch, time_s, state.actions))
        for lower, enrich in wiring.context:
            self._exchange.give(replayed, (CONTEXT, name, lower), apply(enrich, epoch, time_s, state.belief), digest)
        return digest

    def _chain(self, replayed: ReplayedEpoch, world: bytes) -> None:
        recorded = replayed.recorded
        previous = self._digest or (NO_DIGEST if replayed.epoch == 1 else recorded.previous)
        if world and previous:
            content = replayed.roster.content_hash()
            replayed.digest = self._digest = epoch_digest(previous, replayed.epoch, content, world)
        else:
            self._digest = recorded.digest  # it cannot be taken again; the next one follows from what was told

    # --- nodes that come, stay and go

    def _take_up(self, replayed: ReplayedEpoch, live: Collection[str], before: EpochTrace | None) -> None:
        """Have every live node's wiring and state under the epoch's roster."""
        roster = replayed.roster
        old = self.roster
        for name in self.states.keys() - set(live):
            del self.states[name]
        if old is not None and old.version == roster.version:
            return
        if roster.world in live and has_actuators(roster, self.allowance):
            raise HieraxError(f"{roster.world}: it moves actuators, and is not done again; replay it as recorded")
        setting = OperatorSetting(self.recording.info.seed, wait_for)
        for name in live:
            changed = old is not None and name in old.nodes and old.nodes[name].plain() != roster.nodes[name].plain()
            if name not in self._loaders or changed:
                self._loaders[name] = NodeLoader(name, setting, self.allowance)
            self.wirings[name] = wiring = self._loaders[name].wiring(roster)
            told = self._told.states if before is None else {**before.nodes, **self._told.states}
            took_over = name in told and is_another(replayed.recorded, told[name], name)
            if name in self.states and (changed or took_over):
                self._take_over(replayed, name)
            elif name not in self.states:
                self.states[name] = self._first_state(replayed, name, wiring, before)

    def _take_over(self, replayed: ReplayedEpoch, name: str) -> None:
        try:
            state = taken_over(self.wirings[name].node, encode_state(*self.states[name]))
        except HieraxError as error:
            raise HieraxError(f"{name}: cannot take over the belief: {error}") from error
        self.states[name] = replayed.starts[name] = state

    def _first_state(self, replayed: ReplayedEpoch, name: str, wiring: Wiring, before: EpochTrace | None) -> ActiveNode:
        """The state with which a node begins: its initial one, or as it was recorded."""
        recorded = replayed.recorded
        known: ActiveNode | None = None
        if self.roster is None and recorded.epoch > 1:  # the replay begins here
            known = recorded.start_of(name) or self._told.state_of(name)
            if known is None and before is not None:
                known = before.state_of(name)
        if known is None:
            initial = wiring.node.initial_belief(0, 0.0)
            known = replayed.starts[name] = ActiveNode(initial, wiring.node.node.initial_policy)
        if known.policy not in wiring.node.policies:
            what = f"{name} begins with the policy {known.policy!r:.80}, which it has not"
            raise RecordingError(f"{self.recording.path}: epoch {recorded.epoch}: {what}")
        return known

    def _knows_start(self, recorded: EpochTrace, before: EpochTrace | None) -> bool:
        """Whether the states before an epoch are known: the initial ones, or those that were told."""
        if recorded.epoch == 1:
            return True
        if self._barrier and recorded.lacking:
            return False
        if recorded.roster.rates is not None:
            return all(self._knows(recorded, name) for name in self.live(recorded.roster))
        return all(
            (before is not None and (name in before.nodes or name not in before.roster.nodes))
            or recorded.start_of(name) is not None
            for name in self.live(recorded.roster)
        )

    def _knows(self, recorded: EpochTrace, name: str) -> bool:
        """With rates: whether a node's state before an epoch is known, and what counts of earlier ones."""
        begins = recorded.start_of(name) is not None or self._told.knows(name)
        return begins and self._exchange.knows_inputs(recorded.roster, name, recorded.epoch)


def has_actuators(roster: Roster, allowance: Allowance) -> bool:
    """Whether the world moves something outside when it acts. Raises as `build_node` does."""
    world = build_node(roster.nodes[roster.world], f"nodes.{roster.world}", allowance, is_world=True)
    return isinstance(world, World) and type(world).act is not World.act


def recorded_deployment(info: RunInfo, settings: Sequence[str] = ()) -> Deployment:
    """The deployment as it was recorded, with further settings; `DeploymentError` if one of these is wrong."""
    with tempfile.TemporaryDirectory(prefix="hierax-") as folder:
        path = Path(folder) / (Path(info.deployment).name or "deployment")
        try:
            path.write_text(info.deployment_text, encoding="utf-8")
        except OSError as error:  # a name that no file can have
            raise RecordingError(f"its deployment file cannot be written: {error.strerror or error}") from error
        # a file that the deployment names beside it is not here, and not needed
        deployment = read_deployment(path, ["zenoh=null", *usable(info.settings), *settings])
    return replace(deployment, path=Path(info.deployment), import_paths=tuple(info.import_paths))


def allowance_of(recording: Recording, trust: bool = False) -> Allowance:
    """Which code may be loaded to do a recording again that is ours, or trusted; `RecordingError` if it is neither."""
    if trust:
        return ANYTHING
    if not recording.info.is_ours:
        raise RecordingError(f"{recording.path}: {NOT_OURS}")
    return Allowance(tuple(recording.info.modules))


def other_settings(info: RunInfo, settings: Sequence[str], classes: Mapping[str, str]) -> Rewrite | None:
    """What replays a recording with other parameters (``--set``), or classes by node; None where none are given."""
    if not settings and not classes:
        return None
    rewrite = rewriting(recorded_deployment(info).roster, recorded_deployment(info, settings).roster)

    def rewritten(roster: Roster) -> Roster:
        roster = rewrite(roster)
        known = [name for name in classes if name in roster.nodes]
        others = {name: Reference(classes[name], roster.nodes[name].parameters) for name in known}
        return replace(roster, nodes={**roster.nodes, **others})

    return rewritten


def changed_nodes(old: Roster, new: Roster) -> frozenset[str]:
    """The nodes that are other ones in a new roster than in an old one, and those of whose edges one is."""
    nodes = {name for name in new.nodes if new.nodes[name] != old.nodes.get(name)}
    before, after = ({edge.pair: edge for edge in each.edges} for each in (old, new))
    ends = {end for pair in {*before, *after} if before.get(pair) != after.get(pair) for end in pair}
    return frozenset(nodes | ends)


def in_place_of(recorded: Roster, deployment: Deployment) -> Rewrite:
    """What replays a recording, whose first roster is given, with a deployment in the place of its own."""
    content, other = recorded.content(), deployment.roster
    rewrite = rewriting(recorded, other)

    def rewritten(roster: Roster) -> Roster:
        if roster.content() == content:
            return replace(other, version=roster.version, instances=roster.instances)
        return rewrite(roster)  # it was changed since

    return rewritten


def rewriting(old: Roster, new: Roster) -> Rewrite:
    """What puts a new roster's classes, parameters and edge functions in an old one's place, wherever these are."""
    old_edges, new_edges = ({edge.pair: edge for edge in each.edges} for each in (old, new))

    def rewrite(roster: Roster) -> Roster:
        nodes = {
            name: new.nodes.get(name, reference) if old.nodes.get(name) == reference else reference
            for name, reference in roster.nodes.items()
        }
        edges = [new_edges.get(e.pair, e) if old_edges.get(e.pair) == e else e for e in roster.edges]
        is_old = {name: _turns(roster, name) == _turns(old, name) and name in new.nodes for name in nodes}
        turns = {name: _turns(new if is_old[name] else roster, name) for name in nodes}
        turns = {name: each for name, each in turns.items() if each != EVERY_EPOCH}
        timing = new.timing if roster.timing is None else roster.timing
        return replace(roster, nodes=nodes, edges=tuple(edges), turns=turns, timing=timing)

    return rewrite


def _turns(roster: Roster, name: str) -> Turns:
    return roster.turns.get(name, EVERY_EPOCH)


def check_names(recording: Recording, names: Iterable[str]) -> None:
    """See that a recording has nodes of these names; `RecordingError` says which one is nearest to one that lacks."""
    known = {name for roster in recording.rosters().values() for name in roster.nodes}
    for name in names:
        if name not in known:
            nearest = did_you_mean(name, known, "the nodes are")
            raise RecordingError(f"{recording.path}: there is no node {name!r}{nearest}")
