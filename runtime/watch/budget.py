"""A node's budget: in which epochs it has worked for longer than it may."""

from collections import deque

from hierax.runtime.engine.effects import Completed
from hierax.runtime.watch.meter import Clock, Meter
from hierax.schemas.values import Value

TOLD = 1024  # how many epochs, the last ones, are told by their numbers


class Budget(Meter):
    """Counts epochs in which a node was at work, waiting apart, for longer than a number of milliseconds."""

    def __init__(self, budget_ms: float, *clock: Clock) -> None:
        super().__init__(*clock)
        self._budget_ms = budget_ms
        self._spent_ns = 0
        self._count = 0
        self._most_ms = 0.0
        self._broken_in: deque[int] = deque(maxlen=TOLD)

    def completed(self, completed: Completed) -> None:
        super().completed(completed)
        spent_ns = sum(self._work.values())
        took_ms = (spent_ns - self._spent_ns) / 1e6
        self._spent_ns = spent_ns
        if self._epochs > 1 and took_ms > self._budget_ms:  # the first one begins before there is anything to do
            self._count += 1
            self._most_ms = max(self._most_ms, took_ms)
            self._broken_in.append(completed.step.epoch)

    def told(self) -> dict[str, Value]:
        """The budget, how many epochs took longer, the longest of them, and which they were."""
        return {
            "budget_ms": self._budget_ms,
            "over": self._count,
            "max_ms": self._most_ms,
            "epochs": list(self._broken_in),
        }
