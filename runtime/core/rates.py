"""How often nodes take part in epochs, and from when on what is predicted counts below."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from hierax.runtime.core.elements import Value
from hierax.runtime.core.graph import Pair


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


EVERY_EPOCH = Turns()


@dataclass(frozen=True)
class Rates:
    """What a deployment says of rates; true where it says anything."""

    turns: Mapping[str, Turns] = field(default_factory=dict)  # of nodes that do not take part in every epoch
    delays: Mapping[Pair, int] = field(default_factory=dict)  # of edges (lower, upper), where not 0
    gathers: frozenset[Pair] = frozenset()  # edges on which the upper node has all observations since its last turn

    def __bool__(self) -> bool:
        return bool(self.turns or self.delays or self.gathers)

    def takes_part(self, name: str, epoch: int) -> bool:
        return self.turns.get(name, EVERY_EPOCH).include(epoch)

    def next_turn(self, name: str, epoch: int) -> int:
        """The first epoch after this one in which a node takes part."""
        turns = self.turns.get(name, EVERY_EPOCH)
        return turns.last(epoch + turns.every) or turns.offset or turns.every

    def is_sensed(self, lower: str, upper: str, epoch: int) -> bool:
        """Whether φ of an edge is applied in an epoch: in its upper node's turns; where it gathers, its lower one's."""
        return self.takes_part(lower if (lower, upper) in self.gathers else upper, epoch)

    def in_force(self, lower: str, upper: str, epoch: int) -> int:
        """The epoch whose context and tasks from above count in this one; 0: there are none yet."""
        return self.turns.get(upper, EVERY_EPOCH).last(epoch - self.delays.get((lower, upper), 0))

    @property
    def span(self) -> int:
        """How many epochs a node may be ahead of another one, at most."""
        return sum(turns.every for turns in self.turns.values()) + sum(self.delays.values())

    @property
    def first_turns(self) -> int:
        """The epoch by which every node has taken part once."""
        return max((turns.offset or turns.every for turns in self.turns.values()), default=1)

    def plain(self) -> Value:
        """As a value that `read` reads."""
        return (
            [(name, turns.every, turns.offset) for name, turns in self.turns.items()],
            [(*pair, delay) for pair, delay in self.delays.items()],
            sorted(self.gathers),
        )

    @staticmethod
    def read(value: Value) -> "Rates":
        """What `plain` gave, after it has travelled."""
        turns, delays, gathers = value
        return Rates(
            {name: Turns(every, offset) for name, every, offset in turns},
            {(lower, upper): delay for lower, upper, delay in delays},
            frozenset((lower, upper) for lower, upper in gathers),
        )


NO_RATES = Rates()
