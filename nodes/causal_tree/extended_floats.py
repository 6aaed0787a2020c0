"""Numbers of at least 0 whose exponents cannot run out: products of thousands of small ones stay what they are.

An array of them is a pair (fraction, exponent): fraction · 2^exponent, the fraction 0 or from 0.5 to below 1, the
exponent a whole number of 64 bits. Products and sums have the relative error of float64, and 0 means 0 exactly: what
would underflow does not. So impossible and improbable are told apart.
"""

from __future__ import annotations

from collections.abc import Mapping
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

    def at(self, columns: int | slice | Places | None) -> ExtendedFloats:
        """Some columns; None: the one that there is, as a column."""
        return ExtendedFloats(self.fraction[:, columns], self.exponent[:, columns])


# By number of states: columns, once each, and the likelihoods there; shape (size, columns).
Inputs = Mapping[int, tuple[Places, ExtendedFloats]]


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


def multiply(one: ExtendedFloats, other: ExtendedFloats) -> ExtendedFloats:
    """The element-wise product."""
    return _settled(one.fraction * other.fraction, one.exponent + other.exponent)


def divide(one: ExtendedFloats, other: ExtendedFloats) -> ExtendedFloats:
    """The element-wise quotient; the divisor has no 0."""
    return _settled(one.fraction / other.fraction, one.exponent - other.exponent)


def total(values: ExtendedFloats, axis: int) -> ExtendedFloats:
    """The sum along an axis."""
    top = greatest(values, axis)
    shift = np.maximum(values.exponent - np.expand_dims(top, axis), VANISHING)
    return _settled(np.add.reduce(np.ldexp(values.fraction, shift), axis=axis), top)


def greatest(values: ExtendedFloats, axis: int) -> Exponents:
    """The greatest exponent along an axis; 0 where all is 0."""
    top: Exponents = np.maximum.reduce(np.where(values.fraction > 0, values.exponent, NONE), axis=axis)
    return np.where(top == NONE, 0, top)


def as_float64(values: ExtendedFloats, axis: int) -> Floats:
    """The numbers as float64, scaled by a power of 2 so that the greatest along the axis is from 0.5 to below 1. What
    is smaller by more than float64 can hold becomes 0."""
    shift = np.maximum(values.exponent - np.expand_dims(greatest(values, axis), axis), VANISHING)
    return np.ldexp(values.fraction, shift)


def shifted(values: ExtendedFloats, axis: int) -> ExtendedFloats:
    """The same up to a factor: the greatest along the axis from 0.5 to below 1."""
    exponent = values.exponent - np.expand_dims(greatest(values, axis), axis)
    return ExtendedFloats(values.fraction, np.where(values.fraction > 0, exponent, 0))


def products(values: ExtendedFloats, starts: Places) -> ExtendedFloats:
    """The products of neighbours along the last axis (…, n), each from one of `starts` to the next; none is empty."""
    size = values.fraction.shape[-1]
    while len(starts) < size:
        ends = np.append(starts[1:], size)
        lengths = ends - starts
        parts = -(-lengths // CHUNK)  # no more than CHUNK factors at a time
        first = np.cumsum(parts) - parts
        chunks = np.repeat(starts - CHUNK * first, parts) + CHUNK * np.arange(parts.sum())
        values = _settled(
            np.multiply.reduceat(values.fraction, chunks, axis=-1), np.add.reduceat(values.exponent, chunks, axis=-1)
        )
        starts, size = first, len(chunks)
    return values


def _settled(fraction: Floats, exponent: Exponents) -> ExtendedFloats:
    """The same numbers, with fractions that are 0 or from 0.5 to below 1."""
    settled, shift = np.frexp(fraction)
    return ExtendedFloats(settled, exponent + shift)
