"""A node's budget."""

from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.budget import BUDGET_BYTES, Budget
from hierax.schemas.messages import OBSERVATIONS, Header, Message


@dataclass
class Clock:
    """Nanoseconds that pass when it is told so."""

    now: int = 1000

    def __call__(self) -> int:
        return self.now


def works(budget: Budget, clock: Clock, first: int, *times_ms: tuple[int, int]) -> None:
    """Epochs from a first one on, before each of which the node waits, and then works."""
    for epoch, (waits_ms, works_ms) in enumerate(times_ms, first):
        clock.now += waits_ms * 1_000_000
        budget.received(Message(Header(OBSERVATIONS, "low", "mid", epoch), ()))
        clock.now += works_ms * 1_000_000
        budget.called(Called(epoch, 0, "mid", "observe", None))
        budget.completed(Completed(Step(epoch, 0, 0.0, (), None, (), (), "default", (), None), b"", b""))
        budget.served()


def test_work_counts_and_waiting_does_not() -> None:
    clock = Clock()
    budget = Budget(10.0, None, clock)
    works(budget, clock, 1, (500, 300), (500, 9), (0, 11), (80, 25), (80, 3))
    told = budget.told()
    assert told == {"budget_ms": 10.0, "over": 2, "max_ms": 25.0, "epochs": [3, 4]}, "the first one is not counted"


def test_another_process_goes_on_with_the_counts() -> None:
    clock, memory = Clock(), mmap(-1, BUDGET_BYTES)
    works(Budget(10.0, memory, clock), clock, 1, (0, 0), (0, 30), (0, 11))
    again = Budget(5.0, memory, clock)
    works(again, clock, 4, (0, 300), (0, 6), (0, 4))
    assert again.told() == {"budget_ms": 5.0, "over": 3, "max_ms": 30.0, "epochs": [2, 3, 5]}
