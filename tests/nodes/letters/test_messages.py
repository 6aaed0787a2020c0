"""Products of messages: exact on plain numbers, sound where they would underflow."""

from __future__ import annotations

import random
from fractions import Fraction

import pytest

from hierax.nodes.letters.tree import TINY, ImpossibleEvidenceError, normalised, product, uniform, weights

NAMES = ("a", "b", "c")


def test_plain_numbers_come_out_as_they_went_in() -> None:
    assert weights(("a", "b"), [0.2, 0.8], "w") == {"a": 0.2, "b": 0.8}
    assert product(("a", "b"), [{"a": 1.0, "b": 3.0}], "p") == {"a": 0.25, "b": 0.75}
    assert uniform(("a", "b")) == {"a": 0.5, "b": 0.5}


def test_the_product_of_nothing_is_uniform() -> None:
    assert product(("a", "b"), [], "p") == uniform(("a", "b"))


@pytest.mark.parametrize("seed", range(50))
def test_products_agree_with_exact_fractions(seed: int) -> None:
    rng = random.Random(seed)
    factors = [{name: 10.0 ** rng.uniform(-250, 0) for name in NAMES} for _ in range(rng.randint(1, 200))]
    exact = {name: Fraction(1) for name in NAMES}
    for factor in factors:
        exact = {name: exact[name] * Fraction(factor[name]) for name in NAMES}
    found = product(NAMES, factors, "p")
    for name in NAMES:
        assert found[name] == pytest.approx(float(exact[name] / sum(exact.values())), rel=1e-12, abs=2 * TINY), seed


def test_what_would_underflow_is_not_ruled_out() -> None:
    small = {"a": 1.0, "b": 1e-200, "c": 0.0}
    found = product(NAMES, [small, small], "p")
    assert found["a"] == 1.0
    assert 0.0 < found["b"] < 1e-300
    assert found["c"] == 0.0
    assert normalised({"a": 1e300, "b": 1e-300}, "n") == {"a": 1.0, "b": TINY}


def test_numbers_at_the_ends_of_the_range_do_not_overflow() -> None:
    assert weights(("a", "b"), [1.5e308, 1.5e308], "w") == {"a": 0.5, "b": 0.5}
    assert weights(("a", "b"), [5e-324, 5e-324], "w") == {"a": 0.5, "b": 0.5}


def test_nothing_left_is_an_error_that_says_of_what() -> None:
    with pytest.raises(ImpossibleEvidenceError, match="letters: the evidence is impossible, nothing is left of a, b"):
        product(("a", "b"), [{"a": 1.0, "b": 0.0}, {"a": 0.0, "b": 1.0}], "letters")
    with pytest.raises(ImpossibleEvidenceError, match="sum"):
        normalised({"a": 0.0}, "sum")
