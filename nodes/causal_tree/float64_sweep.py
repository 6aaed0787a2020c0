"""The sweep in ordinary float64: exact enough while no number comes near underflow, which is checked, not hoped."""

import math
from typing import NamedTuple

import numpy as np

from hierax.nodes.causal_tree.extended_floats import ExtendedFloats, Floats, Inputs, along
from hierax.nodes.causal_tree.plan import Group, Plan

LEAST_INPUT = 2.0**-300  # likelihoods further apart than this are none for float64
FLOOR_LOG2 = -1000.0  # all products stay above 2 to this power: far enough from where float64 loses digits, at 2^-1022


class _Step(NamedTuple):
    """A group, with views of the arrays that it works on."""

    group: Group
    work: Floats
    messages: Floats  # to the tops; shape (top's states, families)
    scales: Floats  # what these have been divided by; shape (families,)
    likelihoods: tuple[Floats, ...]  # likelihoods, supports, beliefs: of each other
    supports: tuple[Floats, ...]
    beliefs: tuple[Floats, ...]
    at_tops: Floats  # the tops' beliefs, family by family, without what the family said


class Float64Sweep:
    """One sweep up and one down, all levels' arrays kept and used again.

    Every message is scaled so that its greatest number is 1, so all factors of all products are at most 1, and no
    intermediate result is smaller than its end: from the least numbers follows whether something can have underflowed.

    By number of states, up to a factor, shape (size, columns), `likelihoods` are L of each variable, from what lies
    further from the root (the prior and the evidence included), `supports` what comes from the root's side, ones at a
    root, and `beliefs` their products; `messages` are of each group what its families told their tops, up to a factor,
    shape (tops' states, families); by `exponents` powers of 2 likelihoods were scaled."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.likelihoods, self.supports, self.beliefs = (
            {size: np.ones_like(base) for size, base in plan.base.items()} for _ in range(3)
        )
        self._scales = np.ones(sum(len(group.tops) for group in plan.groups))
        self._steps = self._make_steps()
        self.messages = [step.messages for step in self._steps]
        self._evidence = {size: np.ones_like(base) for size, base in plan.base.items()}  # at most 1; 0 means 0
        self.exponents = 0
        self._least = 1.0  # likelihood that the evidence has not made 0
        self._least_log2 = math.log2(plan.least) if plan.least > 0 else -math.inf

    def up(self, inputs: Inputs) -> bool:
        """Sweep from the leaves to the roots; whether nothing can have underflowed."""
        self.exponents, plain = 0, True
        for evidence in self._evidence.values():
            evidence.fill(1.0)
        for size, columns, values in inputs:
            self._evidence[size][:, columns] = scaled = values.as_float64(0)
            self.exponents += int(values.greatest(0).sum())
            plain = plain and _is_plain(values, scaled)
        if not plain or self._least_log2 <= FLOOR_LOG2 / 2:  # the tables and priors alone leave no room
            return False
        for size, base in self._plan.base.items():
            np.multiply(base, self._evidence[size], out=self.likelihoods[size])
        with np.errstate(all="ignore"):
            for step in reversed(self._steps):
                self._gather(step)
        found = ((self._evidence[size] > 0, likelihood) for size, likelihood in self.likelihoods.items())
        self._least = float(np.min([np.where(possible, likelihood, 1.0).min() for possible, likelihood in found]))
        return self._suffices(1.0)

    def down(self, at_roots: Inputs) -> bool:
        """Sweep from the roots to the leaves, after `up`; whether nothing can have underflowed."""
        least = 1.0
        with np.errstate(all="ignore"):
            for size, likelihood in self.likelihoods.items():
                np.copyto(self.beliefs[size], likelihood)  # the roots'; the others' follow
            for size, columns, values in at_roots:
                scaled = values.as_float64(0)
                if not _is_plain(values, scaled):
                    return False
                least = min(least, float(np.where(scaled > 0, scaled, 1.0).min()))
                self.beliefs[size][:, columns] *= scaled
            for step in self._steps:
                self._spread(step)
        return self._suffices(least * float(np.min([support.min() for support in self.supports.values()])))

    def _suffices(self, least_support: float) -> bool:
        """Whether nothing can have underflowed. The smallest product in a sweep is of a table's entry, as many
        likelihoods as a family has others, and a support; sums are of numbers of at least 0."""
        if not (self._least > 0 and least_support > 0):  # nor NaN
            return False
        logs = self._plan.others * math.log2(self._least) + math.log2(least_support)
        return self._least_log2 + logs > FLOOR_LOG2

    def log_scale(self) -> float:
        """The natural logarithm of what the messages up have been divided by."""
        return float(np.log(self._scales).sum())

    def _make_steps(self) -> list[_Step]:
        steps = []
        first = 0
        for group in self._plan.groups:
            count = len(group.tops)
            messages, at_tops = np.ones((2, group.top_size, count))
            likelihoods, supports, beliefs = (
                tuple(array[size][:, columns] for size, columns in group.others)
                for array in (self.likelihoods, self.supports, self.beliefs)
            )
            work, scales = np.empty_like(group.table), self._scales[first : first + count]
            steps.append(_Step(group, work, messages, scales, likelihoods, supports, beliefs, at_tops))
            first += count
        return steps

    def _gather(self, step: _Step) -> None:
        """A group's messages to its tops: table times the others' likelihoods, summed over the others' states."""
        group, messages, scales = step.group, step.messages, step.scales
        *rest, last = step.likelihoods
        found = np.add.reduce(np.multiply(group.table, last, out=step.work), axis=-2)
        for likelihood in reversed(rest):
            found = np.add.reduce(found * likelihood, axis=-2)
        np.maximum.reduce(found, axis=0, out=scales)
        np.divide(found, scales, out=messages)
        product = messages if group.order is None else messages.take(group.order, axis=1)
        if group.starts is not None:
            product = np.multiply.reduceat(product, group.starts, axis=1)
        self.likelihoods[group.top_size][:, group.targets] *= product

    def _spread(self, step: _Step) -> None:
        """A group's messages to its others, from its tops' beliefs without what the family itself said."""
        group, table, at_tops = step.group, step.group.table, step.at_tops
        self.beliefs[group.top_size].take(group.tops, axis=1, out=at_tops, mode="clip")
        np.divide(at_tops, step.messages, out=at_tops)
        from_top = np.add.reduce(np.multiply(table, along(at_tops, 0, table.ndim), out=step.work), axis=0)
        others = zip(step.likelihoods, step.supports, step.beliefs, strict=True)
        for other, (likelihood, support, belief) in enumerate(others):
            found = from_top
            for axis in reversed(range(len(step.supports))):
                if axis != other:
                    found = np.add.reduce(found * along(step.likelihoods[axis], axis, found.ndim), axis=axis)
            np.divide(found, np.maximum.reduce(found, axis=0), out=support)
            np.multiply(likelihood, support, out=belief)


def _is_plain(given: ExtendedFloats, scaled: Floats) -> bool:
    """Whether likelihoods are what they are as float64, and leave a state to each variable."""
    possible = given.fraction > 0
    return bool(possible.any(axis=0).all()) and not ((scaled < LEAST_INPUT) & possible).any()
