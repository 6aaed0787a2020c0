"""A network's sweeps: the quick one where it suffices, else the careful one; which of them is found out each time."""

from __future__ import annotations

import math

import numpy as np

from hierax.nodes.causal_tree.careful import Careful, Columns, Inputs, NothingLeftError
from hierax.nodes.causal_tree.plan import Plan
from hierax.nodes.causal_tree.quick import Quick
from hierax.nodes.causal_tree.wide import Floats, Places, Wide, greatest, multiply, narrow, total, widen

__all__ = ["Inputs", "NothingLeftError", "Sweep"]

NO_INPUTS: Inputs = {}

LEAST_INPUT = 2.0**-300  # likelihoods further apart than this go the careful way at once


class Sweep:
    """Evidence in, posteriors out, for one plan. Holds the last sweep only.

    Attributes:
        is_careful: whether the last sweep was.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._quick = Quick(plan)
        self._careful = Careful(plan)
        self._evidence = {size: np.ones_like(base) for size, base in plan.base.items()}
        self._inputs: Inputs = {}
        self._exponents = 0
        self._least = 1.0
        self.is_careful = False

    def up(self, inputs: Inputs) -> None:
        """From the leaves to the roots.

        Args:
            inputs: likelihoods; of columns that are not named, ones.

        Raises:
            NothingLeftError: the evidence is impossible.
        """
        self._inputs = inputs
        plain = self._take_plain(inputs) and self._quick.can_suffice
        if plain:
            self._least = self._quick.up(self._evidence)
        self.is_careful = not (plain and self._quick.suffices(self._least))
        if self.is_careful:
            self._careful.up(inputs)

    def down(self, at_roots: Inputs = NO_INPUTS) -> None:
        """From the roots to the leaves, after `up`.

        Args:
            at_roots: further likelihoods of roots, which `up` had not.

        Raises:
            NothingLeftError: the evidence is impossible.
        """
        if not self.is_careful:
            plain = {size: (columns, narrow(values, 0)) for size, (columns, values) in at_roots.items()}
            least = min((float(np.where(found > 0, found, 1.0).min()) for _, found in plain.values()), default=1.0)
            if all(map(_is_plain, at_roots.values(), plain.values())):
                least *= self._quick.down(plain)
                if self._quick.suffices(self._least, least):
                    return
            self.is_careful = True
            self._careful.up(self._inputs)
        self._careful.down(at_roots)

    def posteriors(self, size: int) -> Floats:
        """Of all variables with so many states, after `down`; shape (columns, size)."""
        beliefs = narrow(self._careful.belief(size), 0) if self.is_careful else self._quick.beliefs[size]
        shares: Floats = np.divide(beliefs, np.add.reduce(beliefs, axis=0)).T
        return shares

    def log_evidence(self) -> float:
        """The natural logarithm of the sum over all states of their probability times the likelihoods given."""
        logs, exponents = 0.0, 0.0
        for size, column in self._roots():
            found = total(self.likelihood(size, slice(column, column + 1)), axis=0)
            logs += math.log(found.fraction[0])
            exponents += int(found.exponent[0])
        if not self.is_careful:
            logs += self._quick.log_scale()
            exponents += self._exponents
        return logs + exponents * math.log(2.0)

    def likelihood(self, size: int, columns: Columns) -> Wide:
        """L of some variables, up to a factor; shape (size, columns)."""
        if self.is_careful:
            return self._careful.likelihood(size, columns)
        return widen(self._quick.likelihoods[size][:, columns])

    def message_up(self, group: int, family: int) -> Wide:
        """What a family told its top, after `up`, up to a factor; shape (top's states,)."""
        if self.is_careful:
            return self._careful.message_up(group, family)
        return widen(self._quick.messages_up(group)[:, family])

    def support(self, variable: int) -> Wide:
        """What comes to a variable from the root's side, after `down`, up to a factor; shape (its states,)."""
        size, column = self._plan.sizes[variable], int(self._plan.columns[variable])
        if not self.is_careful:
            return widen(self._quick.supports[size][:, column])
        found = self._careful.support(size, slice(column, column + 1))
        return Wide(found.fraction[:, 0], found.exponent[:, 0])

    def inner(self, variable: int) -> Wide:
        """All that comes to a variable but its own input, after `down`, up to a factor; shape (its states,)."""
        size, column = self._plan.sizes[variable], int(self._plan.columns[variable])
        base = self._plan.wide_base[size]
        found = multiply(Wide(base.fraction[:, column], base.exponent[:, column]), self.support(variable))
        for group, family in self._plan.below.get(variable, ()):
            found = multiply(found, self.message_up(group, family))
        return found

    def _take_plain(self, inputs: Inputs) -> bool:
        """The likelihoods as float64; whether they can be."""
        self._exponents = 0
        plain = True
        for size, evidence in self._evidence.items():
            evidence.fill(1.0)
            if size in inputs:
                columns, values = inputs[size]
                scaled = narrow(values, 0)
                evidence[:, columns] = scaled
                self._exponents += int(greatest(values, 0).sum())
                plain = plain and _is_plain(inputs[size], (columns, scaled))
        return plain

    def _roots(self) -> list[tuple[int, int]]:
        return [(self._plan.sizes[root], int(self._plan.columns[root])) for root in self._plan.roots]


def _is_plain(given: tuple[Places, Wide], scaled: tuple[Places, Floats]) -> bool:
    """Whether likelihoods are what they are as float64, and leave a state to each variable."""
    possible = given[1].fraction > 0
    return bool(possible.any(axis=0).all()) and not ((scaled[1] < LEAST_INPUT) & possible).any()
