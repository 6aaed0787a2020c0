"""Numbers of at least 0 whose exponents cannot run out: products of thousands of small ones stay what they are.

An array of them is a pair (fraction, exponent): fraction · 2^exponent, the fraction 0 or from 0.5 to below 1, the
exponent a whole number of 64 bits. Products and sums have the relative error of float64, and 0 means 0 exactly: what
would underflow does not. So impossible and improbable are told apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Exponents = NDArray[np.int64]
Places = NDArray[np.intp]

# Stands for the exponent of 0 where the greatest is looked for; sums of true exponents stay far from it.
NONE = -(1 << 60)

VANISHING = -1100  # below this exponent, 2^exponent is nothing beside 1
CHUNK = 512  # so many fractions can be multiplied before their product underflows


class Wide(NamedTuple):
    """fraction · 2^exponent, element by element."""

    fraction: Floats
    exponent: Exponents


def widen(values: Floats) -> Wide:
    """Ordinary numbers, exactly."""
    fraction, exponent = np.frexp(values)
    return Wide(fraction, exponent.astype(np.int64))


def ones(*shape: int) -> Wide:
    """All 1."""
    return Wide(np.full(shape, 0.5), np.ones(shape, np.int64))


def multiply(one: Wide, other: Wide) -> Wide:
    """The element-wise product."""
    return _settled(one.fraction * other.fraction, one.exponent + other.exponent)


def divide(one: Wide, other: Wide) -> Wide:
    """The element-wise quotient; the divisor has no 0."""
    return _settled(one.fraction / other.fraction, one.exponent - other.exponent)


def total(values: Wide, axis: int) -> Wide:
    """The sum along an axis."""
    top = greatest(values, axis)
    shift = np.maximum(values.exponent - np.expand_dims(top, axis), VANISHING)
    return _settled(np.add.reduce(np.ldexp(values.fraction, shift), axis=axis), top)


def greatest(values: Wide, axis: int) -> Exponents:
    """The greatest exponent along an axis; 0 where all is 0."""
    top: Exponents = np.maximum.reduce(np.where(values.fraction > 0, values.exponent, NONE), axis=axis)
    return np.where(top == NONE, 0, top)


def narrow(values: Wide, axis: int) -> Floats:
    """As float64, scaled by a power of 2 so that the greatest along the axis is from 0.5 to below 1.

    What is smaller by more than float64 can hold becomes 0.
    """
    shift = np.maximum(values.exponent - np.expand_dims(greatest(values, axis), axis), VANISHING)
    return np.ldexp(values.fraction, shift)


def shifted(values: Wide, axis: int) -> Wide:
    """The same up to a factor: the greatest along the axis from 0.5 to below 1."""
    exponent = values.exponent - np.expand_dims(greatest(values, axis), axis)
    return Wide(values.fraction, np.where(values.fraction > 0, exponent, 0))


def products(values: Wide, starts: Places) -> Wide:
    """The products of neighbours along the last axis.

    Args:
        values: shape (…, n).
        starts: where each product begins; it ends where the next begins. None is empty.

    Returns:
        Shape (…, len(starts)).
    """
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


def _settled(fraction: Floats, exponent: Exponents) -> Wide:
    """With the fractions brought back to where they belong."""
    settled, shift = np.frexp(fraction)
    return Wide(settled, exponent + shift)
