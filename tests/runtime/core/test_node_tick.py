"""Random numbers of a tick: the same when done again, others for every other call."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.node import NO_TICK, Node, Tick

TICK = Tick(seed=3, subject="arm", operator="observe", epoch=5, time_s=0.2, below=("world",), above=("spatial",))


def drawn(tick: Tick) -> list[float]:
    return replace(tick).rng.random(4).tolist()  # a copy begins its numbers anew


def test_done_again_the_same_numbers() -> None:
    assert drawn(TICK) == drawn(TICK)
    again = Tick(3, "arm", "observe", 5)
    assert drawn(again) == drawn(TICK)


@pytest.mark.parametrize(
    "other",
    [
        replace(TICK, seed=4),
        replace(TICK, seed=-3),
        replace(TICK, subject="spatial"),
        replace(TICK, subject="arm->spatial"),
        replace(TICK, operator="predict"),
        replace(TICK, operator="policy observe"),
        replace(TICK, epoch=6),
    ],
)
def test_another_call_other_numbers(other: Tick) -> None:
    assert drawn(other) != drawn(TICK)


def test_within_a_call_the_numbers_go_on() -> None:
    tick = replace(TICK)
    assert [tick.rng.random(), tick.rng.random()] == drawn(TICK)[:2]


def test_the_numbers_stay_what_they_are() -> None:
    assert drawn(NO_TICK) == [0.015054094715719835, 0.40163247244225453, 0.7840441802203687, 0.01690397020680423]
    assert isinstance(NO_TICK.rng, np.random.Generator)


class Painter(Node):
    """Keeps what it returns, and writes into it when it is told to."""

    def __init__(self) -> None:
        self.pictures: list[np.ndarray[Any, Any]] = []

    def initial_belief(self) -> Value:
        return {}

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        for again in self.pictures if observations else ():
            again[0] = 1.0
        self.pictures.append(tick.empty((2, 3)))
        self.pictures[-1][:] = 5.0
        return {"picture": self.pictures[-1]}


def test_memory_that_was_asked_for_is_frozen_when_the_operator_returns() -> None:
    """Wherever it comes from: who reads it in place is not to find something else there later."""
    memory = np.zeros(100)
    places = (np.empty, lambda shape, dtype: memory[:6].reshape(shape))
    for allocate in places:
        node = Painter()
        bound = BoundNode("low", node, (), (), OperatorSetting(allocate=allocate))
        picture = bound.observe(1, 0.0, (), {})["picture"]
        assert (picture.shape, picture.dtype, picture.flags.writeable) == ((2, 3), np.float64, False)
        assert picture.tolist() == [[5.0] * 3] * 2
        with pytest.raises(OperatorError, match=r"read-only .*; it writes into an array that is not its own"):
            bound.observe(2, 0.1, ({},), {})
