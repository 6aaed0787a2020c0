"""A Bayesian network without undirected loops: what a description says, checked, and how far news has to travel."""

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.causal_tree.errors import Name, NetworkError

Floats = NDArray[np.float64]
_NUMBER_BYTES = 8
Description = Sequence[Mapping[str, Any]]
"""``[{"id", "states", "parents": [...], "prior" | "cpt"}]``, in any order; `parse` says what each is."""

MAX_NODES = 1 << 18
MAX_STATES = 1 << 16  # of one node
MAX_PARENTS = 62  # of one node: tables of several that are alike lie in one array, which has 64 axes at most
MAX_TABLE_BYTES = 1 << 27  # all tables of a network together: 16.7 million numbers

# How far from 1 a distribution may sum: published tables are rounded. The numbers are used as they stand.
SUM_TOLERANCE = 1e-6
Parents = Mapping[Name, Sequence[Name]]  # by node, its parents


@dataclass(frozen=True)
class Variable:
    """A node of a Bayesian network."""

    name: Name  # its id
    states: tuple[str, ...]  # their names; "0", "1", … where only their number was given
    parents: tuple[Name, ...]  # ids, in the order of the table's axes
    table: Floats  # P(node | parents), or the prior, shape (parents' states…, states), float64, read-only


@dataclass(frozen=True)
class Network:
    """A causal tree, a polytree, or several of them side by side."""

    variables: Mapping[Name, Variable]  # by id, in the order of the description

    @property
    def is_tree(self) -> bool:
        """Whether no node has more than one parent."""
        return all(len(variable.parents) < 2 for variable in self.variables.values())


def parse(description: Description | Network) -> Network:
    """Read a description.

    Args:
        description: a list of maps, one for each node, in any order:

            - ``id``: a text or whole number, once in the list;
            - ``states``: their number, or a list of their names;
            - ``parents``: ids; may be left out where there are none;
            - ``prior``: of a node without parents, P(state), one number for each state;
            - ``cpt``: of a node with parents, P(state | parents) as nested lists
              ``cpt[state of the first parent]…[state]``. A node without parents may give its prior so, too.

    Raises:
        NetworkError: it is no network, or one with a cycle or an undirected loop; names the node, or prints the loop.
    """
    if isinstance(description, Network):
        return description
    if isinstance(description, (str, bytes, Mapping)) or not isinstance(description, Sequence):
        raise NetworkError(f"expected a list of nodes, got {type(description).__name__}")
    if not description:
        raise NetworkError("expected a list of nodes, got an empty one")
    if len(description) > MAX_NODES:
        raise NetworkError(f"{len(description)} nodes; at most {MAX_NODES} are allowed")
    entries: dict[Name, Mapping[str, Any]] = {}
    for place, entry in enumerate(description):
        name = _id(entry, place)
        if name in entries:
            raise NetworkError("there are two nodes of that id", name)
        entries[name] = entry
    states = {name: _states(entry, name) for name, entry in entries.items()}
    parents = {name: _parents(entry, name, entries) for name, entry in entries.items()}
    shapes = {name: (*(len(states[parent]) for parent in parents[name]), len(states[name])) for name in entries}
    check_tables(shapes)
    variables = {
        name: Variable(name, states[name], parents[name], _table(entry, name, shapes[name]))
        for name, entry in entries.items()
    }
    check_shape(parents)
    return Network(variables)


def check_tables(shapes: Mapping[Name, Sequence[int]]) -> None:
    """Whether tables of these shapes may be had, before any is made. Raises NetworkError: all together they have more
    than `MAX_TABLE_BYTES`; names the node at which that shows."""
    numbers = 0.0
    for name, shape in shapes.items():
        numbers += math.prod(map(float, shape))  # of a thousand parents inf, or after a 0 NaN
        if not numbers * _NUMBER_BYTES <= MAX_TABLE_BYTES:
            so_far = f"up to this one, of {_shown(tuple(shape)):.60}, the tables have {numbers:.3g} numbers"
            raise NetworkError(f"{so_far}; at most {MAX_TABLE_BYTES // _NUMBER_BYTES} ({MAX_TABLE_BYTES} bytes)", name)


def _id(entry: object, place: int) -> Name:
    if not isinstance(entry, Mapping):
        expected = "expected a map with id, states, parents and prior or cpt"
        raise NetworkError(f"entry {place + 1}: {expected}, got {entry!r:.60}")
    if "id" not in entry:
        raise NetworkError(f"entry {place + 1}: expected an id, got {', '.join(map(str, entry)) or 'nothing'}")
    name = entry["id"]
    if isinstance(name, bool) or not isinstance(name, (str, int)) or name == "":
        raise NetworkError(f"entry {place + 1}: id: expected a text or a whole number, got {name!r:.60}")
    return name


def _states(entry: Mapping[str, Any], name: Name) -> tuple[str, ...]:
    if "states" not in entry:
        raise NetworkError("states: expected their number or their names, got nothing", name)
    states = entry["states"]
    if isinstance(states, (int, np.integer)) and not isinstance(states, bool):
        if states < 1:
            raise NetworkError(f"states: expected at least 1, got {states}", name)
        if states > MAX_STATES:
            raise NetworkError(f"states: {states!r:.20} of them; at most {MAX_STATES} are allowed", name)
        return _numbered(int(states))
    if isinstance(states, (str, bytes)) or not isinstance(states, Sequence) or not states:
        raise NetworkError(f"states: expected their number or a list of their names, got {states!r:.60}", name)
    if len(states) > MAX_STATES:
        raise NetworkError(f"states: {len(states)} of them; at most {MAX_STATES} are allowed", name)
    names = tuple(str(state).lower() if isinstance(state, bool) else str(state) for state in states)
    if len(set(names)) < len(names):
        doubled = next(state for state, count in Counter(names).items() if count > 1)
        raise NetworkError(f"states: {doubled!r} is there twice", name)
    return names


@lru_cache(maxsize=16)
def _numbered(count: int) -> tuple[str, ...]:
    return tuple(map(str, range(count)))


def _parents(entry: Mapping[str, Any], name: Name, entries: Mapping[Name, object]) -> tuple[Name, ...]:
    parents = entry.get("parents")
    if parents is None:
        return ()
    if isinstance(parents, (str, bytes)) or not isinstance(parents, Sequence):
        raise NetworkError(f"parents: expected a list of ids, got {parents!r:.60}", name)
    if len(parents) > MAX_PARENTS:
        raise NetworkError(f"parents: {len(parents)} of them; at most {MAX_PARENTS} are allowed", name)
    for place, parent in enumerate(parents):
        if not isinstance(parent, Hashable) or parent not in entries:
            raise NetworkError(f"parents: there is no node {parent!r:.60}", name)
        if parent in parents[:place]:
            raise NetworkError(f"parents: {parent!r} is there twice", name)
    return tuple(parents)


def _table(entry: Mapping[str, Any], name: Name, shape: tuple[int, ...]) -> Floats:
    given = [key for key in ("prior", "cpt") if entry.get(key) is not None]
    if len(given) != 1:
        wanted = "a cpt" if len(shape) > 1 else "a prior"
        raise NetworkError(f"expected {wanted}, got {' and '.join(given) or 'neither prior nor cpt'}", name)
    key = given[0]
    if key == "prior" and len(shape) > 1:
        raise NetworkError("expected a cpt, as it has parents, got a prior", name)
    try:
        numbers = np.asarray(entry[key])
    except ValueError as error:
        expected = f"{key}: expected numbers of shape {_shown(shape)}"
        raise NetworkError(f"{expected}, got lists of uneven lengths", name) from error
    if numbers.dtype.kind not in "iuf":
        raise NetworkError(f"{key}: expected numbers, got {entry[key]!r:.60}", name)
    if numbers.shape != shape:
        raise NetworkError(f"{key}: expected numbers of shape {_shown(shape)}, got {_shown(numbers.shape)}", name)
    table = np.array(numbers, np.float64)
    _check_distributions(table, name, key)
    table.flags.writeable = False
    return table


def _check_distributions(table: Floats, name: Name, key: str) -> None:
    smallest = table.min()
    with np.errstate(all="ignore"):  # of what is too large for a sum: it is told below
        sums = np.add.reduce(table, axis=-1)
    if smallest >= 0 and np.abs(sums - 1.0).max() <= SUM_TOLERANCE:  # not so where there is a NaN, either
        return
    if not np.isfinite(table).all():
        raise NetworkError(f"{key}: expected finite numbers, got {table[~np.isfinite(table)][0]}", name)
    if smallest < 0:
        raise NetworkError(f"{key}: expected numbers of at least 0, got {smallest}", name)
    row = np.unravel_index(np.abs(sums - 1.0).argmax(), sums.shape) if sums.ndim else ()
    where = f"row [{', '.join(map(str, row))}]" if row else "the numbers"
    raise NetworkError(f"{key}: {where} should sum to 1, not {sums[row]:.9g}", name)


def _shown(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape)) or "a single number"


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
    arrows, entered = ((name, parent) for name, above in parents.items() for parent in above), come_from.items()
    name, parent = next(ends for ends in arrows if ends not in entered and ends[::-1] not in entered)
    loop = [*_between(come_from, name, parent), name]
    expected = "expected a tree or polytree, with one way at most between any two nodes"
    raise NetworkError(f"there is an undirected loop, {' - '.join(map(str, loop))}; {expected}")


def epochs_needed(network: Description | Network) -> int:
    """How many Updates with the same evidence make all beliefs exact, whatever they were before.

    In one Update news goes up any number of arrows, then down any number. It needs another one for each node on its way
    that it comes down to from one parent, and leaves up to another. So this is 1 for trees, and for a polytree 1 more
    than the most such nodes on any undirected path, if each node has a process; with larger parts it may take fewer."""
    parents = {name: each.parents for name, each in parse(network).variables.items()}
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
