"""Random numbers of a tick: the same when done again, others for every other call."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hierax.runtime.core.node import NO_TICK, Tick

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
