"""The engine of a hierarchy with rates: nodes take part in some epochs, and inputs from above count some epochs later.

A node passes the epochs in which it takes part, or somebody above it does, one after the other; in those that are not
its turn it calls no operator of its own, and only hands on. Of other epochs it is told nothing, unless one is drained:
nothing of a later one comes before all are done with that. What comes down is sent in turns alone, and kept for as long
as it may count. Which epoch's input counts follows from the rates, not from what has come: a node waits for it.

`SayingEngine` has what it says, and says again."""

from collections.abc import Mapping

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.engine.coming import ComingEpochs
from hierax.runtime.engine.effects import EngineEffects, Saved
from hierax.runtime.engine.kept import KeptMessages, drop_before
from hierax.runtime.engine.own_rates import OwnRates
from hierax.runtime.engine.said import SaidMessages
from hierax.runtime.engine.saying import SayingEngine
from hierax.runtime.engine.table import ACTIONS, EPOCHS_AHEAD, Action, Phase, Verdict
from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.checkpoint import decode_under_way, encode_under_way
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, DRAIN, GREETING, NO_EXTENSIONS, OBSERVATIONS, Header, Message
from hierax.schemas.rates import Rates
from hierax.schemas.values import fits


class RatedEngine(SayingEngine):
    """One node's part in every epoch, by the rates of its hierarchy.

    In a drained epoch a node that takes part hands on its context when all above it are done, and one that does not
    hands on an empty one: so at its end all nodes are done with it."""

    overlaps = True

    def __init__(
        self, wiring: Wiring, effects: EngineEffects, *, saved: Saved | None = None, joins: bool = False
    ) -> None:
        self._kept = KeptMessages()
        self._takes_part = False  # in the epoch under way
        self._counting: dict[Slot, int] = {}  # the epochs whose inputs from above count in it
        self._told_above: frozenset[str] = frozenset()  # who above has to pass it
        self._told_rates: Rates | None = None  # what the roster says of rates
        self._has_waited = False
        self._greets = joins or saved is not None  # whether neighbours may have more than this process knows of
        self.drains = False  # whether the epoch under way is a drained one; of the world's, to be set before it begins
        self.overruns: dict[str, int] = {}  # by node above, how often its delayed prediction was waited for
        comes = joins and wiring.place.rates is not None and wiring.node.name in wiring.place.rates.timing.fresh
        super().__init__(wiring, effects, saved=saved, joins=comes)

    def _wire(self, wiring: Wiring) -> None:
        super()._wire(wiring)
        self._instances = {**wiring.below, **wiring.above}
        if self._told_rates is not None and wiring.place.rates is self._told_rates:
            self._take_rates(self._rates)  # a version that changes nothing of them: it is known since when they hold
            return
        self._told_rates = wiring.place.rates
        self._take_rates(self._told_rates or Rates())
        name, delays = self.name, self._rates.delays
        apart = self._rates.turns_of(name).every + max(
            (delays.get((lower, name), 0) for lower in self.node.below), default=0
        )
        self._epochs_ahead = max(EPOCHS_AHEAD, 2 * apart)  # also of one that comes back, and is behind

    def _take_rates(self, rates: Rates) -> None:
        self._rates, self._own = rates, OwnRates(rates, self.wiring)

    def restore(self, saved: Saved) -> None:
        if not saved.epoch and not self._joins:  # the first epoch of a node that came later is its first one
            before = self._rates.timing.since.get(self.name, 1) - 1
            saved = saved._replace(epoch=before)
        super().restore(saved._replace(attempt=0))
        self._coming = ComingEpochs(self._own.passes, self.epoch)
        self._turned = saved.epoch  # the last epoch whose state was saved; those after it that are past change nothing
        self._remembered = None
        self._gathered: dict[str, list[Value]] = {}
        self._unheard = SaidMessages()
        if saved.under_way:
            under_way = decode_under_way(saved.under_way)
            self._remembered = under_way.sensed
            self._unheard = SaidMessages(under_way.said, under_way.forgotten)
            self._gathered = {lower: list(elements) for lower, elements in under_way.gathered.items()}
        if not self._joins:
            self._begin_rates()

    def take_over(self, saved: Saved) -> None:
        self._joins = False
        super().take_over(saved)

    @property
    def under_way(self) -> bytes:
        said, forgotten = self._unheard.encoded(), self._unheard.forgotten
        gathered = {lower: tuple(elements) for lower, elements in self._gathered.items()} if self._gathered else {}
        try:
            return encode_under_way(self._remembered, said, forgotten, gathered)
        except SchemaError:  # a belief is looked at when it has predicted; before, it need not be one that can travel
            return encode_under_way(None, said, forgotten, gathered)

    @property
    def waited(self) -> bool:
        return self._has_waited

    @property
    def used(self) -> tuple[tuple[str, str, int, int], ...]:
        """Of what an edge gathers, each epoch of which there is something; epoch 0: nothing counts yet."""
        observed = [row for slot, message in self._heard.items() for row in self._observed(slot, message)]
        return tuple(sorted(observed + [(*slot, *message.header.when) for slot, message in self._told.items()]))

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        return tuple(sorted(self._lacking()))

    @property
    def in_force(self) -> Mapping[str, int]:
        """By upper neighbour, the epoch whose context and tasks count in the node's last turn; 0: there were none."""
        rates, name = self._rates, self.name
        turn = rates.last_turn(name, self.epoch)
        return {upper: rates.in_force(name, upper, turn) if turn else 0 for upper in self.node.above}

    def go_back_to(self, attempt: int) -> None:
        """An epoch has one attempt, whatever its number."""

    # --- what the world is told to do

    def begin(self, attempt: int = 0) -> None:
        """Begin the next epoch. Its number of attempts is the owner's: here each has one."""
        self._greet_first()
        self._extends = self.drains
        super().begin(0)
        self._go_on()

    def begin_again(self, attempt: int) -> None:
        """A process was lost, and another is there: go on with the epoch under way, or be there for those behind."""
        self.begun = self._greets = True
        self._greet_first()
        self._go_on()

    def rewire(self, version: int) -> None:
        super().rewire(version)
        self._greets = True
        if not self._joins:
            self._begin_rates()
        elif self.name in self._rates.timing.since:
            self._join(self._rates.timing.since[self.name])

    def _begin_rates(self) -> None:
        """Take up the rates of a roster with the next epoch, where that is its first one; what was said along edges
        that are gone, or to a node that had the name of a new one, is not said any more."""
        rates = self._rates.as_of(self.epoch + 1)
        self._take_rates(rates)
        self._coming.begin(self._own.passes, self.epoch)
        since = {lower: rates.since(lower, self.name) for lower in self.node.below}
        since |= {upper: rates.since(self.name, upper) for upper in self.node.above}
        self._unheard.only(since)
        self._kept.only({slot: since[slot[0]] for slot in self._instances})
        self._kept.count(self._counting)
        gathering = {lower for lower in since if (lower, self.name) in rates.gathers and self.epoch >= since[lower]}
        self._gathered = {lower: each for lower, each in self._gathered.items() if lower in gathering}

    def _join(self, epoch: int) -> None:
        """Begin with this epoch, the first one under the roster with which the node came; what came before that was
        known is said again."""
        self._joins = False
        self.epoch = self._turned = epoch - 1
        self._begin_rates()
        self._greets = True
        self._greet_first()

    def is_done_with(self, epoch: int) -> bool:
        """Whether nothing is left to be done up to an epoch, which the node may have no part in."""
        return self.phase is Phase.DONE and self._coming.next > epoch

    # --- what comes

    def receive(self, message: Message) -> None:
        if not self.begun and self.is_world:
            return  # what comes of the roster on record was for the world's last process; all is said again
        header = message.header
        kind, sender, receiver, epoch, attempt, roster, instance, _, digest, _ = header
        if (  # what epochs are made of
            roster == self._roster
            and self._instances.get((sender, kind)) == instance
            and receiver == self.name
            and attempt == 0
            and epoch - self.epoch <= self._epochs_ahead
            and (digest or kind != CONTEXT)
        ):
            self._take_in(message)
        else:
            self._receive_by_table(message)

    def _receive_by_table(self, message: Message) -> None:
        header = message.header
        verdict = self.judge(header)
        if verdict is Verdict.NEW_ROSTER:
            self._receive_of_new_roster(message)
        elif ACTIONS[verdict] is Action.REFUSE:
            self._effects.refused(header, verdict)
        else:
            self._take_in(message)

    def _receive_of_new_roster(self, message: Message) -> None:
        if not self._takes_up(message.header):
            self._hold(message, Verdict.NEW_ROSTER)
            return
        self.rewire(message.header.roster)
        self._take_in(message)
        self._release()

    def _take_in(self, message: Message) -> None:
        header = message.header
        self.begun = True
        if self._greets:
            self._greet_first()
        epoch = header.epoch
        if epoch == GREETING:
            self._hear_greeting(header, message.payload)
            return
        if self._joins:
            return
        self._forget(header)
        slot = (header.sender, header.kind)
        kept = self._kept[slot]
        if epoch not in kept and (self._counting.get(slot) == epoch or self._is_wanted(header, slot)):
            kept[epoch] = message
        else:
            self.compare(message)
        self._go_on()

    def _hear_greeting(self, header: Header, greeting: Elements) -> None:
        done, since = greeting if fits(greeting, tuple[int, int]) else (0, 0)
        self._check_sound(header.sender, header.instance, done)
        if self._joins and since > 0 and header.kind == OBSERVATIONS:
            self._join(since)
        self._say_what_it_lacks(header.sender)

    def compare(self, message: Message) -> None:
        slot = (message.header.sender, message.header.kind)
        known = self._kept[slot].get(message.header.epoch)
        if known is None:
            self._compare_taken(slot, message)
        else:
            self._check_same(known, message)

    def _compare_taken(self, slot: Slot, message: Message) -> None:
        """Raises `ContradictionError` if observations of this epoch, or of the one before, said something else, under
        whatever roster; what an edge has gathered is not at hand as it came."""
        if (slot[0], self.name) in self._rates.gathers:
            return
        for taken in (self._heard, self._heard_before):
            known = taken.get(slot)
            if known is not None and known.header.epoch == message.header.epoch:
                self._check_same(known, message)

    def is_ahead(self, epoch: int, attempt: int, roster: int) -> bool:
        return attempt != 0 or super().is_ahead(epoch, attempt, roster)

    def _takes_up(self, header: Header) -> bool:
        """Whether its roster is at hand, and it comes from a neighbour that has taken that up: so it is in force."""
        wiring = self._prepared.get(header.roster)
        if wiring is None or header.receiver != self.name:
            return False
        slot = (header.sender, header.kind)
        return header.instance == wiring.below.get(slot, wiring.above.get(slot))

    def _is_wanted(self, header: Header, slot: Slot) -> bool:
        """Whether it may count yet, in a later epoch."""
        epoch = header.epoch
        if slot in self.wiring.below:
            return self._coming.include(epoch, DRAIN in header.extensions)
        return epoch >= self._own.above[slot].in_force(self.epoch)

    # --- what can be done with it

    def _go_on(self) -> None:
        """Do all that can be done with what is in hand; a world begins no epoch by itself."""
        while True:
            if self.phase is Phase.DONE:
                epoch = self._complete()
                if not epoch:
                    return
                self._turn(epoch, 0)
                self.inbox = self._kept.taken(self.wiring.below, epoch)
                self._sense()
            elif self._kept.lacks() or (self.drains and self._lacking_above()):
                self._has_waited = True
                return
            else:
                self._predict()

    def _turn(self, epoch: int, attempt: int) -> None:
        super()._turn(epoch, attempt)
        self._coming.look_on(epoch)
        self._has_waited = False
        self._takes_part = self._own.takes_part(self.name, epoch)
        self._counting = self._own.counting(epoch) if self._takes_part else {}
        self._kept.count(self._counting)
        self._told_above = self._own.told_above(epoch)

    @property
    def _turn_number(self) -> int:
        """Turns are counted: those of some nodes are in no epoch whose number has many twos in it."""
        every = self._rates.turns_of(self.name).every
        return self.epoch // every if self._own.takes_part(self.name, self.epoch) else self.epoch

    def _complete(self) -> int:
        """The first of the epochs that come next of which all observations are there; 0: of none, as for the world.

        Where it is not the first one of all, that was a drained one, and is over: else nobody had begun another."""
        if self._world is None:
            for epoch in self._coming.epochs:
                if self._kept.has_all(self.wiring.below, epoch):
                    return epoch
        return 0

    def _lacking(self) -> list[Slot]:
        """Of whom there is no input with which the node could go on."""
        if self.phase is not Phase.DONE:
            return self._lacking_above()
        return [slot for slot in self.wiring.below if self._coming.epochs[0] not in self._kept[slot]]

    def _lacking_above(self) -> list[Slot]:
        lacking = self._kept.lacking(self._counting)
        if self.drains and not self._complete():
            lacking += [slot for slot in self._under_way_above() if slot not in lacking]
        return lacking

    def _under_way_above(self) -> list[Slot]:
        """Of a drained epoch, who is not done with it; who has a part in a later one was, if by another process."""
        return [slot for slot in self.wiring.above if slot[1] == CONTEXT and self.epoch not in self._kept[slot]]

    def _in_force(self, slot: Slot) -> Message:
        """What counts of a slot in this epoch: it has come, or there is none yet."""
        found = self._kept[slot].get(self._counting[slot])
        if found is not None:
            return found
        (sender, kind), instance = slot, self.wiring.above[slot]
        return Message(Header(kind, sender, self.name, 0, 0, self._roster, instance, 0.0, NO_DIGEST), ())

    def _sense(self) -> None:
        self.drains = self._extends = _drains(self.inbox)
        if self._rates.gathers:
            self._gather()
        if self._takes_part:
            super()._sense()
            return
        self.time_s = self.inbox[self.node.below[0], OBSERVATIONS].header.time_s
        self._sensed = self._belief
        if self._vigilance:
            self._vigilance.keep("belief", self._belief)
        self.inbox = {}
        self._send_up()

    def _gather(self) -> None:
        """Keep what is to be had in the next turn; in the turn itself, have it."""
        for slot, message in self.inbox.items():
            lower = slot[0]
            if (lower, self.name) in self._rates.gathers:
                gathered = self._gathered.setdefault(lower, [])
                gathered += [(self.epoch, element) for element in message.payload]
                if self._takes_part:
                    self.inbox[slot] = Message(message.header, tuple(self._gathered.pop(lower)))

    def _observed(self, slot: Slot, message: Message) -> list[tuple[str, str, int, int]]:
        """Which messages are observed in a slot."""
        if (slot[0], self.name) not in self._rates.gathers:
            return [(*slot, *message.header.when)]
        return [(*slot, epoch, 0) for epoch in dict.fromkeys(epoch for epoch, _ in message.payload)]

    def _observe(self, observations: Elements) -> Value:
        """A process that comes back has said what follows from the belief of before: that counts, and no other one."""
        if self._remembered is not None and self._remembered[0] == self.epoch:
            return self._remembered[1]
        sensed = super()._observe(observations)
        if not (self.wiring.task or self.drains or self._told_above):
            return sensed  # nobody hears what follows from it before there is a checkpoint of the turn
        self._remembered = (self.epoch, sensed)
        self._effects.save(self._turned, 0, self.encoded_start, self.encoded)
        return sensed

    def _send_up(self) -> None:
        """Then it waits for what is above, if it is its turn; `_go_on` looks whether that is here."""
        self._enter(Phase.PREDICT if self._takes_part or self.drains else Phase.DONE)
        for upper, sense in self.wiring.sense:
            if upper not in self._told_above and not self.drains:
                continue
            elements: Elements = ()
            if sense is not None and self._own.is_sensed(upper, self.epoch):
                elements = sense.elements(self.epoch, self.time_s, self._sensed)
                if self._vigilance or self.events:
                    self._called(sense, elements)
            self._send(OBSERVATIONS, upper, elements, b"")
        if self._takes_part and self._rates.delays:
            self._note_overruns()

    def _note_overruns(self) -> None:
        """Who above has not come to an end in the epochs that a delay gives it."""
        for sender in {sender for sender, _ in self._kept.lacking(self._counting)}:
            if (self.name, sender) in self._rates.delays:
                self.overruns[sender] = self.overruns.get(sender, 0) + 1

    def _predict(self) -> None:
        if not self._takes_part:  # in a drained epoch those above are done
            self._enter(Phase.DONE)
            self._say_what_is_saved(self._hand_on_nothing)
            return
        inbox = self.inbox = {}
        for slot, oldest in self._counting.items():
            inbox[slot] = self._in_force(slot)
            if len(self._kept[slot]) > 1:
                drop_before(self._kept[slot], oldest)
        super()._predict()

    def _extensions(self, kind: str) -> Mapping[str, Value]:
        return {DRAIN: True} if kind == OBSERVATIONS else NO_EXTENSIONS


def _drains(inbox: Mapping[Slot, Message]) -> bool:
    for message in inbox.values():  # noqa: SIM110 - a loop takes a third of the time of any()
        if DRAIN in message.header.extensions:
            return True
    return False
