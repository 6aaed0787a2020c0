"""The ledger of a recording: what was said, by the words of those who said and heard it, against what was recorded.

Every step names the messages that went in and out at its node's port, and counts the steps. So what lacks is known
whoever has lost it, and how."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hierax.runtime.recording.info import Gap
from hierax.runtime.recording.trace import Attempt, Line
from hierax.schemas.rates import Pair, Rates
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep

PATIENCE_S = 30.0  # how long steps may come after the messages that they tell of
KEPT_GAPS = 1000
KEPT_ATTEMPTS = 100_000  # of how many attempts is kept what was heard, while a node has not told of them


@dataclass(eq=False, repr=False)
class Ledger:
    """Keeps account of one recording."""

    from_start: bool  # whether it begins with the run; else with the first epoch that all nodes have told of
    epochs: int | None = None  # how many are wanted; None: all
    clock: Callable[[], float] = time.monotonic  # seconds

    def __post_init__(self) -> None:
        self._bits: dict[Line, int] = {}
        self._heard: dict[Attempt, int] = {}
        self._missing: dict[Attempt, int] = {}
        self._sent: dict[Attempt, int] = {}
        self._deaths: set[str] = set()
        self._names: frozenset[str] = frozenset()
        self._world = ""  # its name, by the last roster; empty: none is known
        self._chained: dict[str, int] = {}  # by node, the last epoch that it says is committed
        # messages that reached their receivers and not the recorder, as their senders' processes died meanwhile
        self.cut_short: list[Gap] = []
        self._ages: deque[tuple[float, Attempt]] = deque()
        self._streams: dict[str, tuple[str, int]] = {}
        self._skipped: dict[str, tuple[str, int, Gap]] = {}  # by node, the last one that lacked alone
        self._first: dict[str, int] = {}
        self._expected: frozenset[str] = frozenset()
        self._gaps: list[Gap] = []
        self._lost = 0
        self._told: dict[str, int] = {}
        self._rates: Rates | None = None
        self._pairs: Sequence[Pair] = ()
        self._whole = 0
        self._drained = 0
        self._forgotten: Attempt = (0, 0)
        self.last = 0  # the last epoch whose commit was recorded
        self.cut: int | None = None  # the last epoch that is wanted; None: all are

    @property
    def first(self) -> int:
        """The first epoch that is recorded as a whole; 0: not known yet."""
        if self.from_start:
            return 1
        told = [self._first.get(name, 0) for name in self._expected]
        if not self._whole and told and min(told) > 0:
            self._whole = max(told) + 1 if self._rates is None else self._first_by(self._rates)
        return self._whole

    def _first_by(self, rates: Rates) -> int:
        """With rates: all that counts from this epoch on was said after its sender's first step."""
        first = self._first
        wanted = [first[name] + 1 for name in self._expected]
        for lower, upper in self._pairs:
            if lower in first and upper in first:
                wanted.append(rates.next_turn(upper, first[upper]) + rates.delays.get((lower, upper), 0))
                if (lower, upper) in rates.gathers:
                    wanted.append(rates.next_turn(upper, first[lower] - 1) + 1)
        return max(wanted)

    @property
    def rated(self) -> bool:
        """Whether nodes have rates, by the last roster."""
        return self._rates is not None

    @property
    def settled(self) -> bool:
        """Whether nothing is known to have been said that was not heard."""
        return not self._missing

    @property
    def complete(self) -> bool:
        """Whether every node that is there has told of the last epoch that is wanted, and nothing lacks."""
        names = self._names or self._told.keys()
        if self.cut is None or not self.settled:
            return False
        return all(self._told.get(name, 0) >= self._due(name, self.cut) for name in names)

    def _due(self, name: str, epoch: int) -> int:
        """The last epoch up to this one of which a node tells."""
        return epoch if self._rates is None else self._rates.last_turn(name, epoch)

    @property
    def ended(self) -> bool:
        """Whether the last epoch that is wanted is committed."""
        return self.cut is not None and self.last >= self.cut

    def end(self, epoch: int) -> None:
        """No epoch after this one is wanted; what had been told of later ones is not looked for any more."""
        self.cut = epoch
        self._missing = {when: bits for when, bits in self._missing.items() if when[0] <= epoch}

    def wants(self, epoch: int) -> bool:
        """Whether something of an epoch is wanted."""
        return self.cut is None or epoch <= self.cut

    def expect(self, roster: Roster) -> None:
        """A roster that was not known yet."""
        self._deaths |= self._names - roster.nodes.keys()
        self._names, self._world = frozenset(roster.nodes), roster.world
        self._count_commits()
        self._rates, self._pairs = roster.rates, roster.pairs
        if not self._expected:
            self._expected = self._names

    def message(self, line: Line, epoch: int, attempt: int, drains: bool = False) -> None:
        """A message was recorded; it `drains` where it says that at its epoch's end every node is done."""
        bit = self._bit(line)
        when = (epoch, attempt)
        if drains:
            self._drained = max(self._drained, epoch)
        if self._rates is not None and when <= self._forgotten:
            return  # it is said again
        if when not in self._heard:
            self._ages.append((self.clock(), when))
            self._forget()
        self._heard[when] = self._heard.get(when, 0) | bit
        if when in self._missing:
            self._settle(when, self._missing[when] & ~bit)

    def step(self, step: NodeStep) -> None:
        """A step was recorded."""
        self._told[step.name] = max(step.epoch, self._told.get(step.name, 0))
        if not self.wants(step.epoch):
            return
        self.number(step.name, step.stream, step.number, step.epoch)
        if step.chain:
            self._chained[step.name] = max(step.epoch, self._chained.get(step.name, 0))
            self._count_commits()
        needed: dict[Attempt, int] = {}
        oldest = self._oldest
        for sent, kind, peer, epoch, attempt in step.passages:
            if not self.wants(epoch):
                continue
            line = (kind, step.name, peer) if sent else (kind, peer, step.name)
            when = (epoch, attempt)
            needed[when] = needed.get(when, 0) | self._bit(line)
            if sent and when >= oldest:
                self._sent[when] = self._sent.get(when, 0) | self._bit(line)
        for when, bits in needed.items():
            missing = bits & ~self._heard.get(when, 0)
            if missing and when >= oldest:
                self._settle(when, self._missing.get(when, 0) | missing)

    def number(self, name: str, stream: str, number: int, epoch: int) -> None:
        """A node has told its step of this number, whether or not it was recorded."""
        last_stream, last = self._streams.get(name, ("", 0))
        if name not in self._streams and not self.from_start:
            last = number - 1  # somebody else may have recorded before
        elif stream != last_stream:
            last = 0
            if last_stream:
                self._deaths.add(name)  # another process is there: what the old one had not told, it never will
        if number > last + 1:
            gap = Gap(epoch, f"steps of {name} before this one", number - last - 1)
            self.add(gap)
            if gap.count == 1:
                self._skipped[name] = (stream, number - 1, gap)
        elif self._skipped.get(name, ("", 0))[:2] == (stream, number):
            self._found(self._skipped.pop(name)[2])
        self._streams[name] = (stream, max(number, last))
        self._first.setdefault(name, epoch)
        if self.epochs is not None and self.cut is None and self.first:
            self.end(self.first + self.epochs - 1)

    def _found(self, gap: Gap) -> None:
        """It came later than the next one: where a process goes on in another session, the two have a link each."""
        self._lost -= gap.count
        if gap in self._gaps:
            self._gaps.remove(gap)

    def add(self, gap: Gap) -> None:
        """Something is known to lack."""
        self._lost += gap.count
        if len(self._gaps) < KEPT_GAPS:
            self._gaps.append(gap)

    def close(self, last: int | None = None) -> tuple[tuple[Gap, ...], int]:
        """What lacks, the first ones, and how much in all; all nodes are known to have done the last epoch, if any."""
        first = self.first
        if self._rates is not None:  # only of an epoch that was drained is it known who has done it
            last = self._drained if self._drained <= self.last else None
        for name in sorted(self._names if last is not None else ()):
            told, due = self._told.get(name, 0), self._due(name, last or 0)
            if 0 < told < due:
                count = due - told if self._rates is None else (due - told) // self._rates.turns_of(name).every
                self.add(Gap(told + 1, f"steps of {name} from here on", max(count, 1)))
        for when in sorted(self._missing):
            self._report(when, first)
        self._missing.clear()
        silent = sorted(self._expected - self._first.keys())
        if silent and (self.from_start or self._first):
            self.add(Gap(self.last, f"all steps of {', '.join(silent)}", len(silent)))
        return tuple(self._gaps), self._lost

    def _count_commits(self) -> None:
        """Epochs are committed by the world alone; who that is, a roster says, which may come after its first steps."""
        self.last = max(self.last, self._chained.get(self._world, 0))

    def _bit(self, line: Line) -> int:
        """The bit that stands for a line in the numbers of what was heard, sent and is missing."""
        bit = self._bits.get(line)
        return self._bits.setdefault(line, 1 << len(self._bits)) if bit is None else bit

    def _settle(self, when: Attempt, missing: int) -> None:
        if missing:
            self._missing[when] = missing
        else:
            self._missing.pop(when, None)

    def _forget(self) -> None:
        oldest_s = self.clock() - PATIENCE_S
        while len(self._ages) > 1 and self._ages[0][0] < oldest_s and not self._is_awaited(self._ages[0][1]):
            _, when = self._ages.popleft()
            self._forgotten = max(when, self._forgotten)
            self._heard.pop(when, None)
            if when in self._missing:
                self._report(when, self.first)
                del self._missing[when]
            self._sent.pop(when, None)

    @property
    def _oldest(self) -> Attempt:
        """The first attempt of which is known what was heard."""
        if self._rates is not None:  # nodes are in different epochs, and so are the first messages
            return (self._forgotten[0] + 1, 0) if self._forgotten[0] else (0, 0)
        return self._ages[0][1] if self._ages else (0, 0)

    def _is_awaited(self, when: Attempt) -> bool:
        """With rates: whether a node that has told seldom may still tell of an epoch's messages."""
        if self._rates is None or len(self._ages) > KEPT_ATTEMPTS:
            return False
        slowest = min((self._told.get(name, 0) for name in self._names), default=0)
        return when[0] >= slowest - max(self._rates.delays.values(), default=0)

    def _lies_before(self, when: Attempt, sender: str, first: int) -> bool:
        """Whether it was said when the recording had not begun: with rates, before the sender's first step was told."""
        if self._rates is None or self.from_start:
            return not first or when[0] < first
        return not first or when[0] <= self._first.get(sender, when[0])

    def _report(self, when: Attempt, first: int) -> None:
        missing, sent = self._missing[when], self._sent.get(when, 0)
        for (kind, sender, receiver), bit in self._bits.items():
            if not missing & bit or self._lies_before(when, sender, first):
                continue
            gap = Gap(when[0], f"{kind} message {sender} -> {receiver} of attempt {when[1]}")
            if sender in self._deaths and not sent & bit:
                self.cut_short.append(gap)
            else:
                self.add(gap)
