"""A node's budget: in which epochs it has worked for longer than it may."""

from mmap import mmap

from hierax.runtime.engine.effects import Completed
from hierax.runtime.watch.kept import TOLD, Cells, Kept
from hierax.runtime.watch.meter import Clock, Meter
from hierax.schemas.values import Value

_MOST_MS, _OVER = range(2)
_NUMBERS = 2

BUDGET_BYTES = 8 * (_NUMBERS + TOLD)


class Budget(Meter):
    """Counts epochs in which a node was at work, waiting apart, for longer than a number of milliseconds.

    Args: memory: of `BUDGET_BYTES`, zeros at first, in which the counts outlive the process; None: they do not.
    """

    def __init__(self, budget_ms: float, memory: mmap | None = None, *clock: Clock) -> None:
        super().__init__(*clock)
        self._budget_ms = budget_ms
        self._spent_ns = 0
        self._cells: Cells = memoryview(bytearray(BUDGET_BYTES) if memory is None else memory).cast("d")
        self._broken_in = Kept(self._cells, _OVER, _NUMBERS, TOLD)

    def completed(self, completed: Completed) -> None:
        super().completed(completed)
        spent_ns = sum(self._work.values())
        took_ms = (spent_ns - self._spent_ns) / 1e6
        self._spent_ns = spent_ns
        if self._epochs > 1 and took_ms > self._budget_ms:  # the first one begins before there is anything to do
            self._cells[_MOST_MS] = max(self._cells[_MOST_MS], took_ms)
            self._broken_in.append(completed.step.epoch)

    def told(self) -> dict[str, Value]:
        """The budget, how many epochs took longer, the longest of them, and which they were."""
        return {
            "budget_ms": self._budget_ms,
            "over": self._broken_in.count,
            "max_ms": float(self._cells[_MOST_MS]),
            "epochs": self._broken_in.numbers().astype(int).tolist(),
        }
