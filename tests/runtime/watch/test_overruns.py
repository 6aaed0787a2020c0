"""What is counted where a node is waited for."""

from __future__ import annotations

from mmap import mmap
from types import SimpleNamespace
from typing import Any

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.watch.overruns import MOST_UPPERS, OVERRUNS_BYTES, Overruns
from hierax.schemas.limits import MAX_NAME_CHARS
from hierax.schemas.rates import Rates

PAIRS = (("world", "low"), ("low", "up"))


class Waiting:
    """A node `low` that waits as it is told to."""

    def __init__(self, memory: mmap, comes_back: bool = False, delayed: bool = False) -> None:
        rates = Rates(delays={("world", "low"): 3} if delayed else {}, pairs=PAIRS)
        engine: Any = RatedEngine.__new__(RatedEngine)
        engine.name, engine.overruns = "low", {}
        engine.wiring = SimpleNamespace(place=SimpleNamespace(rates=rates))
        self.engine, self.now_ns = engine, 0
        self.overruns = Overruns(lambda: engine, comes_back, 10.0, memory, lambda: self.now_ns)

    def does(self, epoch: int, waits_ms: int, *uppers: str) -> None:
        for upper in uppers:
            self.engine.overruns[upper] = self.engine.overruns.get(upper, 0) + 1
        self.overruns.served()
        self.now_ns += waits_ms * 1_000_000
        self.overruns.served()
        self.overruns.completed(Completed(Step(epoch, 0, 0.0, (), None, (), (), "default", (), None), b"", b""))

    def told(self) -> Any:
        return self.overruns.told()


def test_all_are_counted_and_the_epochs_of_long_ones_are_kept() -> None:
    low = Waiting(mmap(-1, OVERRUNS_BYTES))
    low.does(3, 30)
    low.does(4, 30, "up")
    low.does(5, 2, "up")
    low.does(6, 11, "up", "more")
    assert low.told() == {"up": {"count": 3, "epochs": [4, 6]}, "more": {"count": 1, "epochs": [6]}}


def test_nobody_else_waits_where_the_node_below_has_a_delay() -> None:
    low = Waiting(mmap(-1, OVERRUNS_BYTES), delayed=True)
    low.does(4, 30, "up")
    assert low.told() == {"up": {"count": 1, "epochs": []}}


def test_another_process_goes_on_with_the_counts_but_for_its_first_turn() -> None:
    memory = mmap(-1, OVERRUNS_BYTES)
    Waiting(memory).does(4, 30, "up")
    again = Waiting(memory, comes_back=True)
    again.does(5, 30, "up")
    assert again.told() == {"up": {"count": 1, "epochs": [4]}}, "it may have been told in time, and is told again"
    again.does(6, 30, "up")
    assert again.told() == {"up": {"count": 2, "epochs": [4, 6]}}


def test_of_more_nodes_than_there_is_room_for_the_first_ones_are_counted() -> None:
    low = Waiting(mmap(-1, OVERRUNS_BYTES))
    names = [f"{number:x}".rjust(MAX_NAME_CHARS, "n") for number in range(MOST_UPPERS + 1)]
    for epoch, name in enumerate(names):
        low.does(epoch, 0, name)
    assert list(low.told()) == names[:-1]
