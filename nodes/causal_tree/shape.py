"""What the arrows of a network look like: cycles, undirected loops, and how far news has to travel."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

from hierax.nodes.causal_tree.errors import Name, NetworkError

Parents = Mapping[Name, Sequence[Name]]  # by node, its parents


def check_shape(parents: Parents) -> None:
    """Whether there is no way back to where one came from, along the arrows or whichever way.

    Raises:
        NetworkError: there is; prints it.
    """
    closing = _closing(parents)
    if closing is None:
        return
    cycle = _cycle(parents)
    if cycle:
        raise NetworkError(f"there is a cycle: {' -> '.join(map(str, cycle))}")
    loop = _loop(parents, closing)
    raise NetworkError(
        f"there is an undirected loop, {' - '.join(map(str, loop))}; expected a tree or polytree, "
        "with one way at most between any two nodes"
    )


def epochs_to_exactness(parents: Parents) -> int:
    """How many Updates with the same evidence make all beliefs exact, whatever they were before.

    In one Update news goes up any number of arrows, then down any number. It needs another one for each node on
    its way that it comes down to from one parent, and leaves up to another. So this is 1 for trees, and for a
    polytree 1 more than the most such nodes on any undirected path.

    Args:
        parents: of a tree or polytree, `check_shape`d.
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


def _closing(parents: Parents) -> tuple[Name, Name] | None:
    """The first arrow, as child and parent, between nodes that are joined already."""
    leader = {name: name for name in parents}

    def find(name: Name) -> Name:
        while leader[name] != name:
            leader[name] = leader[leader[name]]
            name = leader[name]
        return name

    for name, above in parents.items():
        for parent in above:
            one, other = find(name), find(parent)
            if one == other:
                return name, parent
            leader[one] = other
    return None


def _cycle(parents: Parents) -> list[Name]:
    """A cycle along the arrows, its first node again at the end; empty where there is none."""
    done: set[Name] = set()
    for start in parents:
        on_way: dict[Name, None] = {start: None}
        stack = [(start, iter(parents[start]))] if start not in done else []
        while stack:
            name, above = stack[-1]
            parent: Name | None = next((each for each in above if each not in done), None)
            if parent is None:
                done.add(name)
                on_way.pop(name)
                stack.pop()
            elif parent in on_way:
                names = list(on_way)
                return [parent, *reversed(names[names.index(parent) :])]
            else:
                on_way[parent] = None
                stack.append((parent, iter(parents[parent])))
    return []


def _loop(parents: Parents, closing: tuple[Name, Name]) -> list[Name]:
    """The undirected loop that an arrow closes, its first node again at the end."""
    joined: dict[Name, list[Name]] = {name: [] for name in parents}
    for name, above in parents.items():
        for parent in above:
            if (name, parent) == closing:
                return [*_way(joined, parent, name), parent]
            joined[name].append(parent)
            joined[parent].append(name)
    raise AssertionError("the closing arrow is one of the network's")


def _way(joined: Mapping[Name, Sequence[Name]], start: Name, end: Name) -> list[Name]:
    """The way between two nodes that are joined."""
    before = {end: end}
    waiting = deque([end])
    while start not in before:
        name = waiting.popleft()
        for neighbour in joined[name]:
            if neighbour not in before:
                before[neighbour] = name
                waiting.append(neighbour)
    way = [start]
    while way[-1] != end:
        way.append(before[way[-1]])
    return way


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
