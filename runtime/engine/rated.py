"""The engine of a hierarchy with rates: nodes take part in some epochs, and inputs from above count some epochs later.

Observations are sent on every edge in every epoch, so that each node passes all epochs, one after the other; in those
that are not its turn it calls no operator of its own, and only hands on. What comes down is sent in turns alone, and
kept for as long as it may count. Which epoch's input counts follows from the rates, not from what has come: a node
waits for it. There is one attempt of each epoch and one roster here: it is the engine of runs in one process."""

from math import inf

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.rates import Rates
from hierax.runtime.engine.effects import EngineEffects
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.table import ACTIONS, Action, Phase
from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.messages import OBSERVATIONS, Header, Message


class RatedEngine(Engine):
    """One node's part in every epoch, by the rates of its hierarchy."""

    def __init__(self, wiring: Wiring, effects: EngineEffects, *, rates: Rates) -> None:
        self._rates = rates  # of the whole hierarchy
        self._kept: dict[Slot, dict[int, Message]] = {}
        self._gathered: dict[str, list[Value]] = {}
        super().__init__(wiring, effects)

    _epochs_ahead = inf  # of a slow node those below may be ahead by its delays

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        return tuple(sorted(self._lacking()))

    def begin(self, attempt: int = 0) -> None:
        super().begin(attempt)
        self._go_on()

    def receive(self, message: Message) -> None:
        verdict = self.judge(message.header)
        if ACTIONS[verdict] is Action.REFUSE:
            self._effects.refused(message.header, verdict)
            return
        self._keep(message)
        self._go_on()

    def _keep(self, message: Message) -> None:
        header = message.header
        slot = (header.sender, header.kind)
        kept = self._kept.setdefault(slot, {})
        known = kept.get(header.epoch)
        if known is not None:
            self._check_same(known, message)
        elif header.epoch >= self._oldest(slot):
            kept[header.epoch] = message

    def _oldest(self, slot: Slot) -> int:
        """The first epoch whose message of a slot may be wanted yet."""
        if slot in self.wiring.below:
            return self.epoch + 1
        return self._rates.in_force(self.name, slot[0], self.epoch)

    def _lacking(self) -> list[Slot]:
        """Of whom there is no input with which the node could go on."""
        if self.phase is Phase.DONE:
            return [slot for slot in self.wiring.below if self.epoch + 1 not in self._kept.get(slot, ())]
        return [slot for slot in self.wiring.above if self._in_force(slot) is None]

    def _in_force(self, slot: Slot) -> Message | None:
        """What counts of a slot in this epoch; None: it has not come."""
        sender, kind = slot
        epoch = self._rates.in_force(self.name, sender, self.epoch)
        if epoch:
            return self._kept.get(slot, {}).get(epoch)
        instance = self.wiring.above[slot]
        return Message(Header(kind, sender, self.name, 0, 0, self._roster, instance, 0.0, NO_DIGEST), ())

    def _go_on(self) -> None:
        """Do all that can be done with what is in hand; a world begins no epoch by itself."""
        while not self._lacking() and not (self.is_world and self.phase is Phase.DONE):
            if self.phase is Phase.DONE:
                self._turn(self.epoch + 1, 0)
                self.inbox = {slot: self._kept[slot].pop(self.epoch) for slot in self.wiring.below}
                self._sense()
            else:
                self._predict()

    def _sense(self) -> None:
        self._gather()
        if self._rates.takes_part(self.name, self.epoch):
            super()._sense()
            return
        self.time_s = self.inbox[self.node.below[0], OBSERVATIONS].header.time_s
        self._sensed = self._belief
        self.inbox = {}
        self._send_up()

    def _gather(self) -> None:
        """Keep what is to be had in the next turn; in the turn itself, have it."""
        for slot, message in self.inbox.items():
            lower = slot[0]
            if (lower, self.name) in self._rates.gathers:
                gathered = self._gathered.setdefault(lower, [])
                gathered += [(self.epoch, element) for element in message.payload]
                if self._rates.takes_part(self.name, self.epoch):
                    self.inbox[slot] = Message(message.header, tuple(self._gathered.pop(lower)))

    def _send_up(self) -> None:
        """Then it waits for what is above, if it is its turn; `_go_on` looks whether that is here."""
        self._enter(Phase.PREDICT if self._rates.takes_part(self.name, self.epoch) else Phase.DONE)
        for upper, sense in self.wiring.sense:
            elements: Elements = ()
            if sense is not None and self._rates.is_sensed(self.name, upper, self.epoch):
                elements = sense.elements(self.epoch, self.time_s, self._sensed)
                if self._vigilance or self.events:
                    self._called(sense, elements)
            self._send(OBSERVATIONS, upper, elements, b"")

    def _predict(self) -> None:
        chosen = {slot: self._in_force(slot) for slot in self.wiring.above}
        self.inbox = {slot: message for slot, message in chosen.items() if message is not None}
        for slot in self.wiring.above:
            kept, oldest = self._kept.get(slot, {}), self._oldest(slot)
            for epoch in [epoch for epoch in kept if epoch < oldest]:
                del kept[epoch]
        super()._predict()
