"""In what order, and with what arrays, a network is swept: level by level, what has one depth and shape together.

A network without loops is a tree of variables and *families* (a node with its parents), whichever variable is taken for
its root. Each variable but the root hangs by one family from another variable, the family's *top*; the family's further
variables are its *others*. In a causal tree with its own root, the top is the parent and the one other the child. In a
polytree a family's top may be the child, and its others all parents.

Families of one depth, with tables of one shape, are a `Group`. Variables with the same number of states are the columns
of one array, in such an order that the others of a group stand side by side."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hierax.nodes.causal_tree.errors import Name
from hierax.nodes.causal_tree.extended_floats import ExtendedFloats, Floats, Places, extended
from hierax.nodes.causal_tree.network import Network


class Family(NamedTuple):
    """A node with parents, as numbers of variables."""

    members: tuple[int, ...]  # the parents, in the order of the table's axes, then the node
    table: Floats  # P(node | parents)


Placed = tuple[int, tuple[int, ...], Family]  # a family's top, its others, and the family itself


@dataclass(frozen=True)
class Group:
    """Families of one depth and shape; n of them."""

    table: Floats  # of all, shape (top's states, others' states…, n)
    others: tuple[tuple[int, slice], ...]  # for each other, where its n variables are: number of states, columns
    top_size: int  # the tops' number of states
    tops: Places  # their columns, family by family, shape (n,)
    order: Places | None  # the families by top, where they do not stand so; shape (n,)
    starts: Places | None  # in this order, where the families of each top begin; None where each has one
    targets: slice | Places  # the columns of the tops, once each: a slice where they stand side by side
    nodes: tuple[int, ...]  # the child of each family, as the number of a variable

    @cached_property
    def extended_table(self) -> ExtendedFloats:
        """The table for where exponents have to be kept apart."""
        return extended(self.table)


@dataclass(frozen=True)
class Plan:
    """How a network is swept."""

    groups: tuple[Group, ...]  # from the roots outward
    sizes: Sequence[int]  # of each variable, its number of states
    columns: Places  # of each variable, its column in the array of its size
    members: Mapping[int, Places]  # by size, the variable of each column
    base: Mapping[int, Floats]  # by size, the priors where a variable has no parents, else 1; shape (size, columns)
    roots: Sequence[int]  # variables that hang from none, one in each part of the network
    least: float  # the smallest number of all tables and priors
    others: int  # the most others that a family has

    @cached_property
    def extended_base(self) -> Mapping[int, ExtendedFloats]:
        """The priors for where exponents have to be kept apart."""
        return {size: extended(base) for size, base in self.base.items()}

    @cached_property
    def below(self) -> Mapping[int, Sequence[tuple[int, int]]]:
        """The places (group, family) of the families that have a variable for their top, by variable."""
        found: dict[int, list[tuple[int, int]]] = {}
        for number, group in enumerate(self.groups):
            members = self.members[group.top_size]
            for place, column in enumerate(group.tops):
                found.setdefault(int(members[column]), []).append((number, place))
        return found


def plan_of(network: Network, held: Sequence[Name]) -> tuple[Plan, dict[tuple[Name, Name], int]]:
    """Plan the sweeps of some nodes of a network, the variables of these numbers; rooted in those without parents. An
    arrow from another node ends at a guest, a variable with a number behind theirs: by child and parent, these are
    returned, too."""
    numbers = {name: number for number, name in enumerate(held)}
    sizes = [len(network.variables[name].states) for name in held]
    guests: dict[tuple[Name, Name], int] = {}
    priors, families = {}, []
    for number, name in enumerate(held):
        variable = network.variables[name]
        for axis, parent in enumerate(variable.parents):
            if parent not in numbers:
                guests[name, parent] = len(sizes)
                sizes.append(variable.table.shape[axis])
        if variable.parents:
            above = (numbers[parent] if parent in numbers else guests[name, parent] for parent in variable.parents)
            families.append(Family((*above, number), variable.table))
        else:
            priors[number] = variable.table
    return _make_plan(sizes, priors, families, (*guests.values(), *priors)), guests


def _make_plan(
    sizes: Sequence[int], priors: Mapping[int, Floats], families: Sequence[Family], roots: Sequence[int]
) -> Plan:
    """The plan of variables of these numbers of states; those in `roots` are taken for roots of their part of the
    network, where it has no other before. There is no loop."""
    levels, found = _levels(len(sizes), families, roots)
    has_below = np.zeros(len(sizes), bool)
    shapes: list[list[Placed]] = []
    for level in levels:
        has_below[[top for top, _, _ in level]] = True
        by_shape: dict[tuple[int, ...], list[Placed]] = {}
        for placed in level:
            by_shape.setdefault((sizes[placed[0]], *(sizes[other] for other in placed[1])), []).append(placed)
        shapes += by_shape.values()
    for entries in shapes:
        if len(entries[0][1]) == 1:  # those that have families themselves first: these are the next level's tops
            entries.sort(key=lambda entry: not has_below[entry[1][0]])
    columns, members = _columns(sizes, found, shapes)
    base = {size: np.ones((size, len(variables))) for size, variables in members.items()}
    for variable, prior in priors.items():
        base[sizes[variable]][:, columns[variable]] = prior
    tables = (*base.values(), *(family.table for family in families))
    return Plan(
        groups=tuple(_group(entries, sizes, columns) for entries in shapes),
        sizes=sizes,
        columns=columns,
        members=members,
        base=base,
        roots=found,
        least=min((float(table.min()) for table in tables), default=1.0),
        others=max((len(family.members) - 1 for family in families), default=1),
    )


def _levels(count: int, families: Sequence[Family], roots: Sequence[int]) -> tuple[list[list[Placed]], list[int]]:
    """The families by depth; and the variables that hang from none."""
    of_variable: list[list[int]] = [[] for _ in range(count)]
    for number, family in enumerate(families):
        for member in family.members:
            of_variable[member].append(number)
    seen = [False] * count
    taken = [False] * len(families)
    found: list[int] = []
    levels: list[list[Placed]] = []
    for root in (*roots, *range(count)):
        if seen[root]:
            continue
        found.append(root)
        frontier = [root]
        for depth in itertools.count():
            level: list[Placed] = []
            for top in frontier:
                seen[top] = True
                for number in of_variable[top]:
                    if not taken[number]:
                        taken[number] = True
                        others = tuple(member for member in families[number].members if member != top)
                        level.append((top, others, families[number]))
            if not level:
                break
            if depth == len(levels):
                levels.append([])
            levels[depth] += level
            frontier = [other for _, others, _ in level for other in others]
    return levels, found


def _columns(
    sizes: Sequence[int], roots: Sequence[int], shapes: Sequence[Sequence[Placed]]
) -> tuple[Places, dict[int, Places]]:
    """Each variable's column, and each column's variable: the others of a group side by side, other by other."""
    ordered = list(roots)
    for entries in shapes:
        for other in range(len(entries[0][1])):
            ordered += [others[other] for _, others, _ in entries]
    by_size: dict[int, list[int]] = {}
    columns = np.zeros(len(sizes), np.intp)
    for variable in ordered:
        found = by_size.setdefault(sizes[variable], [])
        columns[variable] = len(found)
        found.append(variable)
    return columns, {size: np.array(found, np.intp) for size, found in sorted(by_size.items())}


def _group(entries: Sequence[Placed], sizes: Sequence[int], columns: Places) -> Group:
    count = len(entries)
    top, others, _ = entries[0]
    tops = columns[[entry[0] for entry in entries]]
    firsts = [int(columns[other]) for other in others]
    order = np.argsort(tops, kind="stable") if (np.diff(tops) < 0).any() else None
    ordered = tops if order is None else tops[order]
    targets, starts = np.unique(ordered, return_index=True)
    first, last = int(targets[0]), int(targets[-1])
    return Group(
        table=_stacked(entries, (sizes[top], *(sizes[other] for other in others))),
        others=tuple((sizes[other], slice(at, at + count)) for other, at in zip(others, firsts, strict=True)),
        top_size=sizes[top],
        tops=tops,
        order=order,
        starts=None if len(targets) == count else starts,
        targets=slice(first, last + 1) if last - first + 1 == len(targets) else targets,
        nodes=tuple(family.members[-1] for _, _, family in entries),
    )


def _stacked(entries: Sequence[Placed], shape: tuple[int, ...]) -> Floats:
    """The tables with the top's axis first and the families last."""
    table = np.empty((len(entries), *shape))
    for place, (top, _, family) in enumerate(entries):
        axis = family.members.index(top)
        table[place] = family.table if axis == 0 else np.moveaxis(family.table, axis, 0)
    return np.ascontiguousarray(np.moveaxis(table, 0, -1))
