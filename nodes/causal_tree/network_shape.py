"""What the arrows of a network look like: cycles, undirected loops, and how far news has to travel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

from hierax.nodes.causal_tree.errors import Name, NetworkError

Parents = Mapping[Name, Sequence[Name]]  # by node, its parents


def check_shape(parents: Parents) -> None:
    """Whether there is no way back to where one came from, along the arrows or whichever way. Raises NetworkError:
    there is; prints it."""
    _, come_from = _outward(parents)
    if sum(map(len, parents.values())) == len(come_from):  # a forest has no further arrows
        return
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        raise NetworkError(f"there is a cycle: {' -> '.join(map(str, error.args[1]))}") from None
    arrows = ((name, parent) for name, above in parents.items() for parent in above)
    name, parent = next(
        ends for ends in arrows if ends not in come_from.items() and ends[::-1] not in come_from.items()
    )
    loop = [*_between(come_from, name, parent), name]
    raise NetworkError(
        f"there is an undirected loop, {' - '.join(map(str, loop))}; expected a tree or polytree, "
        "with one way at most between any two nodes"
    )


def epochs_to_exactness(parents: Parents) -> int:
    """How many Updates with the same evidence make all beliefs exact, whatever they were before.

    In one Update news goes up any number of arrows, then down any number. It needs another one for each node on
    its way that it comes down to from one parent, and leaves up to another. So this is 1 for trees, and for a
    polytree 1 more than the most such nodes on any undirected path.

    Args: parents: of a tree or polytree, `check_shape`d.
    """
    order, come_from = _outward(parents)
    longest: dict[Name, int] = {}
    most = 0
    heads: dict[Name, list[int]] = {name: [] for name in parents}  # ways on to parents of a node
    others: dict[Name, list[int]] = {name: [] for name in parents}  # and to its children
    for name in reversed(order):
        up = sorted(heads.pop(name), reverse=True)[:2]
        down = sorted(others.pop(name), reverse=True)[:2]
        most = max(most, sum(down), sum(up) + 1 if len(up) == 2 else 0, *(a + b for a in up[:1] for b in down[:1]), *up)
        before = come_from.get(name)
        if before is None:
            continue
        entered_from_parent = before in parents[name]
        longest[name] = max(0, *(way + entered_from_parent for way in up), *down) if up or down else 0
        (others if entered_from_parent else heads)[before].append(longest[name])
    return most + 1


def _between(come_from: Mapping[Name, Name], start: Name, end: Name) -> list[Name]:
    """The way between two nodes of one part, along the ways by which it was entered."""
    way, back = [start], [end]
    for ends in (way, back):
        while ends[-1] in come_from:
            ends.append(come_from[ends[-1]])
    while len(way) > 1 and len(back) > 1 and way[-2] == back[-2]:  # up to where both ways meet first
        del way[-1], back[-1]
    return [*way, *back[-2::-1]]


def _outward(parents: Parents) -> tuple[list[Name], dict[Name, Name]]:
    """All nodes, each behind the one through which its part of the network is entered, and which that is."""
    joined: dict[Name, list[Name]] = {name: list(above) for name, above in parents.items()}
    for name, above in parents.items():
        for parent in above:
            joined[parent].append(name)
    order: list[Name] = []
    come_from: dict[Name, Name] = {}
    seen: set[Name] = set()
    for start in parents:
        waiting = [start] if start not in seen else []
        seen.add(start)
        while waiting:
            name = waiting.pop()
            order.append(name)
            for neighbour in joined[name]:
                if neighbour not in seen:
                    seen.add(neighbour)
                    come_from[neighbour] = name
                    waiting.append(neighbour)
    return order, come_from
