"""Numbers with exponents of their own: against exact fractions, far beyond what float64 holds."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from hierax.nodes.causal_tree.extended_floats import CHUNK, ExtendedFloats, extended, ones


def drawn(seed: int, *shape: int) -> ExtendedFloats:
    rng = np.random.default_rng(seed)
    fraction = rng.uniform(0.5, 1.0, shape) * (rng.random(shape) > 0.2)
    return ExtendedFloats(fraction, np.where(fraction > 0, rng.integers(-5000, 5000, shape), 0))


def exact(values: ExtendedFloats) -> np.ndarray:
    pairs = zip(values.fraction.ravel(), values.exponent.ravel(), strict=True)
    return np.array([Fraction(float(f)) * Fraction(2) ** int(e) for f, e in pairs], object).reshape(
        values.fraction.shape
    )


def assert_equal(found: ExtendedFloats, wanted: np.ndarray, relative: float = 1e-15) -> None:
    assert ((found.fraction == 0) | ((found.fraction >= 0.5) & (found.fraction < 1))).all()
    for value, right in zip(exact(found).ravel(), np.asarray(wanted, object).ravel(), strict=True):
        assert value == right if right == 0 else abs(value / right - 1) < relative, (value, right)


@pytest.mark.parametrize("seed", range(5))
def test_arithmetic(seed: int) -> None:
    one, other = drawn(seed, 3, 7), drawn(seed + 100, 3, 7)
    assert_equal(one.times(other), exact(one) * exact(other))
    nonzero = ExtendedFloats(np.where(other.fraction > 0, other.fraction, 0.5), other.exponent)
    assert_equal(one.over(nonzero), exact(one) / exact(nonzero))
    assert_equal(one.total(0), exact(one).sum(axis=0))
    assert_equal(one.total(1), exact(one).sum(axis=1))


def test_what_is_extended_is_the_same() -> None:
    values = np.array([0.0, 1.0, 0.1, 5e-324, 1.7e308])
    assert exact(extended(values)).tolist() == [Fraction(float(value)) for value in values]
    assert exact(ones(2)).tolist() == [1, 1]


def test_a_sum_is_0_only_of_zeros() -> None:
    values = ExtendedFloats(np.array([[0.0, 0.5], [0.0, 0.0]]), np.array([[0, -100000], [0, 0]]))
    found = values.total(0)
    assert found.fraction.tolist() == [0.0, 0.5]
    assert found.exponent.tolist() == [0, -100000]


@pytest.mark.parametrize("lengths", [[1, 1, 1], [3, 1, 2], [CHUNK, CHUNK + 1, 1], [3 * CHUNK + 7], [1, CHUNK**2 + 5]])
def test_products_of_neighbours(lengths: list[int]) -> None:
    rng = np.random.default_rng(len(lengths))
    values = extended(rng.uniform(0.4, 1.1, (2, sum(lengths))))
    starts = np.cumsum([0, *lengths[:-1]])
    found = values.products(starts)
    logs = np.add.reduceat(np.log(values.fraction) + values.exponent * np.log(2.0), starts, axis=1)
    np.testing.assert_allclose(np.log(found.fraction) + found.exponent * np.log(2.0), logs, rtol=1e-10)


def test_narrow_keeps_what_counts() -> None:
    values = ExtendedFloats(np.array([0.5, 0.75, 0.5, 0.0]), np.array([-9000, -8999, -99000, 0]))
    assert values.greatest(0) == -8999
    assert values.as_float64(0).tolist() == [0.25, 0.75, 0.0, 0.0]
    assert values.shifted(0).exponent.tolist() == [-1, 0, -90001, 0]
