"""What an engine of a hierarchy with rates says, and says again.

Nothing that was said is ever taken back, so an epoch has one attempt. What a node says stands in its checkpoint
before it is heard, or follows from that: what it has sensed, the state after its last turn, and what it has said to
its neighbours and they may lack. A process that comes in the place of a lost one goes on from there, and nobody else is
undone. Who takes up a version of the roster greets its neighbours, with a message of epoch 0, and is told by each what
it may lack; what comes twice is dropped.

What a neighbour lacks is known by what it says. Context of a turn comes when that turn is in its sender's checkpoint,
so observations up to there are not asked for again; observations of an epoch come when its sender has done the one
before, so of what is in force by then, nothing older is."""

from collections.abc import Callable, Sequence

from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import ContradictionError
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.own_rates import OwnRates
from hierax.runtime.engine.said import SaidMessages
from hierax.runtime.engine.table import Phase
from hierax.schemas.messages import CONTEXT, GREETING, OBSERVATIONS, TASKS, Header, Message
from hierax.schemas.rates import Rates


class SayingEngine(Engine):
    """Keeps what it says for as long as a neighbour may lack it."""

    _rates: Rates  # of the hierarchy
    _own: OwnRates  # the same as the node has them
    _turned: int  # the last epoch whose state was saved; those after it that are past change nothing
    _unheard: SaidMessages
    _remembered: tuple[int, Value] | None = None  # an epoch in which it has sensed and not predicted, and its belief
    _greets: bool  # whether neighbours may have more than this process knows of
    _unsent: list[Message] | None = None

    def _greet_first(self) -> None:
        if not self._greets:
            return
        self._greets = False
        for neighbour in (*self.node.above, *self.node.below):
            self._greet(neighbour)

    def _greet(self, neighbour: str) -> None:
        kind = OBSERVATIONS if neighbour in self.node.above else CONTEXT
        place = (self._roster, self.wiring.instance)
        header = Header(kind, self.name, neighbour, GREETING, 0, *place, self.time_s, NO_DIGEST)
        done = self.epoch - (self.phase is not Phase.DONE) if self.is_world else self._turned
        since = self._rates.since(self.name, neighbour)  # who comes begins with that epoch
        self._effects.send(Message(header, (done, since)))

    def say_again(self, neighbour: str) -> None:
        if self.begun:
            self._greet(neighbour)
            self._say_what_it_lacks(neighbour)

    def _say_what_it_lacks(self, neighbour: str) -> None:
        for message in self._unheard.to(neighbour):
            header = message.header._replace(roster=self._roster, instance=self.wiring.instance)
            self._effects.send(Message(header, message.payload))

    def resend(self, receivers: Sequence[str]) -> None:
        for receiver in receivers:
            self.say_again(receiver)

    def _check_sound(self, neighbour: str, instance: int, done: int) -> None:
        """Raises `ContradictionError` if a neighbour goes on before what it was done with: nobody has that any more."""
        if neighbour in self.node.above:
            is_sound = self._unheard.has_from(neighbour, OBSERVATIONS, done + 1, instance)
        else:
            wanted = self._rates.in_force(neighbour, self.name, self._rates.next_turn(neighbour, done))
            is_sound = self._unheard.has_from(neighbour, CONTEXT, wanted, instance)
        if not is_sound:
            what = f"{neighbour} goes on after epoch {done}, and was further when it said so last"
            raise ContradictionError(f"{self.name}: {what}: its checkpoint was damaged, or somebody speaks in its name")

    def _forget(self, header: Header) -> None:
        """What its sender will not ask for any more."""
        peer = header.sender
        if header.kind == OBSERVATIONS:
            oldest = self._own.below[peer].in_force(header.epoch)
            for kind in (TASKS, CONTEXT) if self.wiring.task else (CONTEXT,):
                self._unheard.forget(peer, kind, oldest, header.instance)
        elif header.kind == CONTEXT and self._own.takes_part(peer, header.epoch):
            self._unheard.forget(peer, OBSERVATIONS, header.epoch + 1, header.instance)

    def _tell_below(self) -> None:
        self._say_what_is_saved(self._send_context)

    def _hand_on_nothing(self) -> None:
        for lower in self.node.below:
            self._send(CONTEXT, lower, (), NO_DIGEST)

    def _say_what_is_saved(self, say: Callable[[], None]) -> None:
        """Write down what is about to be said, and where the node is, also at the end of a drained epoch: another
        roster may follow, and then nobody is told any more what had been under the one before."""
        self._turned, self._remembered = self.epoch, None
        self._unsent = []
        say()
        unsent, self._unsent = self._unsent, None
        self._effects.save(self.epoch, 0, self.encoded_start, self.encoded)  # with what is about to be sent
        for message in unsent:
            self._effects.send(message)

    def _deliver(self, message: Message) -> None:
        kept = self._unheard.keep(message)
        if self._unsent is None:
            self._effects.send(kept)
        else:
            self._unsent.append(kept)
