"""A node's budget: in which epochs it has worked for longer than it may."""

from collections.abc import Callable
from mmap import mmap

from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.engine import Engine
from hierax.runtime.watch.kept import TOLD, Cells, Kept
from hierax.runtime.watch.meter import Clock, Meter
from hierax.schemas.values import Value

_MOST_MS, _AWAITED = range(2)
_EPOCHS = 2
_OVER = _EPOCHS + TOLD
_MADE_READY = 2  # in so many epochs of a run all is made ready, for as long as that takes

BUDGET_BYTES = 8 * (_OVER + 1)


class Budget(Meter):
    """Counts epochs in which a node was at work, waiting apart, for longer than a number of milliseconds.

    Args:
        budget_ms: the number; None: so many periods as the node's rates give it.
        period_ms: from an epoch of the run to the next; None: it has no rate.
        engine: gives the node's; None: it has none yet.
        memory: of `BUDGET_BYTES`, zeros at first, in which the counts outlive the process; None: they do not.
    """

    def __init__(
        self,
        budget_ms: float | None,
        period_ms: float | None,
        engine: Callable[[], Engine | None],
        memory: mmap | None = None,
        *clock: Clock,
    ) -> None:
        super().__init__(*clock)
        self._said_ms, self._period_ms, self._engine = budget_ms, period_ms, engine
        self._spent_ns = 0
        self._cells: Cells = memoryview(bytearray(BUDGET_BYTES) if memory is None else memory).cast("d")
        self._awaited_in = Kept(self._cells, _AWAITED, _EPOCHS, TOLD)

    @property
    def budget_ms(self) -> float:
        """How long the node may be at work in an epoch, by the rates that it has now."""
        if self._said_ms is not None:
            return self._said_ms
        engine, period_ms = self._engine(), self._period_ms or 0.0
        rates = None if engine is None else engine.wiring.place.rates
        return period_ms if engine is None or rates is None else period_ms * rates.epochs_for(engine.name)

    def completed(self, completed: Completed) -> None:
        super().completed(completed)
        spent_ns = sum(self._work.values())
        took_ms = (spent_ns - self._spent_ns) / 1e6
        self._spent_ns = spent_ns
        epoch = completed.step.epoch
        if epoch > _MADE_READY and took_ms > self.budget_ms and not self._began_with_nothing_to_do():
            self._cells[_MOST_MS] = max(self._cells[_MOST_MS], took_ms)
            self._cells[_OVER] += 1.0
            if is_awaited(self._engine(), epoch):
                self._awaited_in.append(epoch)

    def _began_with_nothing_to_do(self) -> bool:
        """Whether the epoch is the first one of a process of the world's that has come in the place of another: that
        is told nothing before, so the time until everybody was there counts as work."""
        engine = self._engine()
        return self._epochs == 1 and engine is not None and engine.is_world

    def told(self) -> dict[str, Value]:
        """The budget, how many epochs took longer, the longest of them, and which of them all waited for."""
        return {
            "budget_ms": self.budget_ms,
            "over": int(self._cells[_OVER]),
            "max_ms": float(self._cells[_MOST_MS]),
            "epochs": self._awaited_in.numbers().astype(int).tolist(),
        }


def is_awaited(engine: Engine | None, epoch: int) -> bool:
    """Whether an epoch of the run ends only after a turn of a node in it."""
    rates = None if engine is None else engine.wiring.place.rates
    return engine is None or rates is None or not rates.pairs or engine.name in rates.awaited(epoch)
