"""When a world with a rate begins its epochs, and what is told of those that are late."""

from __future__ import annotations

import pytest

from hierax.runtime.deployment.deployment import Late
from hierax.runtime.execution.pace import Pace
from hierax.runtime.execution.timing import culprits, lines_of, timing_of


class Epochs:
    """Epochs of a world at 10 Hz, under a clock that passes as they do."""

    def __init__(self, late: Late = "catch_up") -> None:
        self.now = 100.0
        self.pace = Pace(10.0, late, clock=lambda: self.now)
        self.number = 0
        self.notes: list[str] = []
        for _ in range(2):  # the first two are not on time, whatever they take
            self.pace.begin(0)
            self.pace.ended()

    def does(self, took_s: float) -> float:
        """One that takes so long, begun when it is due; gives when it began, from the first one's beginning on."""
        self.now += max(self.pace.wait_s(), 0.0)
        self.number += 1
        began_s = self.now - 100.0
        note = self.pace.begin(self.number)
        if note:
            self.notes.append(note)
        self.now += took_s
        self.pace.ended()
        return began_s


def test_epochs_begin_where_the_rate_has_them_and_no_error_adds_up() -> None:
    epochs = Epochs()
    begun = [epochs.does(0.03 + 0.001 * (number % 7)) for number in range(10_000)]
    assert begun == pytest.approx([0.1 * number for number in range(10_000)], abs=1e-6)
    told = epochs.pace.told()
    assert (told["late"], told["skipped"], told["epochs"]) == (0, 0, [])
    assert told["max_ms"] == pytest.approx(0.0, abs=1e-6)


def test_the_first_two_take_as_long_as_they_take_and_times_are_counted_from_the_third_one() -> None:
    now = 0.0
    pace = Pace(10.0, "catch_up", clock=lambda: now)
    for epoch, took_s in enumerate((3.0, 0.7, 0.02), start=1):
        assert pace.wait_s() <= 0.0
        assert pace.begin(epoch) == ""
        now += took_s
        pace.ended()
    assert pace.wait_s() == pytest.approx(0.08)
    assert (pace.told()["late"], pace.told()["max_ms"]) == (0, 0.0)


def test_epochs_that_are_overdue_begin_at_once() -> None:
    epochs = Epochs("catch_up")
    begun = [epochs.does(took_s) for took_s in (0.35, 0.02, 0.02, 0.02, 0.02, 0.02)]
    assert begun == pytest.approx([0.0, 0.35, 0.37, 0.39, 0.41, 0.5])
    told = epochs.pace.told()
    assert (told["late"], told["skipped"], told["epochs"]) == (4, 0, [2, 3, 4, 5])
    assert told["max_ms"] == pytest.approx(250.0)
    assert epochs.notes[0] == "epoch 2 begins 250.0 ms late, as the one before was not done (1 so far)"
    assert len(epochs.notes) == 3, "the first, the second and the fourth"


def test_times_that_have_passed_are_skipped() -> None:
    epochs = Epochs("skip")
    begun = [epochs.does(took_s) for took_s in (0.35, 0.02, 0.02, 0.02)]
    assert begun == pytest.approx([0.0, 0.35, 0.4, 0.5])
    told = epochs.pace.told()
    assert (told["late"], told["skipped"], told["epochs"]) == (1, 2, [2])


@pytest.mark.parametrize(
    ("late", "then"),
    [("catch_up", "20 epochs late, which follow at once"), ("skip", "20 epochs late, which are left out")],
)
def test_many_that_are_late_at_once_have_a_line_of_their_own(late: Late, then: str) -> None:
    epochs = Epochs(late)
    for took_s in (0.15, 0.15, *[0.01] * 5, 2.03, *[0.001] * 40, 2.03, 0.01):
        epochs.does(took_s)
    told = [note for note in epochs.notes if "epochs late" in note]
    assert told[0].startswith("epoch 9 begins 1930.0 ms late: " + then), epochs.notes
    assert len(told) == 2, "each time"


def test_late_epochs_are_put_down_to_those_that_took_too_long() -> None:
    late = [11, 12, 13, 21, 40]
    over = {"slow": [10, 30], "quick": [20], "other": [20, 38]}
    assert culprits(late, over) == {"slow": 3, "quick": 1, "other": 1}


def test_who_took_longer_than_a_delay_is_named_where_it_was_waited_for() -> None:
    epochs = Epochs()
    for took_s in (0.02, 0.02, 0.15, *[0.02] * 5):
        epochs.does(took_s)
    budget = {"budget_ms": 500.0, "over": 2, "max_ms": 700.0, "epochs": []}
    overruns = {"slow": {"count": 2, "epochs": [3]}}
    told = {"world": {"pace": epochs.pace.told(), "overruns": overruns}, "slow": {"budget": budget}}
    timing = timing_of(told)
    assert timing["rate"]["after"] == {"slow": 1}
    assert timing["overruns"] == {"slow": {"world": 2}}
    assert lines_of(timing) == [
        "every 100 ms: 1 epoch begun late (after slow 1); lateness p50 0.00 ms, p99 46.50 ms, max 50.00 ms",
        "slow: a budget of 500 ms; 2 epochs took longer, the longest 700.0 ms",
        "slow: longer than its delays; epochs in which it was waited for: world 2",
    ]


def test_what_is_told_of_a_launch() -> None:
    epochs = Epochs()
    for took_s in (0.02, 0.35, 0.02, 0.02, 0.02, 0.02):
        epochs.does(took_s)
    budget = {"budget_ms": 100.0, "over": 1, "max_ms": 340.0, "epochs": [2]}
    kept = {"budget_ms": 5.0, "over": 0, "max_ms": 0.0, "epochs": []}
    timing = timing_of({"world": {"pace": epochs.pace.told(), "budget": kept}, "slow": {"budget": budget}, "free": {}})
    assert timing["rate"]["after"] == {"slow": 4}
    assert lines_of(timing) == [
        "every 100 ms: 4 epochs begun late (after slow 4); lateness p50 50.00 ms, p99 246.00 ms, max 250.00 ms",
        "slow: a budget of 100 ms; 1 epoch took longer, the longest 340.0 ms",
    ]
    assert timing_of({"free": {}}) is None
    assert lines_of(None) == []
