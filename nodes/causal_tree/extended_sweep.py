"""The sweep with every number's exponent kept apart: for tables with zeros, and for evidence of any probability."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.causal_tree.extended_floats import (
    ExtendedFloats,
    Floats,
    Places,
    as_float64,
    divide,
    multiply,
    ones,
    products,
    total,
)
from hierax.nodes.causal_tree.float64_sweep import along
from hierax.nodes.causal_tree.plan import Group, Plan

# By number of states: columns, once each, and the likelihoods there; shape (size, columns).
Inputs = Mapping[int, tuple[Places, ExtendedFloats]]

Columns = int | slice | Places


class NothingLeftError(Exception):
    """The evidence is impossible; variable: the number of one of which no state is left."""

    def __init__(self, variable: int) -> None:
        self.variable = variable
        super().__init__(f"variable {variable}")


class Product(NamedTuple):
    """Products from which factors can be taken out again, whatever is 0."""

    rest: ExtendedFloats  # of all factors that are not 0
    zeros: NDArray[np.int64]  # how many are

    @staticmethod
    def of(values: ExtendedFloats) -> Product:
        """Products of one factor each."""
        zero = values.fraction == 0
        rest = ExtendedFloats(np.where(zero, 0.5, values.fraction), np.where(zero, 1, values.exponent))
        return Product(rest, zero * 1)

    @property
    def value(self) -> ExtendedFloats:
        """What the product is."""
        gone = self.zeros > 0
        return ExtendedFloats(np.where(gone, 0.0, self.rest.fraction), np.where(gone, 0, self.rest.exponent))

    def at(self, columns: Columns) -> Product:
        """Some columns."""
        return Product(self.rest.at(columns), self.zeros[:, columns])

    def take_in(self, columns: Columns, factors: Product) -> None:
        """Multiply some columns, in place."""
        rest = multiply(self.at(columns).rest, factors.rest)
        self.rest.fraction[:, columns] = rest.fraction
        self.rest.exponent[:, columns] = rest.exponent
        self.zeros[:, columns] += factors.zeros

    def without(self, factors: Product) -> ExtendedFloats:
        """What the products are without one of their factors each."""
        return Product(divide(self.rest, factors.rest), self.zeros - factors.zeros).value

    def copied(self) -> Product:
        """The same, to be changed."""
        return Product(ExtendedFloats(self.rest.fraction.copy(), self.rest.exponent.copy()), self.zeros.copy())


class ExtendedSweep:
    """One sweep up and one down; messages are as in `hierax.nodes.causal_tree.float64_sweep`, but never scaled."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._base = {size: Product.of(base) for size, base in plan.extended_base.items()}
        self._likelihoods: dict[int, Product] = {}
        self._beliefs: dict[int, Product] = {}
        self._messages: list[Product] = []
        self._supports: dict[int, ExtendedFloats] = {}

    def up(self, inputs: Inputs) -> None:
        """Sweep from the leaves to the roots. Raises NothingLeftError: the evidence is impossible. Without that, none
        of what follows can be."""
        self._likelihoods = {size: base.copied() for size, base in self._base.items()}
        for size, (columns, values) in inputs.items():
            self._likelihoods[size].take_in(columns, Product.of(values))
        for size in self._likelihoods:
            self._check(self._likelihoods, size, slice(None))
        self._messages = []
        for group in reversed(self._plan.groups):
            found = group.extended_table
            for size, columns in reversed(group.others):
                found = total(multiply(found, self._likelihoods[size].at(columns).value), axis=-2)
            nothing = ~found.fraction.any(axis=0)
            if nothing.any():
                raise NothingLeftError(group.nodes[int(nothing.argmax())])
            messages = Product.of(found)
            self._messages.append(messages)
            self._likelihoods[group.top_size].take_in(group.targets, _joined(group, messages))
            self._check(self._likelihoods, group.top_size, group.targets)
        self._messages.reverse()

    def down(self, at_roots: Inputs) -> None:
        """Sweep from the roots to the leaves, after `up`; at_roots: further likelihoods of roots. Raises
        NothingLeftError: they contradict the evidence."""
        self._beliefs = {size: likelihood.copied() for size, likelihood in self._likelihoods.items()}
        for size, (columns, values) in at_roots.items():
            self._beliefs[size].take_in(columns, Product.of(values))
            self._check(self._beliefs, size, columns)
        self._supports = {size: ones(*base.shape) for size, base in self._plan.base.items()}
        for group, messages in zip(self._plan.groups, self._messages, strict=True):
            self._spread(group, self._beliefs[group.top_size].at(group.tops).without(messages))

    def likelihood(self, size: int, column: int) -> ExtendedFloats:
        """L of a variable, from what lies further from the root, the prior and the evidence included; shape (size,)."""
        return self._likelihoods[size].at(column).value

    def support(self, size: int, column: int) -> ExtendedFloats:
        """What comes to a variable from the root's side; ones at a root; shape (size,)."""
        return self._supports[size].at(column)

    def float64_belief(self, size: int) -> Floats:
        """The product of both, of all variables with so many states, in float64; shape (size, columns)."""
        return as_float64(self._beliefs[size].value, 0)

    def message_up(self, group: int, family: int) -> ExtendedFloats:
        """What a family of a group told its top; shape (top's states,)."""
        return self._messages[group].at(family).value

    def _spread(self, group: Group, at_tops: ExtendedFloats) -> None:
        table = group.extended_table
        ndim = table.fraction.ndim
        from_top = total(multiply(table, _along(at_tops, 0, ndim)), axis=0)
        likelihoods = [self._likelihoods[size].at(columns).value for size, columns in group.others]
        for other, (size, columns) in enumerate(group.others):
            found = from_top
            for axis in reversed(range(len(likelihoods))):
                if axis != other:
                    found = total(multiply(found, _along(likelihoods[axis], axis, found.fraction.ndim)), axis)
            self._supports[size].fraction[:, columns] = found.fraction
            self._supports[size].exponent[:, columns] = found.exponent
            self._beliefs[size].take_in(columns, Product.of(found))

    def _check(self, found: Mapping[int, Product], size: int, columns: Columns) -> None:
        nothing = (found[size].zeros[:, columns] > 0).all(axis=0)
        if nothing.any():
            raise NothingLeftError(int(self._plan.members[size][columns][int(nothing.argmax())]))


def _joined(group: Group, messages: Product) -> Product:
    """The messages of all families that have a top in common."""
    ordered = messages if group.order is None else messages.at(group.order)
    if group.starts is None:
        return ordered
    return Product(products(ordered.rest, group.starts), np.add.reduceat(ordered.zeros, group.starts, axis=-1))


def _along(values: ExtendedFloats, axis: int, ndim: int) -> ExtendedFloats:
    return ExtendedFloats(along(values.fraction, axis, ndim), along(values.exponent, axis, ndim))
