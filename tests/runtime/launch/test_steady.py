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
