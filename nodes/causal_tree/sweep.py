"""A network's sweeps: in float64 where that suffices, else with exponents kept apart; which is found out each time."""

from __future__ import annotations

import math

import numpy as np

from hierax.nodes.causal_tree.extended_floats import (
    ExtendedFloats,
    Floats,
    Places,
    as_float64,
    greatest,
    multiply,
    total,
)
from hierax.nodes.causal_tree.extended_sweep import ExtendedSweep, Inputs, NothingLeftError
from hierax.nodes.causal_tree.float64_sweep import Float64Sweep
from hierax.nodes.causal_tree.plan import Plan

__all__ = ["Inputs", "NothingLeftError", "Sweep"]

NO_INPUTS: Inputs = {}

LEAST_INPUT = 2.0**-300  # likelihoods further apart than this are extended at once


class Sweep:
    """Evidence in, posteriors out, for one plan. Holds the last sweep only."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._float64 = Float64Sweep(plan)
        self._extended = ExtendedSweep(plan)
        self._evidence = {size: np.ones_like(base) for size, base in plan.base.items()}
        self._inputs: Inputs = {}
        self._exponents = 0
        self._least = 1.0
        self._last: Float64Sweep | ExtendedSweep = self._float64

    @property
    def is_extended(self) -> bool:
        """Whether the last sweep kept exponents apart."""
        return self._last is self._extended

    def up(self, inputs: Inputs) -> None:
        """Sweep from the leaves to the roots; inputs: likelihoods; of columns that are not named, ones. Raises
        NothingLeftError: the evidence is impossible."""
        self._inputs = inputs
        if self._take_plain(inputs) and self._float64.can_suffice:
            self._least = self._float64.up(self._evidence)
            if self._float64.suffices(self._least):
                self._last = self._float64
                return
        self._last = self._extended
        self._extended.up(inputs)

    def down(self, at_roots: Inputs = NO_INPUTS) -> None:
        """Sweep from the roots to the leaves, after `up`; at_roots: further likelihoods of roots, which `up` had
        not. Raises NothingLeftError: the evidence is impossible."""
        if not self.is_extended:
            plain = {size: (columns, as_float64(values, 0)) for size, (columns, values) in at_roots.items()}
            least = min((float(np.where(found > 0, found, 1.0).min()) for _, found in plain.values()), default=1.0)
            if all(map(_is_plain, at_roots.values(), plain.values())):
                least *= self._float64.down(plain)
                if self._float64.suffices(self._least, least):
                    return
            self._last = self._extended
            self._extended.up(self._inputs)
        self._extended.down(at_roots)

    def posteriors(self, size: int) -> Floats:
        """The posteriors of all variables with so many states, after `down`; shape (columns, size)."""
        beliefs = self._last.float64_belief(size)
        shares: Floats = np.divide(beliefs, np.add.reduce(beliefs, axis=0)).T
        return shares

    def log_evidence(self) -> float:
        """The natural logarithm of the sum over all states of their probability times the likelihoods given."""
        logs, exponents = 0.0, 0.0
        for root in self._plan.roots:
            found = total(self._last.likelihood(*self._place(root)), axis=0)
            logs += math.log(found.fraction)
            exponents += int(found.exponent)
        if not self.is_extended:
            logs += self._float64.log_scale()
            exponents += self._exponents
        return logs + exponents * math.log(2.0)

    def message_up(self, group: int, family: int) -> ExtendedFloats:
        """What a family told its top, after `up`, up to a factor; shape (top's states,)."""
        return self._last.message_up(group, family)

    def support(self, variable: int) -> ExtendedFloats:
        """What comes to a variable from the root's side, after `down`, up to a factor; shape (its states,)."""
        return self._last.support(*self._place(variable))

    def inner(self, variable: int) -> ExtendedFloats:
        """All that comes to a variable but its own input, after `down`, up to a factor; shape (its states,)."""
        size, column = self._place(variable)
        found = multiply(self._plan.extended_base[size].at(column), self.support(variable))
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
                scaled = as_float64(values, 0)
                evidence[:, columns] = scaled
                self._exponents += int(greatest(values, 0).sum())
                plain = plain and _is_plain(inputs[size], (columns, scaled))
        return plain

    def _place(self, variable: int) -> tuple[int, int]:
        """A variable's number of states, and its column in the array of that size."""
        return self._plan.sizes[variable], int(self._plan.columns[variable])


def _is_plain(given: tuple[Places, ExtendedFloats], scaled: tuple[Places, Floats]) -> bool:
    """Whether likelihoods are what they are as float64, and leave a state to each variable."""
    possible = given[1].fraction > 0
    return bool(possible.any(axis=0).all()) and not ((scaled[1] < LEAST_INPUT) & possible).any()
