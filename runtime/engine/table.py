"""The protocol of one node as a table.

An epoch of node i has two halves. With *children* the nodes below it and *parents* those above:

1. SENSE    waits for one observation message of this epoch from every child; then
            s ← τ(O, s), and one observation message φ(s) goes to every parent.
2. PREDICT  waits for one context message of this epoch from every parent, and one task
            message from every parent whose edge has a task function (at a root: for
            nothing); then π ← λ(T), a ← π(s), one task message ψ(a) goes to every child
            whose edge has a task function, s ← γ(C, a, s), and one context message ϱ(s)
            goes to every child. Then the node is DONE.

An observation or context message always goes, with the empty set if need be: it is the barrier's token. Where the
roster says that an edge has no task function, both its ends know that it gives the empty set, and no message says so.

The world begins an epoch when it is told to: it has no children, so it sends φ(s) at once and goes to PREDICT; when it
has predicted, the epoch is committed. Every other node goes on when an observation message says so: from DONE to the
next epoch, from anywhere to a later attempt of the epoch that it has begun. As the world is the only source of the
observations and the only sink of what comes down, an epoch ends when every node is done with it: the world is the
barrier.

A message is judged by its header before its content is looked at. The first row that fits decides:

    verdict          when                                               action
    ---------------  -------------------------------------------------  ------
    AHEAD            further ahead than can be, in roster, epoch or     REFUSE
                     attempt
    OLD_ROSTER       of an older roster                                 REFUSE
    NEW_ROSTER       of a roster that this node does not have yet       HOLD
    FOREIGN          not for this node, or along no edge of its roster  REFUSE
    OTHER_INSTANCE   not from the instance that the roster names        REFUSE
    INCOMPLETE       context, but without its sender's digest           REFUSE
    NEXT             observations of the next epoch, and this one is    TAKE
                     DONE (of any epoch, for a node that joins)
    AGAIN            observations of a later attempt of this epoch      TAKE
    LATE             of an epoch or attempt that is past                DROP
    EARLY            of an epoch, attempt or half that is still to      HOLD
                     come
    DOUBLE           already in hand                                    DROP
    CURRENT          anything else                                      TAKE

The rows are `ROWS`, which the engine executes.

HOLD keeps the message until its time comes, a bounded number for each sender and kind, and
bounded bytes; of more than that, the furthest ahead are refused. REFUSE and DROP change nothing;
REFUSE is reported. NEXT makes the state of now that of the epoch's start, AGAIN the other way round.

A message with the sender, kind, epoch, attempt, roster and instance of one that was taken in this
epoch or the one before (DOUBLE, LATE or OLD_ROSTER, as it may be) has to say the same as that one.
Where it does not, somebody else has spoken in the sender's name, and nobody knows which of the two
was the sender's: the engine raises a `ContradictionError`, which ends the run."""

from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from sys import getsizeof
from typing import NamedTuple, Protocol

import numpy as np

from hierax.runtime.core.elements import Value
from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.messages import CONTEXT, Header, Message
from hierax.schemas.values import encode_value

_FOREIGN_SHARE = 4


class _Quick(Enum):
    """Hashed by identity: members are singletons, and the usual hash is computed in Python."""

    __hash__ = object.__hash__


class Phase(_Quick):
    """What a node waits for."""

    SENSE = "observations"
    PREDICT = "tasks and context"
    DONE = "the next epoch"


class Verdict(_Quick):
    """What a message is to the node that receives it."""

    OLD_ROSTER = "of an older roster"
    AHEAD = "further ahead than can be"
    NEW_ROSTER = "of a roster that is not here yet"
    FOREIGN = "not along an edge of this node"
    OTHER_INSTANCE = "from another instance of its sender"
    INCOMPLETE = "without its sender's digest"
    NEXT = "of the next epoch"
    AGAIN = "of a later attempt of this epoch"
    LATE = "of an epoch or attempt that is past"
    EARLY = "of an epoch or attempt to come"
    DOUBLE = "already in hand"
    CURRENT = "current"


class Action(_Quick):
    """What is done with a message."""

    TAKE = "take"
    HOLD = "hold"
    DROP = "drop"
    REFUSE = "refuse"


class Standing(Protocol):
    """Where a node stands, as far as it matters for a message's verdict."""

    name: str
    epoch: int
    attempt: int
    phase: Phase
    wiring: Wiring
    awaited: Mapping[Slot, int]  # what the half of the epoch under way needs, by the sender's instance
    inbox: dict[Slot, Message]  # what of it is in hand

    def is_ahead(self, epoch: int, attempt: int, roster: int) -> bool:
        """Whether these are further ahead than can be."""

    def moves_on(self, epoch: int) -> bool:
        """Whether observations of this epoch make the node begin it."""


class Row(NamedTuple):
    """A row of the table."""

    verdict: Verdict  # of a message that fits this row, and none before it
    action: Action  # what is done with the message
    fits: Callable[[Standing, Header, Slot], bool]  # whether it does, of where the node stands, header and slot


def _is_foreign(at: Standing, header: Header, slot: Slot) -> bool:
    return header.receiver != at.name or not (slot in at.wiring.below or slot in at.wiring.above)


def _is_of_another_instance(at: Standing, header: Header, slot: Slot) -> bool:
    below = at.wiring.below
    return header.instance != (below[slot] if slot in below else at.wiring.above[slot])


def _is_again(at: Standing, header: Header, slot: Slot) -> bool:
    return slot in at.wiring.below and header.epoch == at.epoch > 0 and header.attempt > at.attempt


def _is_early(at: Standing, header: Header, slot: Slot) -> bool:
    if (header.epoch, header.attempt) != (at.epoch, at.attempt):
        return True  # what is past is LATE
    return at.phase is Phase.SENSE and slot not in at.awaited  # what comes for PREDICT is ahead of SENSE


ROWS = (  # in the words of the table above
    Row(Verdict.AHEAD, Action.REFUSE, lambda at, header, _: at.is_ahead(header.epoch, header.attempt, header.roster)),
    Row(Verdict.OLD_ROSTER, Action.REFUSE, lambda at, header, _: header.roster < at.wiring.roster),
    Row(Verdict.NEW_ROSTER, Action.HOLD, lambda at, header, _: header.roster > at.wiring.roster),
    Row(Verdict.FOREIGN, Action.REFUSE, _is_foreign),
    Row(Verdict.OTHER_INSTANCE, Action.REFUSE, _is_of_another_instance),
    Row(Verdict.INCOMPLETE, Action.REFUSE, lambda _, header, slot: header.kind == CONTEXT and not header.digest),
    Row(Verdict.NEXT, Action.TAKE, lambda at, header, slot: slot in at.wiring.below and at.moves_on(header.epoch)),
    Row(Verdict.AGAIN, Action.TAKE, _is_again),
    Row(Verdict.LATE, Action.DROP, lambda at, header, _: (header.epoch, header.attempt) < (at.epoch, at.attempt)),
    Row(Verdict.EARLY, Action.HOLD, _is_early),
    # what came for SENSE is behind PREDICT
    Row(Verdict.DOUBLE, Action.DROP, lambda at, _, slot: slot in at.inbox or slot not in at.awaited),
    Row(Verdict.CURRENT, Action.TAKE, lambda *_: True),
)
ACTIONS = {row.verdict: row.action for row in ROWS}

HELD_MESSAGES = 8  # how many messages of one sender and kind are held at most

HELD_SLOTS = 256
"""Of how many senders and kinds that are no neighbours': of a roster that is not here yet, anybody may be one."""

HELD_BYTES = 64 << 20  # how much memory they may take, about; those of no neighbours' a quarter of it

ROSTERS_AHEAD = 1000
EPOCHS_AHEAD = 1000
ATTEMPTS_AHEAD = 1000
"""How far ahead of a node a message may be. Versions are used up by changes that are dropped, and attempts by
processes that die; a node that lives takes part in each epoch, or has rates, which say how far ahead others are."""

MAX_PREPARED = 64  # how many versions of the roster are at hand that are not taken up; and how many are asked for


class Held:
    """What is held of each sender and kind."""

    def __init__(self) -> None:
        self._slots: dict[Slot, list[tuple[Message, int]]] = {}
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._slots)

    def put(self, message: Message, is_neighbour: bool) -> list[Message]:
        """Hold a message, if it is not held; gives those for which there is no room. Strangers have less of it."""
        slot = (message.header.sender, message.header.kind)
        held = self._slots.get(slot, [])
        if any(_are_same(other, message) for other, _ in held):
            return []
        if not held and not is_neighbour and len(self._slots) >= HELD_SLOTS:
            return [message]
        size = _weight(message.payload) + _weight(message.header.extensions)
        most = HELD_BYTES if is_neighbour else HELD_BYTES // _FOREIGN_SHARE
        nearest = sorted([*held, (message, size)], key=_how_far)
        before = sum(weight for _, weight in held)
        kept: list[tuple[Message, int]] = []
        left = most - (self._bytes - before)
        for each in nearest[:HELD_MESSAGES]:
            if each[1] > left:
                break
            kept.append(each)
            left -= each[1]
        self._bytes += sum(weight for _, weight in kept) - before
        if kept:
            self._slots[slot] = kept
        else:
            self._slots.pop(slot, None)
        return [each for each, _ in nearest[len(kept) :]]

    def take(self) -> Iterator[Message]:
        """All that is held, by sender and kind, the nearest first; then nothing is."""
        slots, self._slots, self._bytes = self._slots, {}, 0
        for slot in sorted(slots):
            for message, _ in slots[slot]:
                yield message


def _how_far(held: tuple[Message, int]) -> tuple[int, int, int]:
    header = held[0].header
    return header.roster, header.epoch, header.attempt


def _are_same(one: Message, other: Message) -> bool:
    return one.header == other.header and encode_value(one.payload) == encode_value(other.payload)


def _weight(value: Value) -> int:
    """About how many bytes of memory a value takes."""
    if isinstance(value, np.ndarray):
        return 128 + value.nbytes
    if isinstance(value, dict):
        return 64 + sum(getsizeof(key) + _weight(part) for key, part in value.items())
    if isinstance(value, tuple):
        return 64 + sum(map(_weight, value))
    return getsizeof(value)
