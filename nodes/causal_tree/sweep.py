"""A network's sweeps: in float64 where that suffices, else with exponents kept apart; which is found out each time.

The latter are for tables with zeros, and for evidence of any probability."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.causal_tree.extended_floats import ExtendedFloats, Floats, Inputs, Places, extended, ones
from hierax.nodes.causal_tree.float64_sweep import Float64Sweep
from hierax.nodes.causal_tree.plan import Group, Plan

Columns = int | slice | Places


class NothingLeftError(Exception):
    """The evidence is impossible: it leaves no state of the variable of this number."""

    def __init__(self, variable: int) -> None:
        self.variable = variable
        super().__init__(f"variable {variable}")


class Product(NamedTuple):
    """Products from which factors can be taken out again, whatever is 0."""

    rest: ExtendedFloats  # of all factors that are not 0
    zeros: NDArray[np.int64]  # how many are

    @staticmethod
    def of(values: ExtendedFloats) -> "Product":
        """Products of one factor each."""
        zero = values.fraction == 0
        rest = ExtendedFloats(np.where(zero, 0.5, values.fraction), np.where(zero, 1, values.exponent))
        return Product(rest, zero * 1)

    @property
    def value(self) -> ExtendedFloats:
        gone = self.zeros > 0
        return ExtendedFloats(np.where(gone, 0.0, self.rest.fraction), np.where(gone, 0, self.rest.exponent))

    def at(self, columns: Columns) -> "Product":
        return Product(self.rest.at(columns), self.zeros[:, columns])

    def take_in(self, columns: Columns, factors: "Product") -> None:
        """Multiply some columns, in place."""
        self.rest.put(columns, self.rest.at(columns).times(factors.rest))
        self.zeros[:, columns] += factors.zeros

    def without(self, factors: "Product") -> ExtendedFloats:
        """What the products are without one of their factors each."""
        return Product(self.rest.over(factors.rest), self.zeros - factors.zeros).value

    def copied(self) -> "Product":
        """The same, to be changed."""
        return Product(ExtendedFloats(self.rest.fraction.copy(), self.rest.exponent.copy()), self.zeros.copy())


class ExtendedSweep:
    """One sweep up and one down; its attributes are as those of `Float64Sweep`, but messages are never scaled."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._base = {size: Product.of(base) for size, base in plan.extended_base.items()}
        self.likelihoods: dict[int, Product] = {}
        self.beliefs: dict[int, Product] = {}
        self.messages: list[Product] = []
        self.supports: dict[int, ExtendedFloats] = {}

    def up(self, inputs: Inputs) -> None:
        """Sweep from the leaves to the roots. Raises NothingLeftError: the evidence is impossible. Without that, none
        of what follows can be."""
        self.likelihoods = {size: base.copied() for size, base in self._base.items()}
        for size, columns, values in inputs:
            self.likelihoods[size].take_in(columns, Product.of(values))
        for size in self.likelihoods:
            self._check(self.likelihoods, size, slice(None))
        self.messages = []
        for group in reversed(self._plan.groups):
            found = group.extended_table
            for size, columns in reversed(group.others):
                found = found.times(self.likelihoods[size].at(columns).value).total(-2)
            nothing = ~found.fraction.any(axis=0)
            if nothing.any():
                raise NothingLeftError(group.nodes[int(nothing.argmax())])
            messages = Product.of(found)
            self.messages.append(messages)
            self.likelihoods[group.top_size].take_in(group.targets, _joined(group, messages))
            self._check(self.likelihoods, group.top_size, group.targets)
        self.messages.reverse()

    def down(self, at_roots: Inputs) -> None:
        """Sweep from the roots, of which there are further likelihoods, to the leaves, after `up`. Raises
        NothingLeftError: they contradict the evidence."""
        self.beliefs = {size: likelihood.copied() for size, likelihood in self.likelihoods.items()}
        for size, columns, values in at_roots:
            self.beliefs[size].take_in(columns, Product.of(values))
            self._check(self.beliefs, size, columns)
        self.supports = {size: ones(*base.shape) for size, base in self._plan.base.items()}
        for group, messages in zip(self._plan.groups, self.messages, strict=True):
            self._spread(group, self.beliefs[group.top_size].at(group.tops).without(messages))

    def _spread(self, group: Group, at_tops: ExtendedFloats) -> None:
        table = group.extended_table
        from_top = table.times(at_tops.along(0, table.fraction.ndim)).total(0)
        likelihoods = [self.likelihoods[size].at(columns).value for size, columns in group.others]
        for other, (size, columns) in enumerate(group.others):
            found = from_top
            for axis in reversed(range(len(likelihoods))):
                if axis != other:
                    found = found.times(likelihoods[axis].along(axis, found.fraction.ndim)).total(axis)
            self.supports[size].put(columns, found)
            self.beliefs[size].take_in(columns, Product.of(found))

    def _check(self, found: Mapping[int, Product], size: int, columns: Columns) -> None:
        nothing = (found[size].zeros[:, columns] > 0).all(axis=0)
        if nothing.any():
            raise NothingLeftError(int(self._plan.members[size][columns][int(nothing.argmax())]))


def _joined(group: Group, messages: Product) -> Product:
    """The messages of all families that have a top in common."""
    ordered = messages if group.order is None else messages.at(group.order)
    if group.starts is None:
        return ordered
    return Product(ordered.rest.products(group.starts), np.add.reduceat(ordered.zeros, group.starts, axis=-1))


class Sweep:
    """Evidence in, posteriors out, for one plan. Holds the last sweep only."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._float64, self._extended = Float64Sweep(plan), ExtendedSweep(plan)
        self._inputs: Inputs = ()
        self.is_extended = False  # whether the last sweep kept exponents apart

    def up(self, inputs: Inputs) -> None:
        """Sweep from the leaves to the roots; likelihoods of columns that are not named are ones. Raises
        NothingLeftError: the evidence is impossible."""
        self._inputs = inputs
        self.is_extended = not self._float64.up(inputs)
        if self.is_extended:
            self._extended.up(inputs)

    def down(self, at_roots: Inputs = ()) -> None:
        """Sweep from the roots, of which `up` had not these likelihoods, to the leaves, after `up`. Raises
        NothingLeftError: the evidence is impossible."""
        if not self.is_extended and not self._float64.down(at_roots):
            self.is_extended = True
            self._extended.up(self._inputs)
        if self.is_extended:
            self._extended.down(at_roots)

    def posteriors(self, size: int) -> Floats:
        """The posteriors of all variables with so many states, after `down`; shape (columns, size)."""
        beliefs = self._last.beliefs[size]
        if isinstance(beliefs, Product):
            beliefs = beliefs.value.as_float64(0)
        return np.asarray(np.divide(beliefs, np.add.reduce(beliefs, axis=0)).T)

    def log_evidence(self) -> float:
        """The natural logarithm of the sum over all states of their probability times the likelihoods given."""
        logs, exponents = 0.0, 0.0
        for root in self._plan.roots:
            size, column = self._place(root)
            found = _column(self._last.likelihoods[size], column).total(0)
            logs += math.log(found.fraction)
            exponents += int(found.exponent)
        if not self.is_extended:
            logs += self._float64.log_scale()
            exponents += self._float64.exponents
        return logs + exponents * math.log(2.0)

    def message_up(self, group: int, family: int) -> ExtendedFloats:
        """What a family told its top, after `up`, up to a factor; shape (top's states,)."""
        return _column(self._last.messages[group], family)

    def support(self, variable: int) -> ExtendedFloats:
        """What comes to a variable from the root's side, after `down`, up to a factor; shape (its states,)."""
        size, column = self._place(variable)
        return _column(self._last.supports[size], column)

    def inner(self, variable: int) -> ExtendedFloats:
        """All that comes to a variable but its own input, after `down`, up to a factor; shape (its states,)."""
        size, column = self._place(variable)
        found = self._plan.extended_base[size].at(column).times(self.support(variable))
        for group, family in self._plan.below.get(variable, ()):
            found = found.times(self.message_up(group, family))
        return found

    @property
    def _last(self) -> Float64Sweep | ExtendedSweep:
        return self._extended if self.is_extended else self._float64

    def _place(self, variable: int) -> tuple[int, int]:
        """A variable's number of states, and its column in the array of that size."""
        return self._plan.sizes[variable], int(self._plan.columns[variable])


def _column(values: Floats | ExtendedFloats | Product, column: int) -> ExtendedFloats:
    """One column, in whichever way its numbers are kept."""
    if isinstance(values, np.ndarray):
        return extended(values[:, column])
    one = values.at(column)
    return one.value if isinstance(one, Product) else one
