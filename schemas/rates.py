"""How often nodes take part in epochs, and from when on what is predicted counts below."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.limits import MAX_EPOCHS_APART
from hierax.schemas.values import Value, fits

Pair = tuple[str, str]  # the names of an edge's nodes, lower first


@dataclass(frozen=True)
class Turns:
    """The epochs n ≡ offset (mod every), in which a node takes part."""

    every: int = 1
    offset: int = 0  # from 0, less than `every`

    def include(self, epoch: int) -> bool:
        return (epoch - self.offset) % self.every == 0

    def last(self, epoch: int) -> int:
        """The last one up to an epoch; 0: there was none."""
        return max(epoch - (epoch - self.offset) % self.every, 0)

    def next(self, epoch: int) -> int:
        """The first one after an epoch."""
        return epoch + self.every - (epoch - self.offset) % self.every

    def plain(self) -> Value:
        return (self.every, self.offset)

    @staticmethod
    def read(value: Value, where: str) -> "Turns":
        """Read them from a value. Raises `SchemaError` if it is none."""
        if not fits(value, tuple[int, int]) or not 0 <= value[1] < value[0] <= MAX_EPOCHS_APART:
            what = f"expected every and offset, 0 ≤ offset < every ≤ {MAX_EPOCHS_APART}, got {shown(value)}"
            raise SchemaError(what, where)
        return Turns(*value)


EVERY_EPOCH = Turns()


def includes(passed: Sequence[Turns], epoch: int) -> bool:
    """Whether an epoch is among these turns."""
    for turns in passed:  # noqa: SIM110 - a loop takes half the time of any()
        if turns.include(epoch):
            return True
    return False


class Began(NamedTuple):
    """Since when an edge has its rates, where that is not the beginning of the run."""

    epoch: int  # what its upper node says from here on counts by them
    counts: int  # until the first of that does: the epoch of what counted before; 0: nothing did
    is_new: bool  # whether there was no such edge before


class EdgeRates(NamedTuple):
    """Which of the epochs of an edge's upper node count in which of its lower one."""

    every: int  # of the upper node
    offset: int  # likewise
    delay: int
    epoch: int = 0  # as `Began` has it; 0: the beginning of the run
    counts: int = 0  # likewise

    def in_force(self, epoch: int) -> int:
        """The epoch whose context and tasks count in this one; 0: there are none yet."""
        every, offset, delay, began, counts = self
        at = epoch - delay
        turn = at - (at - offset) % every
        return turn if turn >= began else counts

    def last(self, epoch: int) -> int:
        """The same of the first epoch that is not done by these rates any more."""
        return self._replace(delay=max(self.delay, 1)).in_force(epoch)


@dataclass(frozen=True)
class Timing:
    """Since when nodes and edges have the rates that they have, where that is not the beginning of the run.

    Which epoch is the first one of a roster nobody knows until it takes effect."""

    since: Mapping[str, int] = field(default_factory=dict)  # the first epoch, by node
    began: Mapping[Pair, Began] = field(default_factory=dict)  # by edge
    fresh: frozenset[str] = frozenset()  # the nodes that come, or have other turns, with the roster's first epoch
    changed: Mapping[Pair, EdgeRates | None] = field(default_factory=dict)  # likewise edges; None: it is new

    def as_of(self, epoch: int) -> "Timing":
        """The same once the roster's first epoch is known."""
        began = {
            pair: Began(epoch, 0, True) if former is None else Began(epoch, former.last(epoch), False)
            for pair, former in self.changed.items()
        }
        return Timing({**self.since, **dict.fromkeys(self.fresh, epoch)}, {**self.began, **began})

    def plain(self) -> Value:
        return {
            "since": dict(self.since),
            "began": [(*pair, *began) for pair, began in sorted(self.began.items())],
            "fresh": sorted(self.fresh),
            "changed": [(*pair, None if each is None else tuple(each)) for pair, each in sorted(self.changed.items())],
        }

    @staticmethod
    def read(value: Value, where: str) -> "Timing":
        """Read it from a value. Raises `SchemaError` if it is none."""
        if not isinstance(value, dict) or value.keys() != _TIMING.keys():
            raise SchemaError(f"expected a map with the keys {', '.join(_TIMING)}", where)
        for name, kind in _TIMING.items():
            part = tuple(value[name]) if isinstance(value[name], list) else value[name]
            if not fits(part, kind):
                raise SchemaError(f"got {shown(value[name])}", f"{where}.{name}")
        began = {(lower, upper): Began(*rest) for lower, upper, *rest in value["began"]}
        return Timing(value["since"], began, frozenset(value["fresh"]), dict(_read_changed(value["changed"], where)))


_TIMING = {
    "since": dict[str, int],
    "began": tuple[tuple[str, str, int, int, bool], ...],
    "fresh": tuple[str, ...],
    "changed": tuple[tuple[str, str, Value], ...],
}
"""The fields of a timing as a value."""


def _read_changed(value: Value, where: str) -> list[tuple[Pair, EdgeRates | None]]:
    for _, _, former in value:
        if former is not None and not (fits(former, tuple[int, int, int, int, int]) and former[0] > former[1] >= 0):
            raise SchemaError(f"expected five whole numbers, or none, got {shown(former)}", f"{where}.changed")
    return [((lower, upper), None if each is None else EdgeRates(*each)) for lower, upper, each in value]


FROM_THE_BEGINNING = Timing()


@dataclass(frozen=True)
class Rates:
    """The rates of a hierarchy."""

    turns: Mapping[str, Turns] = field(default_factory=dict)  # of nodes that do not take part in every epoch
    delays: Mapping[Pair, int] = field(default_factory=dict)  # of edges, where not 0
    gathers: frozenset[Pair] = frozenset()  # edges on which the upper node has all observations since its last turn
    timing: Timing = FROM_THE_BEGINNING  # since when
    pairs: tuple[Pair, ...] = field(default=(), compare=False)  # all edges; none: they are not known

    def turns_of(self, name: str) -> Turns:
        return self.turns.get(name, EVERY_EPOCH)

    def takes_part(self, name: str, epoch: int) -> bool:
        return self.turns_of(name).include(epoch) and epoch >= self.timing.since.get(name, 1)

    def last_turn(self, name: str, epoch: int) -> int:
        """The last epoch up to this one in which a node takes part by these rates; 0: there was none."""
        turn = self.turns_of(name).last(epoch)
        return turn if turn >= self.timing.since.get(name, 1) else 0

    def next_turn(self, name: str, epoch: int) -> int:
        """The first epoch after this one in which a node takes part."""
        return self.turns_of(name).next(max(epoch, self.timing.since.get(name, 1) - 1))

    def passes(self, name: str) -> tuple[Turns, ...]:
        """In which epochs a node is sent observations, as it takes part in them, or one above it does, or one that it
        gathers from. Where edges are not known, in all."""
        return self._passed.get(name, (EVERY_EPOCH,))

    def is_told(self, name: str, epoch: int) -> bool:
        """Whether a node is sent observations of an epoch that is not drained; of a drained one, it is in any case."""
        return includes(self.passes(name), epoch)

    @cached_property
    def _passed(self) -> Mapping[str, tuple[Turns, ...]]:
        wanted = {name: {self.turns_of(name)} for pair in self.pairs for name in pair}
        lowers: dict[str, list[str]] = {name: [] for name in wanted}
        awaited = dict.fromkeys(wanted, 0)  # how many of those above are still to come
        for lower, upper in self.pairs:
            lowers[upper].append(lower)
            awaited[lower] += 1
            if (lower, upper) in self.gathers:
                wanted[upper].add(self.turns_of(lower))
        done = [name for name, count in awaited.items() if not count]
        for upper in done:
            if EVERY_EPOCH in wanted[upper]:
                wanted[upper] = {EVERY_EPOCH}
            for lower in lowers[upper]:
                wanted[lower] |= wanted[upper]
                awaited[lower] -= 1
                if not awaited[lower]:
                    done.append(lower)
        return {name: tuple(sorted(turns, key=Turns.plain)) for name, turns in wanted.items()}

    def is_sensed(self, lower: str, upper: str, epoch: int) -> bool:
        """Whether φ of an edge is applied in an epoch: in its upper node's turns; where it gathers, its lower one's."""
        return self.takes_part(lower if (lower, upper) in self.gathers else upper, epoch)

    def in_force(self, lower: str, upper: str, epoch: int) -> int:
        """The epoch whose context and tasks from above count in this one; 0: there are none yet."""
        return self.edge(lower, upper).in_force(epoch)

    def since(self, lower: str, upper: str) -> int:
        """The first epoch in which there is an edge; 0: it is there from the beginning."""
        began = self.timing.began.get((lower, upper))
        return began.epoch if began is not None and began.is_new else 0

    def edge(self, lower: str, upper: str) -> EdgeRates:
        """The rates of an edge."""
        turns, began = self.turns_of(upper), self.timing.began.get((lower, upper))
        delay = self.delays.get((lower, upper), 0)
        return EdgeRates(turns.every, turns.offset, delay, *(() if began is None else began[:2]))

    def epochs_for(self, name: str) -> int:
        """How many epochs a node has for a turn, until it is waited for or its next turn is due; at least one."""
        return self._epochs_for.get(name, 1)

    @cached_property
    def _epochs_for(self) -> Mapping[str, int]:
        """By node that has some below."""
        least: dict[str, int] = {}
        for pair in self.pairs:
            upper = pair[1]
            least[upper] = min(least.get(upper, self.turns_of(upper).every), self.delays.get(pair, 0))
        return {upper: max(epochs, 1) for upper, epochs in least.items()}

    def awaited(self, epoch: int) -> frozenset[str]:
        """The nodes before whose turns in it an epoch that is not drained cannot end: edges without delay lead from
        them down to the world, by nodes that all take part in it. Where edges are not known, nobody is found."""
        uppers: dict[str, list[str]] = {}
        for lower, upper in self.pairs:
            uppers.setdefault(lower, []).append(upper)
        found = list(uppers.keys() - {upper for _, upper in self.pairs})
        for lower in found:
            above = [upper for upper in uppers.get(lower, ()) if (lower, upper) not in self.delays]
            found += [upper for upper in above if upper not in found and self.takes_part(upper, epoch)]
        return frozenset(found)

    @property
    def latest(self) -> int:
        """Since when all of them hold."""
        return max((*self.timing.since.values(), *(began.epoch for began in self.timing.began.values())), default=1)

    @property
    def reach(self) -> int:
        """How many epochs back something may be of that counts in one."""
        turns = max((turns.every for turns in self.turns.values()), default=1)
        return turns + max(self.delays.values(), default=0)

    @property
    def first_turns(self) -> int:
        """The epoch by which every node has taken part once."""
        return max((turns.offset or turns.every for turns in self.turns.values()), default=1)

    @property
    def awaits_epoch(self) -> bool:
        """Whether something counts from the roster's first epoch on, and that is not known."""
        return bool(self.timing.fresh or self.timing.changed)

    def as_of(self, epoch: int) -> "Rates":
        """The same once the roster's first epoch is known."""
        return replace(self, timing=self.timing.as_of(epoch)) if self.awaits_epoch else self
