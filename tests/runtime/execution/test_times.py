"""What a run keeps of its times, and what of that outlives its processes."""

from __future__ import annotations

from mmap import mmap

import numpy as np
import pytest

from hierax.runtime.execution.times import KEPT, TIMES_BYTES, Times


def passed(times: Times, begun_s: float, *took_s: float) -> None:
    """Epochs, one after the other."""
    for each in took_s:
        times.begun(begun_s)
        begun_s += each
        times.ended(begun_s, each)


def test_the_times_of_the_last_epochs_are_kept_and_all_are_counted() -> None:
    times = Times()
    for number in range(KEPT + 3):
        times.took_s.append(float(number))
    assert times.took_s.count == KEPT + 3
    assert times.took_s.last == KEPT + 2
    np.testing.assert_array_equal(times.took_s.numbers(), np.arange(3, KEPT + 3))


def test_another_process_of_the_run_goes_on_where_the_one_before_was() -> None:
    memory = mmap(-1, TIMES_BYTES)
    passed(Times(memory, run=7), 100.0, 1.0, 2.0)
    again = Times(memory, run=7)
    again.begun_late(0.5, 3, 4)
    passed(again, 105.0, 1.0)
    assert again.took_s.numbers().tolist() == [1.0, 2.0, 1.0]
    assert again.wall_s == 6.0, "that nobody was there is part of it"
    third = Times(memory, run=7)
    assert (third.most_late_s, third.skipped, third.late.numbers().tolist()) == (0.5, 4, [3.0])


def test_of_a_run_that_is_resumed_the_pause_is_left_out() -> None:
    memory = mmap(-1, TIMES_BYTES)
    passed(Times(memory, run=7), 100.0, 1.0, 2.0)
    resumed = Times(memory, run=8)
    assert resumed.wall_s == 3.0
    passed(resumed, 5.0, 0.5, 0.25)  # of another boot, a clock begins anew
    assert resumed.wall_s == pytest.approx(3.75)
    passed(Times(memory, run=8), 7.0, 1.0)
    assert Times(memory, run=8).wall_s == pytest.approx(6.0)
