"""Replaying a recording: nodes done again on what they were given, by the formal model rather than the engine.

Some nodes are *live*: their operators are called again. The others, by default the world,
give what they gave. A live node gets what live nodes give now, and of the others what was
recorded, each from the epoch and attempt whose message was used then.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from hierax.runtime.core.binding import OperatorSetting, Waiter, epoch_time_s, is_finished
from hierax.runtime.core.digest import NO_DIGEST, encode_state, epoch_digest, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.node import World
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.travel import cannot_travel, elements_cannot_travel
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_node
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.trace import EpochTrace, Line, order_of
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import decode_value, encode_value

KEPT_MESSAGES = 64
"""Where epochs overlap: how many messages of a line are kept, as a later epoch may use them."""

Attempt = tuple[int, int]
"""An epoch and which attempt of it."""

Rewrite = Callable[[Roster], Roster]
"""What replays a roster in place of another: for other parameters or classes."""


@dataclass
class ReplayedEpoch:
    """An epoch done again; what is not live is as it was recorded.

    Attributes:
        recorded: the epoch as it was.
        roster: under which it was done again.
        digest: of the run.
        starts, sensed, states: of the nodes that are live.
        lines: what the live nodes gave, by kind, sender and receiver.
        time_s: its time.
    """

    recorded: EpochTrace
    roster: Roster
    time_s: float | None = None
    digest: bytes = b""
    starts: dict[str, ActiveNode] = field(default_factory=dict)
    sensed: dict[str, Value] = field(default_factory=dict)
    states: dict[str, ActiveNode] = field(default_factory=dict)
    lines: dict[Line, Elements] = field(default_factory=dict)

    @property
    def epoch(self) -> int:
        """Its number."""
        return self.recorded.epoch

    @property
    def order(self) -> tuple[str, ...]:
        """The nodes from below to above."""
        return order_of(self.roster)

    def start_of(self, name: str) -> ActiveNode | None:
        """A node's state at its beginning; None: it follows from the epoch before."""
        return self.starts.get(name)

    def used_of(self, name: str) -> None:
        """Inputs are of the epochs that they were of then."""
        return

    def sensed_of(self, name: str) -> tuple[Value] | None:
        """A node's belief after `observe`, in a tuple; None: not known."""
        return (self.sensed[name],) if name in self.sensed else self.recorded.sensed_of(name)

    def state_of(self, name: str) -> ActiveNode | None:
        """A node's state after it; None: not known."""
        return self.states.get(name) or self.recorded.state_of(name)

    def elements(self, kind: str, sender: str, receiver: str) -> Elements | None:
        """What a message held; None: not known."""
        given = self.lines.get((kind, sender, receiver))
        return self.recorded.elements(kind, sender, receiver) if given is None else given


@dataclass(frozen=True)
class _Given:
    """What a live node has given along a line."""

    elements: Elements
    digest: bytes


class Replay:
    """Does a recording's epochs again.

    Args:
        recording: what is replayed.
        allowance: which code may be loaded.
        node: the one node that is live; None: all but the world.
        world: whether the world is live, too.
        rewrite: other parameters or classes; None: as recorded.
        first, last: which epochs; None: all.
        wait: drives async operators.

    Attributes:
        states: of the live nodes, after the last epoch done.
        roster: of the last epoch done.
    """

    def __init__(
        self,
        recording: Recording,
        allowance: Allowance,
        *,
        node: str | None = None,
        world: bool = False,
        rewrite: Rewrite | None = None,
        first: int = 1,
        last: int | None = None,
        wait: Waiter | None = None,
    ) -> None:
        self._recording = recording
        self._allowance = allowance
        self._node = node
        self._world = world
        self._rewrite = rewrite
        self._first = first
        self._last = last
        self._setting = OperatorSetting(recording.info.seed, wait)
        self._barrier = recording.info.how_stale.barrier
        self._loaders: dict[str, NodeLoader] = {}
        self._wirings: dict[str, Wiring] = {}
        self._given: dict[Line, dict[Attempt, _Given]] = {}
        self._told: dict[Line, dict[Attempt, bytes]] = {}
        self._digest = b""
        self._rewritten: dict[int, Roster] = {}
        self.states: dict[str, ActiveNode] = {}
        self.roster: Roster | None = None

    def epochs(self) -> Iterator[ReplayedEpoch]:
        """Do the epochs again, one at a time, from the first one before which all states are known.

        Raises:
            HieraxError: a node cannot be loaded or failed, or the recording does not tell what is needed.
        """
        before: EpochTrace | None = None
        for recorded in self._recording.epochs(last=self._last):
            follows = before is None or recorded.epoch == before.epoch + 1
            if self.roster is not None and before is not None and not follows:
                what = f"epoch {before.epoch + 1} is not recorded, and the next ones follow from it"
                raise RecordingError(f"{self._recording.path}: {what}")
            self._remember(recorded)
            if self.roster is None:
                begins = recorded.epoch >= self._first and self._knows_start(recorded, before if follows else None)
            if self.roster is not None or begins:
                replayed = self._do(recorded, before if follows else None)
                if replayed is None:
                    return
                yield replayed
            before = recorded

    def live(self, roster: Roster) -> tuple[str, ...]:
        """The nodes whose operators are called.

        Raises:
            RecordingError: there is no node of the name that was asked for.
        """
        if self._node is None:
            return tuple(sorted(name for name in roster.nodes if self._world or name != roster.world))
        if self._node not in roster.nodes:
            return ()
        return (self._node,)

    @property
    def seed(self) -> int:
        """Of the recording."""
        return self._recording.info.seed

    @property
    def hierarchy(self) -> str:
        """Its name."""
        return self._recording.info.hierarchy

    def wiring(self, name: str) -> Wiring:
        """A live node's wiring in the last epoch done."""
        return self._wirings[name]

    # --- an epoch

    def _do(self, recorded: EpochTrace, before: EpochTrace | None) -> ReplayedEpoch | None:
        """An epoch again; None: the world, done again, has finished before it."""
        roster = self._roster(recorded.roster)
        replayed = ReplayedEpoch(recorded, roster, recorded.time_s)
        live = self.live(roster)
        self._take_up(replayed, live, before)
        if roster.world in live and not self._begin_world(replayed):
            return None
        doing = [name for name in replayed.order if name in live and self._did(recorded, name)]
        time_s = replayed.time_s if replayed.time_s is not None else 0.0
        for name in doing:
            self._sense(replayed, name, time_s)
        digests: dict[str, bytes] = {}
        for name in reversed(replayed.order):
            if name in doing:
                self._predict(replayed, name, time_s, digests)
            elif name in recorded.nodes:
                self._keep_recorded(recorded, name, digests)
        self._chain(replayed, digests.get(roster.world, b""))
        self.roster = roster
        return replayed

    def _begin_world(self, replayed: ReplayedEpoch) -> bool:
        """Set the epoch's time; whether the world has something left to observe."""
        world = replayed.roster.world
        node = self._wirings[world].node.node
        assert isinstance(node, World)
        belief = self.states[world].belief
        if is_finished(world, node, belief, replayed.epoch - 1):
            return False
        replayed.time_s = epoch_time_s(world, node, belief, replayed.epoch)
        return True

    def _sense(self, replayed: ReplayedEpoch, name: str, time_s: float) -> None:
        epoch, wiring = replayed.epoch, self._wirings[name]
        belief = self.states[name].belief
        if name != replayed.roster.world:
            observations: Elements = ()
            for lower in wiring.node.below:
                observations += self._input(replayed.recorded, name, OBSERVATIONS, lower)
            belief = wiring.node.observe(epoch, time_s, observations, belief)
            if belief is None:
                wiring.node.accept_none(wiring.node.observe, epoch)
            replayed.sensed[name] = belief
        self.states[name] = self.states[name]._replace(belief=belief)
        for upper, sense in wiring.sense:
            elements = () if sense is None else sense.elements(epoch, time_s, belief)
            self._give(replayed, OBSERVATIONS, name, upper, elements, b"")

    def _predict(self, replayed: ReplayedEpoch, name: str, time_s: float, digests: dict[str, bytes]) -> None:
        epoch, wiring, recorded = replayed.epoch, self._wirings[name], replayed.recorded
        node, state = wiring.node, self.states[name]
        tasks: Elements = ()
        context: Elements = ()
        above: list[bytes] = []
        for upper in node.above:
            tasks += self._input(recorded, name, TASKS, upper) if upper in wiring.tasking else ()
            context += self._input(recorded, name, CONTEXT, upper)
            above.append(self._digest_from(recorded, name, upper))
        policy = node.choose(epoch, time_s, tasks) if node.above else state.policy
        actions = node.policies[policy].elements(epoch, time_s, state.belief)
        for lower, task in wiring.task:
            self._give(replayed, TASKS, name, lower, task.elements(epoch, time_s, actions), b"")
        belief = node.predict(epoch, time_s, context, actions, state.belief)
        if belief is None:
            node.accept_none(node.predict, epoch)
        done = ActiveNode(belief, policy, actions)
        self.states[name] = replayed.states[name] = done
        try:
            encoded = encode_state(*done)
        except SchemaError as error:
            raise cannot_travel(name, epoch, state.belief, done, error) from error
        digests[name] = node_digest(encoded, above) if all(above) else b""
        for lower, enrich in wiring.context:
            elements = () if enrich is None else enrich.elements(epoch, time_s, belief)
            self._give(replayed, CONTEXT, name, lower, elements, digests[name])

    def _keep_recorded(self, recorded: EpochTrace, name: str, digests: dict[str, bytes]) -> None:
        """A node that is not live: its state is the recorded one, its digest follows from those above it."""
        step = recorded.nodes[name].step
        above = [upper for (lower, upper) in _pairs(recorded.roster) if lower == name]
        inputs = [self._digest_from(recorded, name, upper) for upper in sorted(above)]
        digests[name] = node_digest(step.state, inputs) if all(inputs) else b""

    def _chain(self, replayed: ReplayedEpoch, world: bytes) -> None:
        recorded = replayed.recorded
        previous = self._digest or (NO_DIGEST if replayed.epoch == 1 else recorded.previous)
        if world and previous:
            content = replayed.roster.content_hash()
            replayed.digest = self._digest = epoch_digest(previous, replayed.epoch, content, world)
        else:
            self._digest = recorded.digest  # it cannot be taken again; the next one follows from what was told

    # --- what goes along the edges

    def _give(
        self, replayed: ReplayedEpoch, kind: str, sender: str, receiver: str, elements: Elements, digest: bytes
    ) -> None:
        try:
            travelled = decode_value(encode_value(elements))
        except SchemaError as error:
            raise elements_cannot_travel(kind, sender, receiver, replayed.epoch, error) from error
        line = (kind, sender, receiver)
        replayed.lines[line] = travelled
        recorded = replayed.recorded
        trace = recorded.nodes.get(sender)
        attempt = recorded.attempt if trace is None else trace.step.attempt
        self._given.setdefault(line, {})[replayed.epoch, attempt] = _Given(travelled, digest)

    def _used(self, recorded: EpochTrace, name: str, sender: str, kind: str) -> tuple[int, int]:
        used = recorded.used_of(name) or {}
        return used.get((sender, kind), (recorded.epoch, recorded.attempt))

    def _input(self, recorded: EpochTrace, name: str, kind: str, sender: str) -> Elements:
        when = self._used(recorded, name, sender, kind)
        given = self._given.get((kind, sender, name), {}).get(when)
        if given is not None:
            return given.elements
        data = self._told.get((kind, sender, name), {}).get(when)
        if data is None:
            what = f"the {kind} message {sender} -> {name} of epoch {when[0]}, attempt {when[1]}, is not recorded"
            raise RecordingError(f"{self._recording.path}: epoch {recorded.epoch} cannot be done again: {what}")
        return recorded.message(data).payload

    def _digest_from(self, recorded: EpochTrace, name: str, upper: str) -> bytes:
        when = self._used(recorded, name, upper, CONTEXT)
        given = self._given.get((CONTEXT, upper, name), {}).get(when)
        if given is not None:
            return given.digest
        data = self._told.get((CONTEXT, upper, name), {}).get(when)
        return b"" if data is None else recorded.message(data).header.digest

    def _remember(self, recorded: EpochTrace) -> None:
        """What was told along each line, and what was given last, as far back as it may be used."""
        if self._barrier:
            self._told.clear()
            self._given.clear()
        for line, attempts in recorded.lines.items():
            told = self._told.setdefault(line, {})
            for attempt, data in attempts.items():
                told[recorded.epoch, attempt] = data
        for kept in (self._told, self._given):
            for messages in kept.values():
                while len(messages) > KEPT_MESSAGES:
                    del messages[next(iter(messages))]

    def _did(self, recorded: EpochTrace, name: str) -> bool:
        """Whether a node had a part in the epoch; with the barrier, all have, told or not."""
        return self._barrier or name in recorded.nodes

    # --- nodes that come, stay and go

    def _roster(self, recorded: Roster) -> Roster:
        roster = self._rewritten.get(recorded.version)
        if roster is None:
            roster = recorded if self._rewrite is None else self._rewrite(recorded)
            self._rewritten[recorded.version] = roster
        return roster

    def _take_up(self, replayed: ReplayedEpoch, live: Collection[str], before: EpochTrace | None) -> None:
        """Have every live node's wiring and state under the epoch's roster."""
        roster = replayed.roster
        old = self.roster
        for name in self.states.keys() - set(live):
            del self.states[name]
        if old is not None and old.version == roster.version:
            return
        if roster.world in live and has_actuators(roster, self._allowance):
            raise HieraxError(f"{roster.world}: it moves actuators, and is not done again; replay it as recorded")
        for name in live:
            changed = old is not None and name in old.nodes and old.nodes[name].plain() != roster.nodes[name].plain()
            if name not in self._loaders or changed:
                self._loaders[name] = NodeLoader(name, self._setting, self._allowance)
            self._wirings[name] = wiring = self._loaders[name].wiring(roster)
            if name in self.states and (changed or _took_over(replayed.recorded, before, name)):
                self.states[name] = replayed.starts[name] = _taken_over(wiring, self.states[name])
            elif name not in self.states:
                self.states[name] = self._first_state(replayed, name, wiring, before)

    def _first_state(self, replayed: ReplayedEpoch, name: str, wiring: Wiring, before: EpochTrace | None) -> ActiveNode:
        """The state with which a node begins: its initial one, or as it was recorded."""
        recorded = replayed.recorded
        known: ActiveNode | None = None
        if self.roster is None and recorded.epoch > 1:  # the replay begins here
            known = recorded.start_of(name) or (None if before is None else before.state_of(name))
        if known is None:
            initial = wiring.node.initial_belief(0, 0.0)
            known = replayed.starts[name] = ActiveNode(initial, wiring.node.node.initial_policy)
        if known.policy not in wiring.node.policies:
            what = f"{name} begins with the policy {known.policy!r:.80}, which it has not"
            raise RecordingError(f"{self._recording.path}: epoch {recorded.epoch}: {what}")
        return known

    def _knows_start(self, recorded: EpochTrace, before: EpochTrace | None) -> bool:
        """Whether the states before an epoch are known: the initial ones, or those that were told."""
        if recorded.epoch == 1:
            return True
        if self._barrier and recorded.lacking:
            return False

        def knows(name: str) -> bool:
            if before is not None and (name in before.nodes or name not in before.roster.nodes):
                return True
            return recorded.start_of(name) is not None

        return all(knows(name) for name in self.live(recorded.roster))


def _took_over(recorded: EpochTrace, before: EpochTrace | None, name: str) -> bool:
    """Whether a node was replaced by its like: unlike a process that comes back it began with another state."""
    if before is None or name not in recorded.nodes or name not in before.nodes:
        return False
    start = recorded.nodes[name].step.start
    return bool(start) and start != before.nodes[name].step.state


def _taken_over(wiring: Wiring, state: ActiveNode) -> ActiveNode:
    """The state with which a node goes on in the place of another."""
    belief, policy, actions = decode_value(encode_value(tuple(state)))
    name = wiring.node.name
    try:
        belief = wiring.node.node.take_over(belief)
    except Exception as error:
        raise HieraxError(f"{name}: cannot take over the belief: {error}") from error
    if policy not in wiring.node.policies:
        raise HieraxError(f"{name}: it has no policy {policy!r}")
    return ActiveNode(belief, policy, actions)


def _pairs(roster: Roster) -> Iterable[tuple[str, str]]:
    return (edge.pair for edge in roster.edges)


def check_node(recording: Recording, node: str) -> None:
    """Whether a node is in a recording.

    Raises:
        RecordingError: it is not; with the nearest one.
    """
    names = {name for roster in recording.rosters().values() for name in roster.nodes}
    if node not in names:
        raise RecordingError(f"{recording.path}: there is no node {node!r}{did_you_mean(node, names, 'the nodes are')}")


def has_actuators(roster: Roster, allowance: Allowance) -> bool:
    """Whether the world moves something outside when it acts.

    Raises:
        NotAllowedError, LoadError: its class may not, or cannot, be loaded.
    """
    world = build_node(roster.nodes[roster.world], f"nodes.{roster.world}", allowance, is_world=True)
    return isinstance(world, World) and type(world).act is not World.act


def rewriting(old: Roster, new: Roster) -> Rewrite:
    """What puts new classes, parameters and edge functions in the place of old ones, wherever these are.

    Args:
        old, new: two rosters of one deployment file, read with other settings.
    """
    nodes = {name: (old.nodes[name], new.nodes[name]) for name in old.nodes.keys() & new.nodes.keys()}
    new_edges = {edge.pair: edge for edge in new.edges}
    edges = {edge.pair: (edge, new_edges[edge.pair]) for edge in old.edges if edge.pair in new_edges}

    def rewrite(roster: Roster) -> Roster:
        changed: Mapping[str, Reference] = {
            name: nodes[name][1] if name in nodes and nodes[name][0] == reference else reference
            for name, reference in roster.nodes.items()
        }
        joined = tuple(edges[e.pair][1] if e.pair in edges and edges[e.pair][0] == e else e for e in roster.edges)
        return Roster(roster.world, changed, joined, roster.version, roster.instances)

    return rewrite


__all__ = ["Replay", "ReplayedEpoch", "Rewrite", "check_node", "rewriting"]
