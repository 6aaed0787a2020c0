"""The engine of one node: the table of `hierax.runtime.engine.table`, executed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hierax.runtime.core.binding import BoundNode, Call, epoch_time_s
from hierax.runtime.core.digest import NO_DIGEST, encode_state, epoch_digest, node_digest
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.runtime.core.node import Elements, Value, World
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.outputs import Called, Committed, Completed, Output, Refused, Send
from hierax.runtime.engine.table import ACTIONS, HELD_MESSAGES, Action, Phase, Verdict
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message

Slot = tuple[str, str]
"""A sender and a kind: from each, one message comes in an epoch."""


@dataclass(frozen=True)
class Place:
    """Where a node stands in its roster.

    Attributes:
        roster: the roster's version.
        roster_hash: hash of its content.
        instances: instance numbers, of the node itself and of its neighbours.
    """

    roster: int = 0
    roster_hash: bytes = NO_DIGEST
    instances: Mapping[str, int] = field(default_factory=dict)

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

    Every method returns what is to be done, in order; nothing else happens. Not for
    two threads at once.
    """

    def __init__(
        self, node: BoundNode, edges: Sequence[BoundEdge], place: Place | None = None, *, events: bool = False
    ) -> None:
        self.node = node
        self.name = node.name
        self.place = place or Place()
        self._events = events
        self._world = node.node if isinstance(node.node, World) and not node.below else None
        self._sense = {edge.upper: edge.sense for edge in edges if edge.lower == node.name}
        self._task = {edge.lower: edge.task for edge in edges if edge.upper == node.name}
        self._context = {edge.lower: edge.context for edge in edges if edge.upper == node.name}
        self._instance = self.place.instance(node.name)
        self._awaited: Mapping[Phase, frozenset[Slot]] = {
            Phase.IDLE: frozenset(),
            Phase.SENSE: frozenset((name, OBSERVATIONS) for name in node.below),
            Phase.PREDICT: frozenset((name, kind) for name in node.above for kind in (TASKS, CONTEXT)),
        }
        self._edges = self._awaited[Phase.SENSE] | self._awaited[Phase.PREDICT]
        self._senders = {name: self.place.instance(name) for name in (*node.below, *node.above)}
        self._inbox: dict[Slot, Message] = {}
        self._held: dict[Slot, list[Message]] = {}
        self._observations: Elements = ()
        self._sensed: Value = None
        self.state = ActiveNode(node.initial_belief(0, 0.0), node.node.initial_policy)
        self.digest = NO_DIGEST
        self.time_s = 0.0
        self.attempt = 0
        self.epoch = 0 if self._world else 1
        self.phase = Phase.IDLE if self._world else Phase.SENSE
        self._encoded()

    @property
    def is_world(self) -> bool:
        """Whether the node is N₀."""
        return self._world is not None

    @property
    def finished(self) -> bool:
        """Whether the world has nothing left to observe; never, for other nodes."""
        return self._world is not None and self._world.finished(self.state.belief)

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        """From whom which messages are missing, in order."""
        return tuple(sorted(self._awaited[self.phase] - self._inbox.keys()))

    def begin(self) -> list[Output]:
        """Begin the next epoch; only the world, when idle.

        Raises:
            OperatorError: an operator failed.
        """
        if self._world is None or self.phase is not Phase.IDLE:
            raise ValueError(f"{self.name}: only a world that is idle begins an epoch")
        self.epoch += 1
        self.time_s = epoch_time_s(self.name, self._world, self.state.belief, self.epoch)
        self.phase = Phase.SENSE
        out: list[Output] = []
        self._advance(out)
        return out

    def receive(self, message: Message) -> list[Output]:
        """Take a message in, by the table.

        Raises:
            OperatorError: an operator failed.
        """
        out: list[Output] = []
        self._judge(message, out)
        return out

    def judge(self, header: Header) -> Verdict:
        """What a message with this header is to the node now."""
        kind, sender, receiver, epoch, attempt, roster, instance, _, digest, _ = header
        slot = (sender, kind)
        if slot not in self._edges or receiver != self.name:
            return Verdict.FOREIGN
        if roster != self.place.roster:
            return Verdict.OLD_ROSTER if roster < self.place.roster else Verdict.NEW_ROSTER
        if instance != self._senders[sender]:
            return Verdict.OTHER_INSTANCE
        if kind != OBSERVATIONS and not digest:
            return Verdict.INCOMPLETE
        if epoch != self.epoch or attempt != self.attempt:
            return Verdict.LATE if (epoch, attempt) < (self.epoch, self.attempt) else Verdict.EARLY
        if slot in self._inbox:
            return Verdict.DOUBLE
        if slot in self._awaited[self.phase]:
            return Verdict.CURRENT
        # the other half's: what came for SENSE is behind us, what comes for PREDICT is ahead
        return Verdict.EARLY if self.phase is Phase.SENSE else Verdict.DOUBLE

    def _judge(self, message: Message, out: list[Output]) -> None:
        verdict = self.judge(message.header)
        action = ACTIONS[verdict]
        if action is Action.TAKE:
            header = message.header
            self._inbox[header.sender, header.kind] = message
            self._advance(out)
        elif action is Action.HOLD and self._hold(message):
            return
        elif action is not Action.DROP:
            out.append(Refused(message.header, verdict))

    def _hold(self, message: Message) -> bool:
        held = self._held.setdefault((message.header.sender, message.header.kind), [])
        if len(held) >= HELD_MESSAGES:
            return False
        held.append(message)
        return True

    def _release(self, out: list[Output]) -> None:
        """Judge again what was held, as the epoch or its half has changed."""
        held, self._held = self._held, {}
        for slot in sorted(held):
            for message in held[slot]:
                self._judge(message, out)

    def _advance(self, out: list[Output]) -> None:
        """Go on as far as what is in hand allows."""
        while self.phase is not Phase.IDLE and len(self._inbox) == len(self._awaited[self.phase]):
            if self.phase is Phase.SENSE:
                self._do_sense(out)
            else:
                self._do_predict(out)
            if self._held:
                self._release(out)

    def _do_sense(self, out: list[Output]) -> None:
        inbox, self._inbox = self._inbox, {}
        belief = self.state.belief
        if self._world is None:
            self.time_s = inbox[self.node.below[0], OBSERVATIONS].header.time_s
            self._observations = _union(inbox, self.node.below, OBSERVATIONS)
            belief = self.node.observe(self.epoch, self.time_s, self._observations, belief)
            self._called(out, self.node.observe, belief)
        self._sensed = belief
        self.phase = Phase.PREDICT
        for upper in self.node.above:
            payload = self._elements(self._sense[upper], belief, out)
            out.append(Send(Message(self._header(OBSERVATIONS, upper, b""), payload)))

    def _do_predict(self, out: list[Output]) -> None:
        inbox, self._inbox = self._inbox, {}
        node, epoch, time_s = self.node, self.epoch, self.time_s
        tasks = _union(inbox, node.above, TASKS)
        context = _union(inbox, node.above, CONTEXT)
        policy = self.state.policy
        if node.above:
            policy = node.choose(epoch, time_s, tasks)
            self._called(out, node.select_policy, policy)
        act = node.policies[policy]
        actions = act.elements(epoch, time_s, self._sensed)
        self._called(out, act, actions)
        belief = node.predict(epoch, time_s, context, actions, self._sensed)
        self._called(out, node.predict, belief)
        self.state = ActiveNode(belief, policy, actions)
        encoded = self._encoded()
        self.digest = node_digest(encoded, [inbox[upper, CONTEXT].header.digest for upper in node.above])
        self._send_down(out)
        step = Step(
            epoch, self.attempt, time_s, self._observations, self._sensed, tasks, context, policy, actions, belief
        )
        out.append(Completed(step, encoded, self.digest))
        self._close_epoch(out)

    def _send_down(self, out: list[Output]) -> None:
        for lower in self.node.below:
            task = self._elements(self._task[lower], self.state.actions, out)
            out.append(Send(Message(self._header(TASKS, lower, self.digest), task)))
            context = self._elements(self._context[lower], self.state.belief, out)
            out.append(Send(Message(self._header(CONTEXT, lower, self.digest), context)))

    def _close_epoch(self, out: list[Output]) -> None:
        if self._world is None:
            self.epoch += 1
            self.attempt = 0
            self.phase = Phase.SENSE
            return
        out.append(Committed(self.epoch, self.attempt, self.digest))
        self.phase = Phase.IDLE

    def _elements(self, function: Call | None, argument: Value, out: list[Output]) -> Elements:
        if function is None:
            return ()
        elements = function.elements(self.epoch, self.time_s, argument)
        self._called(out, function, elements)
        return elements

    def _called(self, out: list[Output], call: Call, result: Value) -> None:
        if self._events:
            out.append(Called(self.epoch, self.attempt, call.subject, call.operator, result))

    def _header(self, kind: str, receiver: str, digest: bytes) -> Header:
        return Header(
            kind,
            self.name,
            receiver,
            self.epoch,
            self.attempt,
            self.place.roster,
            self._instance,
            self.time_s,
            digest,
        )

    def _encoded(self) -> bytes:
        """The state's bytes; a state that cannot be encoded is the operator's fault."""
        state = self.state
        try:
            return encode_state(state.belief, state.policy, state.actions)
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
    if len(senders) == 1:
        return inbox[senders[0], kind].payload
    return tuple(element for sender in senders for element in inbox[sender, kind].payload)
