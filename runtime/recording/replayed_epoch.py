"""An epoch that was done again, and what went along the lines of a replay."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hierax.runtime.core.digest import NO_DIGEST, elements_cannot_travel, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.trace import Attempt, EpochTrace, Line, order_of
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.rates import Pair, Rates
from hierax.schemas.roster import Roster
from hierax.schemas.values import decode_value, encode_value

KEPT_MESSAGES = 64  # where epochs overlap: how many messages of a line are kept, as a later epoch may use them


@dataclass
class ReplayedEpoch:
    """An epoch done again; what is not live is as it was recorded."""

    recorded: EpochTrace  # the epoch as it was
    roster: Roster  # under which it was done again
    time_s: float | None = None  # its time
    digest: bytes = b""  # of the run
    starts: dict[str, ActiveNode] = field(default_factory=dict)  # of the nodes that are live, as what follows
    sensed: dict[str, Value] = field(default_factory=dict)
    states: dict[str, ActiveNode] = field(default_factory=dict)
    lines: dict[Line, Elements] = field(default_factory=dict)  # what the live nodes gave, by kind, sender and receiver

    @property
    def epoch(self) -> int:
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


class Given(NamedTuple):
    """What a node gave along a line, and its digest where it went down."""

    elements: Elements
    digest: bytes


class Exchange:
    """What went along each line, as far back as it may be used: as it was recorded, or as a live node gives it now.
    With the barrier, only the epoch's own messages are used; with rates, those that the rates of the roster say."""

    def __init__(self, barrier: bool) -> None:
        self._barrier = barrier
        self._lines: dict[Line, dict[Attempt, Given | bytes]] = {}
        self._rates: Rates | None = None
        self._gathering = Gathering()

    def recall(self, recorded: EpochTrace, roster: Roster | None = None) -> None:
        """Have the messages of a recorded epoch, which is done under this roster; by default the recorded one."""
        roster = recorded.roster if roster is None else roster
        self._rates = rates = roster.rates
        if rates is not None:
            self._gathering.turn(recorded.epoch, roster)
            self._forget(recorded.epoch, rates)
        elif self._barrier:
            self._lines.clear()
        for line, attempts in recorded.lines.items():
            for attempt, data in attempts.items():
                if rates is None:
                    self._put(line, (recorded.epoch, attempt), data)
                elif attempt == recorded.attempt and was_said(line, recorded, rates):
                    self._lines.setdefault(line, {})[recorded.epoch, 0] = data

    def give(self, replayed: ReplayedEpoch, line: Line, elements: Elements, digest: bytes = b"") -> None:
        """Have what a live node gives, in place of what it gave when it committed; `OperatorError` if it cannot go."""
        try:
            travelled = decode_value(encode_value(elements))
        except SchemaError as error:
            raise elements_cannot_travel(*line, replayed.epoch, error) from error
        replayed.lines[line] = travelled
        recorded = replayed.recorded
        given = Given(travelled, digest)
        if self._rates is not None:
            self._lines.setdefault(line, {})[replayed.epoch, 0] = given
            return
        attempt = recorded.nodes[line[1]].step.attempt if line[1] in recorded.nodes else recorded.attempt
        self._put(line, (replayed.epoch, attempt), given)

    def elements(self, recorded: EpochTrace, kind: str, senders: Iterable[str], receiver: str) -> Elements:
        """All that a node used in an epoch, of a kind. Raises `RecordingError` if something of it is not recorded."""
        found: Elements = ()
        for sender in senders:
            line = (kind, sender, receiver)
            given = self.given(recorded, line)
            if given is None:
                used = self._used(recorded, line)
                epoch, attempt = next(when for when in used if self._at(recorded, line, when) is None)
                what = f"the {kind} message {sender} -> {receiver} of epoch {epoch}, attempt {attempt}, is not recorded"
                raise RecordingError(f"{recorded.place}: epoch {recorded.epoch} cannot be done again: {what}")
            found += given.elements
        return found

    def digest(self, recorded: EpochTrace, name: str, state: bytes) -> bytes:
        """A node's digest, of its encoded state and what came from above; empty where that is not known."""
        used = [self.given(recorded, (CONTEXT, upper, name)) for upper in recorded.roster.above(name)]
        above = [b"" if given is None else given.digest for given in used]
        return node_digest(state, above) if all(above) else b""

    def given(self, recorded: EpochTrace, line: Line) -> Given | None:
        """What the receiver of a line used in an epoch; None: it is not recorded, or not all of it."""
        used = self._used(recorded, line)
        found = [(when[0], self._at(recorded, line, when)) for when in used]
        if not self._gathers(line):
            return found[0][1]
        elements: Elements = ()
        for epoch, given in found:
            if given is None:
                return None
            elements += tuple((epoch, element) for element in given.elements)
        return Given(elements, b"")

    def knows_inputs(self, roster: Roster, name: str, epoch: int) -> bool:
        """With rates: whether a node can go on with an epoch, as all that counts of those before is here."""
        rates = roster.rates
        assert rates is not None
        for upper in roster.above(name):
            in_force = rates.in_force(name, upper, rates.next_turn(name, epoch - 1))
            kinds = (CONTEXT, TASKS) if (name, upper) in roster.tasking else (CONTEXT,)
            lines = [(kind, upper, name) for kind in kinds]
            if 0 < in_force < epoch and any((in_force, 0) not in self._lines.get(line, {}) for line in lines):
                return False
        return all(
            self._gathering.is_whole((lower, name)) for lower in roster.below(name) if (lower, name) in rates.gathers
        )

    def _used(self, recorded: EpochTrace, line: Line) -> list[Attempt]:
        """The epochs and attempts of the messages that a line's receiver used; epoch 0: nothing counts yet."""
        kind, sender, receiver = line
        if self._rates is None:
            return [(recorded.used_of(receiver) or {}).get((sender, kind), (recorded.epoch, recorded.attempt))]
        if kind != OBSERVATIONS:
            return [(self._rates.in_force(receiver, sender, recorded.epoch), 0)]
        if self._gathers(line):
            return [(epoch, 0) for epoch in self._gathering.epochs((sender, receiver))]
        return [(recorded.epoch, 0)]

    def _gathers(self, line: Line) -> bool:
        return self._rates is not None and line[0] == OBSERVATIONS and line[1:] in self._rates.gathers

    def _at(self, recorded: EpochTrace, line: Line, when: Attempt) -> Given | None:
        if when[0] == 0:
            return Given((), NO_DIGEST)
        given = self._lines.get(line, {}).get(when)
        if not isinstance(given, bytes):
            return given
        message = recorded.message(given)
        return Given(message.payload, message.header.digest)

    def _forget(self, epoch: int, rates: Rates) -> None:
        """What does not count any more."""
        for (kind, sender, receiver), kept in self._lines.items():
            if kind != OBSERVATIONS:
                oldest = rates.in_force(receiver, sender, epoch)
            else:
                oldest = min(self._gathering.epochs((sender, receiver)), default=epoch)
            for when in [when for when in kept if when[0] < oldest]:
                del kept[when]

    def _put(self, line: Line, when: Attempt, given: Given | bytes) -> None:
        kept = self._lines.setdefault(line, {})
        kept[when] = given
        if len(kept) > KEPT_MESSAGES:
            del kept[next(iter(kept))]


def was_said(line: Line, recorded: EpochTrace, rates: Rates) -> bool:
    """Whether what was recorded of a line is what its receiver hears by these rates: nobody is asked in other epochs
    than its own, so the message is empty, and where somebody wants to know now, it is not known."""
    kind, sender, receiver = line
    then = recorded.roster.rates
    if kind != OBSERVATIONS or then is None or not rates.is_sensed(sender, receiver, recorded.epoch):
        return True
    return then.is_sensed(sender, receiver, recorded.epoch)


class Gathering:
    """The epochs whose observations those above that gather them have in their next turns, or in that of this epoch."""

    def __init__(self) -> None:
        self._epoch = 0
        self._roster: Roster | None = None
        self._epochs: dict[Pair, list[int]] = {}
        self._whole: set[Pair] = set()

    def turn(self, epoch: int, roster: Roster) -> None:
        """An epoch begins, under a roster with rates."""
        before, self._roster = self._roster, roster
        rates = roster.rates
        assert rates is not None
        if epoch != self._epoch + 1:
            self._epochs, self._whole, before = {}, set(), None
        elif before is not None:
            self._clear_turned(before.rates or Rates())
        self._epoch = epoch
        gathering = before.rates.gathers if before is not None and before.rates is not None else frozenset()
        staying = {pair for pair in rates.gathers & gathering if rates.since(*pair) < epoch}
        begun = epoch == 1 or before is not None
        self._whole = {pair for pair in rates.gathers if (pair in self._whole if pair in staying else begun)}
        self._epochs = {pair: self._epochs.get(pair, []) if pair in staying else [] for pair in rates.gathers}
        for pair, epochs in self._epochs.items():
            if rates.is_sensed(*pair, epoch):
                epochs.append(epoch)

    def _clear_turned(self, rates: Rates) -> None:
        for pair in self._epochs:
            if rates.takes_part(pair[1], self._epoch):
                self._epochs[pair] = []
                self._whole.add(pair)

    def epochs(self, pair: Pair) -> Sequence[int]:
        """Of an edge, oldest first."""
        return self._epochs.get(pair, ())

    def is_whole(self, pair: Pair) -> bool:
        """Whether all that is in them was seen here."""
        return pair in self._whole
