"""Cutting a hierarchy into processes: with the fewest bytes between them, or evenly."""

from collections.abc import Mapping
from itertools import pairwise

from hierax.runtime.core.graph import neighbours
from hierax.schemas.rates import Pair
from hierax.schemas.roster import Roster


def cut(roster: Roster, count: int, traffic: Mapping[Pair, float] | None = None) -> dict[str, tuple[str, ...]]:
    """The nodes of so many processes, by their names; fewer where there are fewer nodes.

    `traffic`: how many bytes pass along edges, both ways. The processes are those that are left when those with the
    most bytes between them are joined, again and again: the fewest bytes across, where the edges are a tree. Without
    it, they have as many nodes each, neighbours together as far as that goes."""
    groups = _evenly(roster, count) if traffic is None else _by_traffic(roster, count, traffic)
    prefix = next(prefix for prefix in _PREFIXES if not any(name.startswith(prefix) for name in roster.nodes))
    return {f"{prefix}{number}": tuple(sorted(group)) for number, group in enumerate(groups, 1)}


_PREFIXES = ("process", "process-", *(f"process-{number}-" for number in range(100)))


def _evenly(roster: Roster, count: int) -> list[list[str]]:
    """Parts of a walk from the world upwards, branch by branch, of lengths that differ by one at most."""
    _, above = neighbours([edge.pair for edge in roster.edges])
    walk: dict[str, None] = {}
    left = [roster.world]
    while left:
        name = left.pop()
        if name not in walk:
            walk[name] = None
            left += sorted(above.get(name, ()), reverse=True)
    names, count = list(walk), min(count, len(walk))
    ends = [len(names) * number // count for number in range(count + 1)]
    return [names[begin:end] for begin, end in pairwise(ends)]


def _by_traffic(roster: Roster, count: int, traffic: Mapping[Pair, float]) -> list[list[str]]:
    groups = {name: [name] for name in sorted(roster.nodes)}
    between: dict[str, dict[str, float]] = {name: {} for name in groups}
    for edge in roster.edges:
        for one, other in (edge.pair, edge.pair[::-1]):
            between[one][other] = between[one].get(other, 0.0) + traffic.get(edge.pair, 0.0)
    while len(groups) > count:
        # where nothing is known to pass, the smallest ones: so they are even at least
        one, other = max(
            ((one, other) for one, others in between.items() for other in others if one < other),
            key=lambda pair: (between[pair[0]][pair[1]], -len(groups[pair[0]]) - len(groups[pair[1]]), pair),
        )
        groups[one] += groups.pop(other)
        for third, passed in between.pop(other).items():
            del between[third][other]
            if third != one:
                between[one][third] = between[third][one] = between[one].get(third, 0.0) + passed
    return list(groups.values())
