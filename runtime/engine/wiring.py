"""How a node is joined to its neighbours under one version of the roster."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

from hierax.runtime.core.binding import BoundNode, Call
from hierax.runtime.core.digest import NO_DIGEST
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.rates import Pair, Rates
from hierax.schemas.roster import Roster

Slot = tuple[str, str]  # a sender and a kind: from each, one message comes in an epoch


@dataclass(frozen=True)
class Place:
    """Where a node stands in its roster."""

    roster: int = 0  # the roster's version
    roster_hash: bytes = NO_DIGEST  # hash of its content; nobody but the world needs it
    instances: Mapping[str, int] = field(default_factory=dict)  # instance numbers, of the node and its neighbours
    tasking: frozenset[Pair] = frozenset()  # the edges (lower, upper) that have a task function ψ
    rates: Rates | None = None  # of the hierarchy

    @staticmethod
    def of(roster: Roster, hashed: bool = True) -> "Place":
        content = roster.content_hash() if hashed else NO_DIGEST
        return Place(roster.version, content, roster.instances, roster.tasking, roster.rates)

    def instance(self, name: str) -> int:
        return self.instances.get(name, 0)


class Wiring:
    """A node and all that joins it to its neighbours, laid out for the engine.

    `below` and `above` have, for each slot that is filled from there in an epoch, the instance of its sender."""

    __slots__ = ("above", "below", "context", "instance", "node", "place", "roster", "sense", "task", "tasking")

    def __init__(self, node: BoundNode, edges: Sequence[BoundEdge], place: Place) -> None:
        name = node.name
        by_pair = {(edge.lower, edge.upper): edge for edge in edges}
        self.node = node  # bound to its name and neighbours
        self.place = place  # the roster
        self.roster = place.roster
        self.instance = place.instance(name)
        # The upper neighbours that send task messages.
        self.tasking = tuple(upper for upper in node.above if (name, upper) in place.tasking)
        self.below: Mapping[Slot, int] = {(lower, OBSERVATIONS): place.instance(lower) for lower in node.below}
        self.above: Mapping[Slot, int] = {
            **{(upper, CONTEXT): place.instance(upper) for upper in node.above},
            **{(upper, TASKS): place.instance(upper) for upper in self.tasking},
        }
        downward = {lower: by_pair[lower, name] for lower in node.below}
        # φ by the upper neighbour, None where there is none.
        self.sense: Sequence[tuple[str, Call | None]] = [(upper, by_pair[name, upper].sense) for upper in node.above]
        # ψ by the lower neighbour, where there is one.
        self.task: Sequence[tuple[str, Call]] = [(lower, edge.task) for lower, edge in downward.items() if edge.task]
        # ϱ by the lower neighbour, None where there is none.
        self.context: Sequence[tuple[str, Call | None]] = [(lower, edge.context) for lower, edge in downward.items()]

    def under(self, version: int) -> "Wiring":
        """The same under a version that changes nothing of the node and near it; of others it stays as it was."""
        again = copy(self)
        again.place = replace(self.place, roster=version)
        again.roster = version
        return again
