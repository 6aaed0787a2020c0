"""The engine of one node: the table of `hierax.runtime.engine.table`, executed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from hierax.runtime.core.binding import BoundNode, Call, epoch_time_s, is_finished
from hierax.runtime.core.digest import NO_DIGEST, encode_state, epoch_digest, node_digest
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.graph import Pair
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.runtime.core.node import Elements, Value, World
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.outputs import Called, Committed, Completed, Output, Refused, Send
from hierax.runtime.engine.table import ACTIONS, HELD_MESSAGES, Action, Phase, Verdict
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message
from hierax.schemas.roster import Roster

Slot = tuple[str, str]
"""A sender and a kind: from each, one message comes in an epoch."""


@dataclass(frozen=True)
class Place:
    """Where a node stands in its roster.

    Attributes:
        roster: the roster's version.
        roster_hash: hash of its content.
        instances: instance numbers, of the node itself and of its neighbours.
        tasking: the edges (lower, upper) that have a task function ψ.
    """

    roster: int = 0
    roster_hash: bytes = NO_DIGEST
    instances: Mapping[str, int] = field(default_factory=dict)
    tasking: frozenset[Pair] = frozenset()

    @staticmethod
    def of(roster: Roster) -> Place:
        """The place of any node of a roster."""
        tasking = frozenset(edge.pair for edge in roster.edges if edge.task is not None)
        return Place(roster.version, roster.content_hash(), roster.instances, tasking)

    def instance(self, name: str) -> int:
        """The instance number of a node."""
        return self.instances.get(name, 0)


class Engine:
    """One node's part in every epoch.

    Args:
        node: the node, bound to its name and neighbours.
        edges: of the node; of each at least the functions that run on its side.
        place: the roster that it is in.
        events: whether every call of an operator or edge function gives an event.

    `begin` and `receive` yield what is to be done as soon as it is known: a task message
    before the belief is predicted, one node's context before the next one's. They must be
    run to their end. Not for two threads at once.
    """

    def __init__(
        self, node: BoundNode, edges: Sequence[BoundEdge], place: Place | None = None, *, events: bool = False
    ) -> None:
        self.node = node
        self.name = node.name
        self.place = place or Place()
        self._events = events
        self._world = node.node if isinstance(node.node, World) and not node.below else None
        by_pair = {(edge.lower, edge.upper): edge for edge in edges}
        upward = {upper: by_pair[node.name, upper] for upper in node.above}
        downward = {lower: by_pair[lower, node.name] for lower in node.below}
        self._sense = {upper: edge.sense for upper, edge in upward.items()}
        self._task = {lower: edge.task for lower, edge in downward.items() if edge.task}
        self._context = {lower: edge.context for lower, edge in downward.items()}
        self._roster = self.place.roster
        self._instance = self.place.instance(node.name)
        tasking = [upper for upper in node.above if (node.name, upper) in self.place.tasking]
        self._from_below = {(name, OBSERVATIONS): self.place.instance(name) for name in node.below}
        self._from_above = {(name, CONTEXT): self.place.instance(name) for name in node.above}
        self._from_above.update({(name, TASKS): self.place.instance(name) for name in tasking})
        self._tasking = tuple(tasking)
        self._edges: Mapping[Slot, int] = {**self._from_below, **self._from_above}
        self._inbox: dict[Slot, Message] = {}
        self._held: dict[Slot, list[Message]] = {}
        self._observations: Elements = ()
        self._sensed: Value = None
        self._belief: Value = node.initial_belief(0, 0.0)
        self._policy = node.node.initial_policy
        self._actions: Elements = ()
        self.digest = NO_DIGEST
        self.time_s = 0.0
        self.attempt = 0
        self.epoch = 0 if self._world else 1
        self._enter(Phase.IDLE if self._world else Phase.SENSE)
        self._encoded()

    @property
    def is_world(self) -> bool:
        """Whether the node is N₀."""
        return self._world is not None

    @property
    def finished(self) -> bool:
        """Whether the world has nothing left to observe; never, for other nodes."""
        return self._world is not None and is_finished(self.name, self._world, self._belief, self.epoch)

    @property
    def state(self) -> ActiveNode:
        """The node's state now."""
        return ActiveNode(self._belief, self._policy, self._actions)

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        """From whom which messages are missing, in order."""
        return tuple(sorted(self._awaited.keys() - self._inbox.keys()))

    def begin(self) -> Iterator[Output]:
        """Begin the next epoch; only the world, when idle.

        Raises:
            OperatorError: an operator failed.
        """
        if self._world is None or self.phase is not Phase.IDLE:
            raise ValueError(f"{self.name}: only a world that is idle begins an epoch")
        self.epoch += 1
        self.time_s = epoch_time_s(self.name, self._world, self._belief, self.epoch)
        self._enter(Phase.SENSE)
        return self._advance()

    def receive(self, message: Message) -> Iterator[Output]:
        """Take a message in, by the table.

        Raises:
            OperatorError: an operator failed.
        """
        verdict = self.judge(message.header)
        if verdict is Verdict.CURRENT:  # ACTIONS has this row, too; it is the one that epochs are made of
            header = message.header
            self._inbox[header.sender, header.kind] = message
            if len(self._inbox) == len(self._awaited):
                yield from self._advance()
            return
        action = ACTIONS[verdict]
        if action is Action.REFUSE or (action is Action.HOLD and not self._hold(message)):
            yield Refused(message.header, verdict)

    def judge(self, header: Header) -> Verdict:
        """What a message with this header is to the node now."""
        kind, sender, receiver, epoch, attempt, roster, instance, _, digest, _ = header
        slot = (sender, kind)
        if slot not in self._edges or receiver != self.name:
            return Verdict.FOREIGN
        if roster != self._roster:
            return Verdict.OLD_ROSTER if roster < self._roster else Verdict.NEW_ROSTER
        if instance != self._edges[slot]:
            return Verdict.OTHER_INSTANCE
        if kind == CONTEXT and not digest:
            return Verdict.INCOMPLETE
        if epoch != self.epoch or attempt != self.attempt:
            return Verdict.LATE if (epoch, attempt) < (self.epoch, self.attempt) else Verdict.EARLY
        if slot in self._inbox:
            return Verdict.DOUBLE
        if slot in self._awaited:
            return Verdict.CURRENT
        # the other half's: what came for SENSE is behind us, what comes for PREDICT is ahead
        return Verdict.EARLY if self.phase is Phase.SENSE else Verdict.DOUBLE

    def _hold(self, message: Message) -> bool:
        held = self._held.setdefault((message.header.sender, message.header.kind), [])
        if len(held) >= HELD_MESSAGES:
            return False
        held.append(message)
        return True

    def _release(self) -> Iterator[Output]:
        """Judge again what was held, as the epoch or its half has changed."""
        held, self._held = self._held, {}
        for slot in sorted(held):
            for message in held[slot]:
                yield from self.receive(message)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._awaited: Mapping[Slot, int]
        if phase is Phase.SENSE:
            self._awaited = self._from_below
        elif phase is Phase.PREDICT:
            self._awaited = self._from_above
        else:
            self._awaited = {}

    def _advance(self) -> Iterator[Output]:
        """Go on as far as what is in hand allows."""
        while self.phase is not Phase.IDLE and len(self._inbox) == len(self._awaited):
            if self.phase is Phase.SENSE:
                yield from self._do_sense()
            else:
                yield from self._do_predict()
            if self._held:
                yield from self._release()

    def _do_sense(self) -> Iterator[Output]:
        inbox, self._inbox = self._inbox, {}
        belief = self._belief
        if self._world is None:
            self.time_s = inbox[self.node.below[0], OBSERVATIONS].header.time_s
            self._observations = _union(inbox, self.node.below, OBSERVATIONS)
            belief = self.node.observe(self.epoch, self.time_s, self._observations, belief)
            if self._events:
                yield self._called(self.node.observe, belief)
        self._sensed = belief
        self._enter(Phase.PREDICT)
        for upper, sense in self._sense.items():
            elements = sense.elements(self.epoch, self.time_s, belief) if sense else ()
            if self._events and sense:
                yield self._called(sense, elements)
            yield self._send(OBSERVATIONS, upper, elements)

    def _do_predict(self) -> Iterator[Output]:
        inbox, self._inbox = self._inbox, {}
        node, epoch, time_s = self.node, self.epoch, self.time_s
        tasks = _union(inbox, self._tasking, TASKS) if self._tasking else ()
        context = _union(inbox, node.above, CONTEXT) if node.above else ()
        policy = self._policy
        if node.above:
            policy = node.choose(epoch, time_s, tasks)
            if self._events:
                yield self._called(node.select_policy, policy)
        act = node.policies[policy]
        actions = act.elements(epoch, time_s, self._sensed)
        if self._events:
            yield self._called(act, actions)
        for lower, task in self._task.items():
            elements = task.elements(epoch, time_s, actions)
            if self._events:
                yield self._called(task, elements)
            yield self._send(TASKS, lower, elements)
        belief = node.predict(epoch, time_s, context, actions, self._sensed)
        if self._events:
            yield self._called(node.predict, belief)
        self._belief, self._policy, self._actions = belief, policy, actions
        encoded = self._encoded()
        self.digest = node_digest(encoded, [inbox[upper, CONTEXT].header.digest for upper in node.above])
        for lower, enrich in self._context.items():
            elements = enrich.elements(epoch, time_s, belief) if enrich else ()
            if self._events and enrich:
                yield self._called(enrich, elements)
            yield self._send(CONTEXT, lower, elements, self.digest)
        step = Step(
            epoch, self.attempt, time_s, self._observations, self._sensed, tasks, context, policy, actions, belief
        )
        yield Completed(step, encoded, self.digest)
        if self._world is None:
            self.epoch += 1
            self.attempt = 0
            self._enter(Phase.SENSE)
        else:
            self._enter(Phase.IDLE)
            yield Committed(epoch, self.attempt, self.digest)

    def _send(self, kind: str, receiver: str, elements: Elements, digest: bytes = b"") -> Send:
        epoch, attempt, time_s = self.epoch, self.attempt, self.time_s
        header = Header(kind, self.name, receiver, epoch, attempt, self._roster, self._instance, time_s, digest)
        return Send(Message(header, elements))

    def _called(self, call: Call, result: Value) -> Called:
        return Called(self.epoch, self.attempt, call.subject, call.operator, result)

    def _encoded(self) -> bytes:
        """The state's bytes; a state that cannot be encoded is the operator's fault."""
        try:
            return encode_state(self._belief, self._policy, self._actions)
        except SchemaError as error:
            what = f"its belief or actions {error}"
            raise OperatorError(self.name, "predict" if self.epoch else "initial_belief", self.epoch, what) from error


class DigestChain:
    """The digests of committed epochs, each over the last one."""

    def __init__(self, roster_hash: bytes) -> None:
        self._roster_hash = roster_hash
        self.epoch = 0
        self.digest = NO_DIGEST

    def commit(self, committed: Committed) -> bytes:
        """The digest of the next epoch."""
        self.epoch = committed.epoch
        self.digest = epoch_digest(self.digest, committed.epoch, self._roster_hash, committed.digest)
        return self.digest


def _union(inbox: Mapping[Slot, Message], senders: Sequence[str], kind: str) -> Elements:
    """The elements of all senders, in name order; doubles are kept."""
    if len(senders) == 1:  # as it mostly is
        return inbox[senders[0], kind].payload
    return tuple(element for sender in senders for element in inbox[sender, kind].payload)
