"""An epoch that was done again, and what went along the lines of a replay."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from hierax.runtime.core.digest import elements_cannot_travel, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.trace import Attempt, EpochTrace, Line, order_of
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT
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
    With the barrier, only the epoch's own messages are used."""

    def __init__(self, barrier: bool) -> None:
        self._barrier = barrier
        self._lines: dict[Line, dict[Attempt, Given | bytes]] = {}

    def recall(self, recorded: EpochTrace) -> None:
        """Have the messages of a recorded epoch."""
        if self._barrier:
            self._lines.clear()
        for line, attempts in recorded.lines.items():
            for attempt, data in attempts.items():
                self._put(line, (recorded.epoch, attempt), data)

    def give(self, replayed: ReplayedEpoch, line: Line, elements: Elements, digest: bytes = b"") -> None:
        """Have what a live node gives, in place of what it gave when it committed; `OperatorError` if it cannot go."""
        try:
            travelled = decode_value(encode_value(elements))
        except SchemaError as error:
            raise elements_cannot_travel(*line, replayed.epoch, error) from error
        replayed.lines[line] = travelled
        recorded = replayed.recorded
        attempt = recorded.nodes[line[1]].step.attempt if line[1] in recorded.nodes else recorded.attempt
        self._put(line, (replayed.epoch, attempt), Given(travelled, digest))

    def elements(self, recorded: EpochTrace, kind: str, senders: Iterable[str], receiver: str) -> Elements:
        """All that a node used in an epoch, of a kind. Raises `RecordingError` if something of it is not recorded."""
        found: Elements = ()
        for sender in senders:
            given = self.given(recorded, (kind, sender, receiver))
            if given is None:
                epoch, attempt = _when_used(recorded, (kind, sender, receiver))
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
        """What the receiver of a line used in an epoch; None: it is not recorded."""
        given = self._lines.get(line, {}).get(_when_used(recorded, line))
        if not isinstance(given, bytes):
            return given
        message = recorded.message(given)
        return Given(message.payload, message.header.digest)

    def _put(self, line: Line, when: Attempt, given: Given | bytes) -> None:
        kept = self._lines.setdefault(line, {})
        kept[when] = given
        if len(kept) > KEPT_MESSAGES:
            del kept[next(iter(kept))]


def _when_used(recorded: EpochTrace, line: Line) -> Attempt:
    """The epoch and attempt of the message that a line's receiver used."""
    kind, sender, receiver = line
    return (recorded.used_of(receiver) or {}).get((sender, kind), (recorded.epoch, recorded.attempt))
