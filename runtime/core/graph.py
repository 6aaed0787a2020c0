"""When nodes and edges form a hierarchy (definition 2): pure checks on names."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from hierax.runtime.core.errors import HierarchyError
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import check_name
from hierax.schemas.rates import Pair


def check_graph(world: str, names: Iterable[str], pairs: Sequence[Pair]) -> None:
    """Refuse what is no hierarchy, of nodes by name, and edges by their (lower, upper) names.

    Raises `HierarchyError` with the reason and the names: a name that cannot stand in a key or file name, an unknown
    node, an edge from a node to itself, a doubled edge, something below the world, a cycle, a second source, a node
    that cannot be reached from the world."""
    try:
        known = sorted(check_name(name, "node's name") for name in names)
    except SchemaError as error:
        raise HierarchyError(str(error)) from error
    if world not in known:
        raise HierarchyError(f"the world {world!r} is none of the nodes {_list(known)}")
    _check_edges(known, pairs)
    below_world = sorted(lower for lower, upper in pairs if upper == world)
    if below_world:
        raise HierarchyError(f"nothing may be below the world {world!r}, but {_list(below_world)} is")
    topological_order(known, pairs)
    _check_sources(world, known, pairs)


def topological_order(names: Iterable[str], pairs: Iterable[Pair]) -> tuple[str, ...]:
    """The names from below to above, ties by name. Raises `HierarchyError` if the edges form a cycle; it is printed."""
    sorter: TopologicalSorter[str] = TopologicalSorter(dict.fromkeys(names, ()))
    for lower, upper in pairs:
        sorter.add(upper, lower)
    try:
        sorter.prepare()
    except CycleError as error:
        raise HierarchyError(f"the edges form a cycle: {' -> '.join(error.args[1])}") from error
    order: list[str] = []
    while sorter.is_active():
        ready = sorted(sorter.get_ready())
        order += ready
        sorter.done(*ready)
    return tuple(order)


def depths(names: Iterable[str], pairs: Sequence[Pair]) -> dict[str, int]:
    """How many edges lie on the longest way from the world to each node, in an order from below to above."""
    found: dict[str, int] = {}
    below, _ = neighbours(pairs)
    for name in topological_order(names, pairs):
        found[name] = max((found[lower] + 1 for lower in below.get(name, ())), default=0)
    return found


def unreached(world: str, names: Collection[str], pairs: Sequence[Pair]) -> list[str]:
    """The names that cannot be reached from the world."""
    reached = {world}
    below, _ = neighbours(pairs)
    for name in topological_order(names, pairs):
        if not reached.isdisjoint(below.get(name, ())):
            reached.add(name)
    return [name for name in names if name not in reached]


def neighbours(pairs: Iterable[Pair]) -> tuple[Mapping[str, tuple[str, ...]], Mapping[str, tuple[str, ...]]]:
    """The nodes below, and those above, by the name of each node that has some there; themselves by name."""
    below: dict[str, list[str]] = defaultdict(list)
    above: dict[str, list[str]] = defaultdict(list)
    for lower, upper in sorted(pairs):
        below[upper].append(lower)
        above[lower].append(upper)
    return {name: tuple(each) for name, each in below.items()}, {name: tuple(each) for name, each in above.items()}


def _check_edges(known: Sequence[str], pairs: Sequence[Pair]) -> None:
    seen: set[Pair] = set()
    names = frozenset(known)
    for lower, upper in pairs:
        name = f"{lower}->{upper}"
        for end in (lower, upper):
            if end not in names:
                raise HierarchyError(f"edge {name} names {end!r}, which is none of the nodes {_list(known)}")
        if lower == upper:
            raise HierarchyError(f"edge {name} joins a node to itself")
        if (lower, upper) in seen:
            raise HierarchyError(f"edge {name} is given twice")
        seen.add((lower, upper))


def _check_sources(world: str, known: Sequence[str], pairs: Sequence[Pair]) -> None:
    unreachable = unreached(world, known, pairs)
    if not unreachable:
        return
    sensing = {upper for _, upper in pairs}
    acting = {lower for lower, _ in pairs}
    alone = [name for name in unreachable if name not in sensing and name not in acting]
    if alone:
        raise HierarchyError(f"{_list(alone)} cannot be reached from the world {world!r}: no edge joins it")
    sources = [name for name in unreachable if name not in sensing]
    raise HierarchyError(
        f"the world {world!r} must be the only source, but nothing is below {_list(sources)} either; "
        f"unreachable from the world: {_list(unreachable)}"
    )


def _list(names: Iterable[str]) -> str:
    return ", ".join(repr(name) for name in names)
