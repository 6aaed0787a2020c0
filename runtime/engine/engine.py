"""The engine of one node: the table of `hierax.runtime.engine.table`, executed."""

from collections.abc import Mapping, Sequence

from hierax.runtime.core.binding import Call, epoch_time_s, is_finished
from hierax.runtime.core.difference import Vigilance, is_due
from hierax.runtime.core.digest import NO_DIGEST, cannot_travel, encode_state, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import ContradictionError, OperatorError
from hierax.runtime.core.node import World
from hierax.runtime.core.probe import Step
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.ahead import Ahead, Chosen
from hierax.runtime.engine.effects import Called, Committed, Completed, EngineEffects, Saved
from hierax.runtime.engine.table import (
    ACTIONS,
    ATTEMPTS_AHEAD,
    EPOCHS_AHEAD,
    ROSTERS_AHEAD,
    ROWS,
    Action,
    Held,
    Phase,
    Verdict,
)
from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, NO_EXTENSIONS, OBSERVATIONS, TASKS, Header, Message
from hierax.schemas.values import encode_value

AFTER = "after"
"""The header's extension of observations: which attempt of the epoch before counts, where that is not the first one."""

KEPT_ATTEMPTS = 8
"""Of how many attempts of an epoch, which other ones came after, the states at the end are kept until the next one."""

_NOTHING: Mapping[Slot, int] = {}
_NO_MESSAGES: Mapping[Slot, Message] = {}
SLOT_FIELDS = 7  # the first fields of a header: no two messages of a run share them

_PERHAPS_AGAIN = (Verdict.DOUBLE, Verdict.LATE, Verdict.OLD_ROSTER)


class Engine:
    """One node's part in every epoch; not for two threads at once. Raises `OperatorError` where an operator failed."""

    __slots__ = (  # more than thirty attributes: those of a dict would take 1.6 kB a node, and longer to be found
        *("name", "wiring", "node", "events", "begun", "inbox", "awaited", "phase", "digest", "time_s"),
        *("epoch", "attempt", "start", "state", "encoded_start", "encoded"),
        *("_effects", "_joins", "_fresh", "_prepared", "_held", "_superseded", "_roster", "_world"),
        *("_heard", "_told", "_heard_before", "_told_before", "_sent", "_after"),
        *("_belief", "_observations", "_sensed", "_intent", "_ahead", "_vigilance", "_tasked"),
    )

    def __init__(
        self,
        wiring: Wiring,  # the node, bound to its name and neighbours, and its edges
        # Called with all that is to be done, as soon as it is known: a task message before the context from above is
        # there, one node's context before the next one's.
        effects: EngineEffects,
        *,
        saved: Saved | None = None,  # where a crashed process of the node goes on; None: at the beginning
        joins: bool = False,  # whether it comes into a run: then it begins with the first epoch that it hears of
    ) -> None:
        self._effects = effects
        self.events = False  # whether every call gives an event; may be set at any time, by any thread
        self._joins = joins
        self.begun = False  # whether this engine has begun an epoch or attempt; one that was restored has not, yet
        self._prepared: dict[int, Wiring] = {}
        self._held = Held()
        self.inbox: dict[Slot, Message] = {}
        self._heard = self._told = self._heard_before = self._told_before = _NO_MESSAGES
        self._sent: dict[Slot, Message] = {}
        self._observations: Elements = ()
        self._sensed: Value = None
        self._intent: Chosen | None = None
        self._ahead = Ahead()
        self._vigilance: Vigilance | None = None
        self._tasked = 0  # how many tasks have come in this phase
        self._after = 0
        self._superseded: dict[int, tuple[ActiveNode, bytes]] = {}
        self.digest = NO_DIGEST
        self.time_s = 0.0
        self._wire(wiring)
        self._fresh = saved is None and self._world is None
        self.epoch = 0
        if saved is None:
            state = ActiveNode(wiring.node.initial_belief(0, 0.0), wiring.node.node.initial_policy)
            saved = Saved(0, 0, state, state)
        self.restore(saved)

    overlaps = False  # whether a node may be in another epoch than the world

    @property
    def waited(self) -> bool:
        """Whether the node has waited for somebody above in the last epoch that it has done."""
        return bool(self.node.above)

    @property
    def under_way(self) -> bytes:
        """What has to be kept beside the states, as `hierax.schemas.checkpoint` has it; nothing, where epochs end for
        all at once."""
        return b""

    @property
    def used(self) -> Sequence[tuple[str, str, int, int]]:
        """Sender, kind, epoch and attempt of the inputs of the last epoch, in order; none, where all are of the epoch
        itself."""
        return ()

    @property
    def is_world(self) -> bool:
        return self._world is not None

    @property
    def finished(self) -> bool:
        """Whether the world has nothing left to observe; never, for other nodes."""
        return self._world is not None and is_finished(self.name, self._world, self._belief, self.epoch)

    @property
    def prepared(self) -> frozenset[int]:
        return frozenset(self._prepared)

    def wiring_of(self, version: int) -> Wiring | None:
        return self.wiring if self._roster == version else self._prepared.get(version)

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        """From whom which messages are missing, in order."""
        if self.phase is Phase.DONE:
            return tuple(sorted(self.wiring.below))
        return tuple(sorted(self.awaited.keys() - self.inbox.keys()))

    def restore(self, saved: Saved) -> None:
        """Go on from here."""
        self.epoch = saved.epoch
        self.attempt = saved.attempt
        self.start = saved.start  # the node's state at the start of the epoch that it has begun last
        self.state = saved.now  # its state now: of the last epoch that it has finished, or `start` of the one under way
        self._belief: Value = saved.now.belief
        self.encoded_start = self._encoded_saved(saved.start)
        self.encoded = self._encoded_saved(saved.now)  # the bytes of `state`
        self.inbox.clear()
        self._enter(Phase.DONE)

    def take_over(self, saved: Saved) -> None:
        """Go on with the state of a node that this one replaces."""
        self.restore(saved)

    def begin(self, attempt: int = 0) -> None:
        """Begin the next epoch; only the world. `attempt`: its first one; not 0 where its process has died."""
        if self._world is None or self.phase is not Phase.DONE:
            raise ValueError(f"{self.name}: only a world that is done with an epoch begins the next one")
        self._after = self.attempt
        self._turn(self.epoch + 1, attempt)
        self._begin(self._world)

    def begin_again(self, attempt: int) -> None:
        """Do the epoch under way again, from its start, as a later attempt; only the world."""
        if self._world is None or self.phase is Phase.DONE or attempt <= self.attempt:
            raise ValueError(f"{self.name}: only a world that has begun an epoch begins it again, as a later attempt")
        self._undo(attempt)
        self._begin(self._world)

    def prepare(self, wiring: Wiring) -> None:
        """Have the wiring of a roster's version at hand, for when a message of it comes; it may be held already."""
        if wiring.roster <= self.wiring.roster:
            return
        self._prepared[wiring.roster] = wiring
        if self._held:
            self._release()

    def rewire(self, version: int) -> None:
        """Take up a prepared version: the world, before it begins an epoch or attempt of it."""
        self._wire(self._prepared[version])
        self._effects.rewired(version)
        self._prepared = {later: wiring for later, wiring in self._prepared.items() if later > version}

    def say_again(self, neighbour: str) -> None:
        """Send once more whatever a neighbour may still need: the link to it broke, and what was under way is lost.

        In epochs that end all at once that is what it was sent of the epoch's attempt: nobody goes on without it."""
        self.resend((neighbour,))

    def resend(self, receivers: Sequence[str]) -> None:
        """Send once more what these neighbours were sent of the epoch's attempt."""
        for receiver, kind in sorted(self._sent):
            if receiver in receivers:
                self._effects.send(self._sent[receiver, kind])

    def receive(self, message: Message) -> None:
        """Take a message in, by the table. Raises `ContradictionError` if it contradicts another one."""
        header = message.header
        kind, sender, receiver, epoch, attempt, roster, instance, _, digest, _ = header
        slot = (sender, kind)
        if (  # CURRENT: what epochs are made of
            epoch == self.epoch
            and attempt == self.attempt
            and self.awaited.get(slot) == instance
            and roster == self._roster
            and slot not in self.inbox
            and receiver == self.name
            and (digest or kind != CONTEXT)
        ):
            self._take(slot, message)
        elif (  # NEXT: with what they begin
            epoch == self.epoch + 1
            and self.phase is Phase.DONE
            and self.wiring.below.get(slot) == instance
            and roster == self._roster
            and attempt - self.attempt <= ATTEMPTS_AHEAD
            and receiver == self.name
        ):
            self._begin_with(slot, message)
        else:
            self._receive_by_table(message)

    def _begin_with(self, slot: Slot, message: Message) -> None:
        """The first observations of an epoch: the last one was committed."""
        header = message.header
        self._after = _attempt_before(header)
        if not self._joins:
            self.go_back_to(self._after)
        self._turn(header.epoch, header.attempt)
        self._take(slot, message)

    def _receive_by_table(self, message: Message) -> None:
        """As `receive`, which is quicker with what is CURRENT or NEXT."""
        header = message.header
        slot, attempt = (header.sender, header.kind), header.attempt
        verdict = self.judge(header)
        if verdict is Verdict.CURRENT:
            self._take(slot, message)
        elif verdict is Verdict.NEXT:
            self._begin_with(slot, message)
        elif verdict in _PERHAPS_AGAIN and self._is_again(slot, message):
            return
        elif verdict is Verdict.AGAIN:
            self._after = _attempt_before(header)  # this process may not have begun the epoch before
            self._undo(attempt)
            self._take(slot, message)
        elif verdict is Verdict.NEW_ROSTER and self._takes_up(header):
            self.rewire(header.roster)
            self.receive(message)
        elif ACTIONS[verdict] is Action.REFUSE:
            self._effects.refused(header, verdict)
        elif ACTIONS[verdict] is Action.HOLD:
            self._hold(message, verdict)

    def go_back_to(self, attempt: int) -> None:
        """Have the state after the attempt that counts. Raises `ContradictionError` if it was not done here."""
        if attempt == self.attempt:
            return
        if attempt not in self._superseded:
            what = f"it has done attempt {self.attempt} of epoch {self.epoch}, and attempt {attempt} counts"
            raise ContradictionError(f"{self.name}: {what}: somebody else speaks in the name of a node below it")
        self.attempt = attempt
        self.state, self.encoded = self._superseded[attempt]
        self._effects.save(self.epoch, attempt, self.encoded_start, self.encoded)

    def judge(self, header: Header) -> Verdict:
        """What a message with this header is to the node now."""
        slot = (header.sender, header.kind)
        for row in ROWS:
            if row.fits(self, header, slot):
                return row.verdict
        raise AssertionError("the last row fits everything")

    def compare(self, message: Message) -> None:
        """Take nothing more in. Raises `ContradictionError` if a message contradicts one that was."""
        self._is_again((message.header.sender, message.header.kind), message)

    _epochs_ahead: float = EPOCHS_AHEAD

    def is_ahead(self, epoch: int, attempt: int, roster: int) -> bool:
        if attempt - self.attempt > ATTEMPTS_AHEAD or roster - self._roster > ROSTERS_AHEAD:
            return True
        return epoch - self.epoch > self._epochs_ahead and not self._joins

    def _is_again(self, slot: Slot, message: Message) -> bool:
        """Whether a message was taken before. Raises `ContradictionError` if that said something else."""
        for taken in (self.inbox, self._heard, self._told, self._heard_before, self._told_before):
            known = taken.get(slot)
            if known is not None and known.header[:SLOT_FIELDS] == message.header[:SLOT_FIELDS]:
                self._check_same(known, message)
                return True
        return False

    def _check_same(self, known: Message, message: Message) -> None:
        if known is message or self._said(known) == self._said(message):
            return
        header = message.header
        what = f"two {header.kind} messages from {header.sender} of epoch {header.epoch}, attempt {header.attempt}"
        whose = f"{header.sender} (instance {header.instance}, roster {header.roster})"
        raise ContradictionError(
            f"{self.name}: {what} say different things: somebody else speaks in the name of {whose}"
        )

    def _said(self, message: Message) -> bytes:
        """All that counts of a message, but for what tells it apart from others."""
        header = message.header
        return encode_value((header.time_s, header.digest, message.payload))

    def moves_on(self, epoch: int) -> bool:
        if self.phase is not Phase.DONE:
            return False
        return epoch == self.epoch + 1 or (self._joins and epoch > self.epoch)

    def _takes_up(self, header: Header) -> bool:
        """Whether a message is the one with which its roster takes effect here."""
        wiring = self._prepared.get(header.roster)
        if wiring is None or header.receiver != self.name:
            return False
        return wiring.below.get((header.sender, header.kind)) == header.instance and self._is_later(header)

    def _is_later(self, header: Header) -> bool:
        return self.moves_on(header.epoch) or (header.epoch == self.epoch > 0 and header.attempt > self.attempt)

    def _hold(self, message: Message, verdict: Verdict) -> None:
        """Keep a message for later; where there is no room, the furthest ahead is refused."""
        header = message.header
        slot = (header.sender, header.kind)
        wirings = (self.wiring, *self._prepared.values())
        is_neighbour = any(slot in wiring.below or slot in wiring.above for wiring in wirings)
        for refused in self._held.put(message, is_neighbour):
            self._effects.refused(refused.header, verdict)
            if refused is message:
                return
        if verdict is Verdict.NEW_ROSTER and header.roster not in self._prepared:
            self._effects.lacks(header.roster)

    def _release(self) -> None:
        """Judge again what was held, as the epoch, its half or the roster has changed."""
        for message in self._held.take():
            self.receive(message)

    def _wire(self, wiring: Wiring) -> None:
        node = wiring.node
        self.wiring = wiring
        self.name = node.name
        self.node = node
        self._roster = wiring.roster
        self._world = node.node if isinstance(node.node, World) and not node.below else None

    def _turn(self, epoch: int, attempt: int) -> None:
        """An epoch begins: the last one was committed."""
        if self._fresh:  # a process without a checkpoint has never taken part in an epoch: its start is the initial one
            self._fresh = False
            self._effects.save(epoch - 1, self._after, self.encoded, self.encoded)
        self._joins = False
        self._heard_before, self._told_before = self._heard, self._told
        self.start = self.state
        self.encoded_start = self.encoded
        self.epoch = epoch
        self._superseded.clear()
        self._restart(attempt)

    @property
    def _turn_number(self) -> int:
        """Which of its turns the epoch under way is to the node."""
        return self.epoch

    def _undo(self, attempt: int) -> None:
        """The epoch is done again, from its start; nobody but the world knows yet which attempt will count."""
        if self.phase is Phase.DONE and len(self._superseded) < KEPT_ATTEMPTS:
            self._superseded[self.attempt] = (self.state, self.encoded)
        self.state = self.start
        self.encoded = self.encoded_start
        self._restart(attempt)

    def _restart(self, attempt: int) -> None:
        self._belief = self.state.belief
        self.attempt = attempt
        self.begun = True
        self.inbox = {}
        self._heard = self._told = _NO_MESSAGES
        self._sent.clear()
        self._intent = None
        self._vigilance = Vigilance() if is_due(self._turn_number) else None
        self._enter(Phase.SENSE)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._tasked = 0
        if phase is Phase.SENSE:
            self.awaited = self.wiring.below
        elif phase is Phase.PREDICT:
            self.awaited = self.wiring.above
        else:
            self.awaited = _NOTHING

    def _begin(self, world: World) -> None:
        self.time_s = epoch_time_s(self.name, world, self._belief, self.epoch)
        self._sensed = self._belief
        if self._vigilance:
            self._vigilance.keep("belief", self._belief)
        self._send_up()

    def _take(self, slot: Slot, message: Message) -> None:
        self.inbox[slot] = message
        if len(self.inbox) < len(self.awaited):
            if slot[1] == TASKS:
                self._tasked += 1
                if self._tasked == len(self.wiring.tasking):
                    self._act_early()
            return
        if self.phase is Phase.SENSE:
            self._sense()
        else:
            self._predict()

    def _sense(self) -> None:
        self._heard = inbox = self.inbox
        node = self.node
        self.time_s = inbox[node.below[0], OBSERVATIONS].header.time_s
        self._observations = observations = _union(inbox, node.below, OBSERVATIONS)
        vigilance = self._vigilance
        if vigilance:
            vigilance.keep("belief", self._belief)
            vigilance.keep("observations", observations)
        self._sensed = sensed = self._observe(observations)
        if sensed is None:
            node.accept_none(node.observe, self.epoch)
        if vigilance or self.events:
            self._called(node.observe, sensed)
        if vigilance:
            vigilance.keep("belief", sensed)
        self.inbox = {}  # not before: where an operator raises, nothing is taken in a second time
        self._send_up()

    def _observe(self, observations: Elements) -> Value:
        return self.node.observe(self.epoch, self.time_s, observations, self._belief)

    def _send_up(self) -> None:
        self._enter(Phase.PREDICT)
        epoch, time_s, belief = self.epoch, self.time_s, self._sensed
        sensed = None if self._world is None else self._ahead.observations(epoch, belief, self.wiring.sense)
        for number, (upper, sense) in enumerate(self.wiring.sense):
            elements: Elements = ()
            if sense is not None:
                elements = sensed[number] if sensed else sense.elements(epoch, time_s, belief)
                if self._vigilance or self.events:
                    self._called(sense, elements)
            self._send(OBSERVATIONS, upper, elements, b"")
        if not self.awaited:
            self._predict()
            return
        if not self.wiring.tasking:
            self._act_early()
        if self._held:
            self._release()

    def _act_early(self) -> None:
        """Where all tasks are in: what they ask for is on its way down before the context from above is there."""
        chosen = self._act()
        world = self._world
        if world is not None and world.works_ahead:
            known = self._ahead.predict(chosen, self._predicted)
            if known:
                self._ahead.sense(self.node, world, self.wiring.sense, self.epoch + 1, known[0])

    def _act(self) -> Chosen:
        """The tasks, the policy and its actions; task messages leave."""
        wiring, node, epoch, time_s, sensed = self.wiring, self.node, self.epoch, self.time_s, self._sensed
        tasks = _union(self.inbox, wiring.tasking, TASKS) if wiring.tasking else ()
        policy = self.state.policy
        vigilance = self._vigilance
        if vigilance:
            vigilance.keep("tasks", tasks)
        if node.above:
            policy = node.choose(epoch, time_s, tasks)
            if vigilance or self.events:
                self._called(node.select_policy, policy)
        act = node.policies[policy]
        actions = act.elements(epoch, time_s, sensed)
        if vigilance or self.events:
            self._called(act, actions)
        if vigilance:
            vigilance.keep("actions", actions)
        self._send_tasks(actions)
        self._intent = chosen = (tasks, policy, actions)
        return chosen

    def _predict(self) -> None:
        self._told = inbox = self.inbox
        node = self.node
        chosen = self._intent or self._act()
        tasks, policy, actions = chosen
        above = node.above
        context = _union(inbox, above, CONTEXT) if above else ()
        vigilance = self._vigilance
        if vigilance:
            vigilance.keep("context", context)
        known = () if self._world is None else self._ahead.belief(chosen, context)
        belief = known[0] if known else self._predicted(context, actions)
        if vigilance or self.events:
            self._called(node.predict, belief)
        self.state = state = ActiveNode(belief, policy, actions)
        self._belief = belief
        self.encoded = encoded = self._encoded(state)
        self.digest = node_digest(encoded, [inbox[upper, CONTEXT].header.digest for upper in above])
        self.inbox = {}
        self._enter(Phase.DONE)
        self._hand_on(tasks, context)

    def _predicted(self, context: Elements, actions: Elements) -> Value:
        """The belief that the node predicts."""
        predict = self.node.predict
        belief = predict(self.epoch, self.time_s, context, actions, self._sensed)
        if belief is None:
            self.node.accept_none(predict, self.epoch)
        return belief

    def _send_tasks(self, actions: Elements) -> None:
        for lower, task in self.wiring.task:
            elements = task.elements(self.epoch, self.time_s, actions)
            if self._vigilance or self.events:
                self._called(task, elements)
            self._send(TASKS, lower, elements, b"")

    def _hand_on(self, tasks: Elements, context: Elements) -> None:
        epoch, attempt, time_s, effects = self.epoch, self.attempt, self.time_s, self._effects
        belief, policy, actions = self.state
        step = Step(epoch, attempt, time_s, self._observations, self._sensed, tasks, context, policy, actions, belief)
        completed = Completed(step, self.encoded, self.digest)
        effects.predicted(completed)
        if self._vigilance:
            self._vigilance.keep("belief", belief)
        if self._world is None:
            self._tell_below()
        else:
            effects.act(epoch, actions)
            if self._vigilance and self.node.act:
                self._vigilance.check(self.node.act, epoch)
            effects.committed(Committed(epoch, attempt, self.digest))
        effects.completed(completed)
        if self._held:
            self._release()

    def _tell_below(self) -> None:
        """First the checkpoint: who has heard of a prediction goes on."""
        self._effects.save(self.epoch, self.attempt, self.encoded_start, self.encoded)
        self._send_context()

    def _send_context(self) -> None:
        for lower, enrich in self.wiring.context:
            elements: Elements = ()
            if enrich is not None:
                elements = enrich.elements(self.epoch, self.time_s, self._belief)
                if self._vigilance or self.events:
                    self._called(enrich, elements)
            self._send(CONTEXT, lower, elements, self.digest)

    def _send(self, kind: str, receiver: str, elements: Elements, digest: bytes) -> None:
        wiring = self.wiring
        header = Header(
            kind, self.name, receiver, self.epoch, self.attempt, wiring.roster, wiring.instance, self.time_s, digest
        )
        if self._after or self._extends:
            header = header._replace(extensions=self._extensions(kind))
        self._deliver(Message(header, elements))

    def _deliver(self, message: Message) -> None:
        self._sent[message.header.receiver, message.header.kind] = message
        self._effects.send(message)

    _extends = False

    def _extensions(self, kind: str) -> Mapping[str, Value]:
        return {AFTER: self._after} if self._after and kind == OBSERVATIONS else NO_EXTENSIONS

    def _called(self, call: Call, result: Value) -> None:
        """Where somebody watches, or it is looked at whether operators leave alone what they are given."""
        if self._vigilance:
            self._vigilance.check(call, self.epoch)
        if self.events:
            self._effects.called(Called(self.epoch, self.attempt, call.subject, call.operator, result))

    def _encoded(self, state: ActiveNode) -> bytes:
        """The bytes of the state that the operators have made."""
        try:
            return encode_state(state.belief, state.policy, state.actions)
        except SchemaError as error:
            raise cannot_travel(self.name, self.epoch, self._sensed, state, error) from error

    def _encoded_saved(self, state: ActiveNode) -> bytes:
        try:
            return encode_state(state.belief, state.policy, state.actions)
        except SchemaError as error:
            operator = "take_over" if self.epoch else "initial_belief"
            raise OperatorError(self.name, operator, self.epoch, f"its belief: {error}") from error


def _attempt_before(header: Header) -> int:
    if not header.extensions:
        return 0
    counts = header.extensions.get(AFTER, 0)
    return counts if type(counts) is int else 0


def _union(inbox: Mapping[Slot, Message], senders: Sequence[str], kind: str) -> Elements:
    """The elements of all senders, in name order; doubles are kept."""
    if len(senders) == 1:  # as it mostly is
        return inbox[senders[0], kind].payload
    return tuple(element for sender in senders for element in inbox[sender, kind].payload)
