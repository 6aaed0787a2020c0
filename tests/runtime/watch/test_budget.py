"""A node's budget."""

from __future__ import annotations

from dataclasses import dataclass

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.budget import Budget
from hierax.schemas.messages import OBSERVATIONS, Header, Message


@dataclass
class Clock:
    """Nanoseconds that pass when it is told so."""

    now: int = 1000

    def __call__(self) -> int:
        return self.now


def test_work_counts_and_waiting_does_not() -> None:
    clock = Clock()
    budget = Budget(10.0, clock)
    for epoch, (waits_ms, works_ms) in enumerate([(500, 300), (500, 9), (0, 11), (80, 25), (80, 3)], 1):
        clock.now += waits_ms * 1_000_000
        budget.received(Message(Header(OBSERVATIONS, "low", "mid", epoch), ()))
        clock.now += works_ms * 1_000_000
        budget.called(Called(epoch, 0, "mid", "observe", None))
        budget.completed(Completed(Step(epoch, 0, 0.0, (), None, (), (), "default", (), None), b"", b""))
        budget.served()
    told = budget.told()
    assert told == {"budget_ms": 10.0, "over": 2, "max_ms": 25.0, "epochs": [3, 4]}, "the first one is not counted"
