"""The clock that does not count against others what one was stopped for oneself."""

from __future__ import annotations

import pytest

from hierax.runtime.execution.pacemaker import GAP_S, SteadyClock


@pytest.mark.parametrize(
    ("steps", "counted"), [([0.1] * 20, 2.0), ([0.1, 3.0, 0.1], 0.2), ([GAP_S, 60.0, GAP_S], 2 * GAP_S)]
)
def test_a_gap_in_which_nobody_looked_is_left_out(steps: list[float], counted: float) -> None:
    now = 100.0
    clock = SteadyClock(lambda: now)
    began = clock()
    for step in steps:
        now += step
        clock()
    assert clock() - began == pytest.approx(counted)


def test_of_ones_own_work_some_counts_however_long_each_piece_of_it_takes() -> None:
    """Else what nobody answers would be waited for as long as a world is at work in each of its epochs."""
    now = 100.0
    clock = SteadyClock(lambda: now, counted_s=GAP_S)
    began = clock()
    for _ in range(20):
        now += 3 * GAP_S
        clock()
    assert clock() - began == pytest.approx(20 * GAP_S)
