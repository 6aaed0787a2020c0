"""A node's budget."""

from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap
from types import SimpleNamespace
from typing import Any

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.budget import BUDGET_BYTES, Budget
from hierax.schemas.messages import OBSERVATIONS, Header, Message
from hierax.schemas.rates import Rates, Turns


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


def engine(rates: Rates | None, name: str = "mid") -> Any:
    """One that has these rates, as far as a budget asks."""
    wiring = SimpleNamespace(place=SimpleNamespace(rates=rates))
    return SimpleNamespace(name=name, is_world=name == "world", wiring=wiring)


def test_work_counts_and_waiting_does_not() -> None:
    clock = Clock()
    budget = Budget(10.0, None, lambda: None, None, clock)
    works(budget, clock, 1, (500, 300), (500, 300), (0, 11), (80, 25), (80, 3))
    told = budget.told()
    assert told == {"budget_ms": 10.0, "over": 2, "max_ms": 25.0, "epochs": [3, 4]}, "the first two are not counted"


def test_another_process_goes_on_with_the_counts() -> None:
    clock, memory = Clock(), mmap(-1, BUDGET_BYTES)
    works(Budget(10.0, None, lambda: None, memory, clock), clock, 1, (0, 0), (0, 30), (0, 30), (0, 11))
    again = Budget(5.0, None, lambda: None, memory, clock)
    works(again, clock, 5, (0, 40), (0, 6), (0, 4))
    assert again.told() == {"budget_ms": 5.0, "over": 4, "max_ms": 40.0, "epochs": [3, 4, 5, 6]}


def test_what_a_world_that_comes_back_waits_for_at_first_is_no_work() -> None:
    clock = Clock()
    budget = Budget(10.0, None, lambda: engine(None, "world"), None, clock)
    works(budget, clock, 7, (0, 300), (0, 11))
    assert budget.told()["epochs"] == [8]


def test_by_itself_it_is_what_the_rates_leave_a_node() -> None:
    """A node that takes part now and then is counted in its very first turn."""
    rates = Rates({"mid": Turns(60)}, {("low", "mid"): 40}, pairs=(("world", "low"), ("low", "mid")))
    clock = Clock()
    budget = Budget(None, 10.0, lambda: engine(rates), None, clock)
    works(budget, clock, 60, (0, 410))
    works(budget, clock, 120, (0, 390))
    assert budget.told() == {"budget_ms": 400.0, "over": 1, "max_ms": 410.0, "epochs": []}, "nobody waited in epoch 60"
    assert Budget(None, 10.0, lambda: engine(None)).budget_ms == 10.0
    assert Budget(300.0, 10.0, lambda: engine(rates)).budget_ms == 300.0
