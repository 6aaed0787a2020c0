"""Numbers of at least 0 whose exponents cannot run out: products of thousands of small ones stay what they are.

An array of them is a pair (fraction, exponent): fraction · 2^exponent, the fraction 0 or from 0.5 to below 1, the
exponent a whole number of 64 bits. Products and sums have the relative error of float64, and 0 means 0 exactly: what
would underflow does not. So impossible and improbable are told apart."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Exponents = NDArray[np.int64]
Places = NDArray[np.intp]
N = TypeVar("N", np.float64, np.int64)

# Stands for the exponent of 0 where the greatest is looked for; sums of true exponents stay far from it.
NONE = -(1 << 60)

VANISHING = -1100  # below this exponent, 2^exponent is nothing beside 1
CHUNK = 512  # so many fractions can be multiplied before their product underflows


class ExtendedFloats(NamedTuple):
    """fraction · 2^exponent, element by element."""

    fraction: Floats
    exponent: Exponents

    def at(self, columns: int | slice | Places | None) -> "ExtendedFloats":
        """Some columns; None: the one that there is, as a column."""
        return ExtendedFloats(self.fraction[:, columns], self.exponent[:, columns])

    def put(self, columns: int | slice | Places, values: "ExtendedFloats") -> None:
        """Set some columns, in place."""
        self.fraction[:, columns], self.exponent[:, columns] = values

    def along(self, axis: int, ndim: int) -> "ExtendedFloats":
        return ExtendedFloats(along(self.fraction, axis, ndim), along(self.exponent, axis, ndim))

    def times(self, other: "ExtendedFloats") -> "ExtendedFloats":
        """The element-wise product."""
        return _settled(self.fraction * other.fraction, self.exponent + other.exponent)

    def over(self, other: "ExtendedFloats") -> "ExtendedFloats":
        """The element-wise quotient; the divisor has no 0."""
        return _settled(self.fraction / other.fraction, self.exponent - other.exponent)

    def total(self, axis: int) -> "ExtendedFloats":
        """The sum along an axis."""
        top = self.greatest(axis)
        shift = np.maximum(self.exponent - np.expand_dims(top, axis), VANISHING)
        return _settled(np.add.reduce(np.ldexp(self.fraction, shift), axis=axis), top)

    def greatest(self, axis: int) -> Exponents:
        """The greatest exponent along an axis; 0 where all is 0."""
        top: Exponents = np.maximum.reduce(np.where(self.fraction > 0, self.exponent, NONE), axis=axis)
        return np.where(top == NONE, 0, top)

    def as_float64(self, axis: int) -> Floats:
        """The numbers as float64, scaled by a power of 2 so that the greatest along the axis is from 0.5 to below 1.
        What is smaller by more than float64 can hold becomes 0."""
        shift = np.maximum(self.exponent - np.expand_dims(self.greatest(axis), axis), VANISHING)
        return np.ldexp(self.fraction, shift)

    def shifted(self, axis: int) -> "ExtendedFloats":
        """The same up to a factor: the greatest along the axis from 0.5 to below 1."""
        exponent = self.exponent - np.expand_dims(self.greatest(axis), axis)
        return ExtendedFloats(self.fraction, np.where(self.fraction > 0, exponent, 0))

    def products(self, starts: Places) -> "ExtendedFloats":
        """The products of neighbours along the last axis (…, n), each from one of `starts` to the next; none is
        empty."""
        values, size = self, self.fraction.shape[-1]
        while len(starts) < size:
            lengths = np.diff(starts, append=size)
            parts = -(-lengths // CHUNK)  # no more than CHUNK factors at a time
            first = np.cumsum(parts) - parts
            chunks = np.repeat(starts - CHUNK * first, parts) + CHUNK * np.arange(parts.sum())
            fractions = np.multiply.reduceat(values.fraction, chunks, axis=-1)
            values = _settled(fractions, np.add.reduceat(values.exponent, chunks, axis=-1))
            starts, size = first, len(chunks)
        return values


# Blocks: a number of states, columns, once each in all of them, and the likelihoods there, shape (size, columns).
Inputs = Sequence[tuple[int, Places, ExtendedFloats]]


def along(array: NDArray[N], axis: int, ndim: int) -> NDArray[N]:
    """An array of shape (states, n) with `ndim` axes: the states along `axis`, n along the last."""
    return array.reshape(*(1,) * axis, array.shape[0], *(1,) * (ndim - 2 - axis), array.shape[1])


def extended(values: Floats) -> ExtendedFloats:
    """Ordinary numbers, exactly."""
    fraction, exponent = np.frexp(values)
    return ExtendedFloats(fraction, exponent.astype(np.int64))


def ones(*shape: int) -> ExtendedFloats:
    """An array that is 1 everywhere."""
    return ExtendedFloats(np.full(shape, 0.5), np.ones(shape, np.int64))


def _settled(fraction: Floats, exponent: Exponents) -> ExtendedFloats:
    """The same numbers, with fractions that are 0 or from 0.5 to below 1."""
    settled, shift = np.frexp(fraction)
    return ExtendedFloats(settled, exponent + shift)
