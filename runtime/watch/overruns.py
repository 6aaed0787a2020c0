"""Overruns: in which epochs a node has waited for those above it that took longer than their delays."""

import time
from collections.abc import Callable
from mmap import mmap

from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.watch.budget import is_awaited
from hierax.runtime.watch.kept import TOLD, Cells, Kept
from hierax.runtime.watch.meter import Clock
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.limits import MAX_NAME_CHARS
from hierax.schemas.values import Value

MOST_UPPERS = 32  # of how many nodes above one overruns are counted

_RING, _EPOCHS = MOST_UPPERS, MOST_UPPERS + 1  # behind the counts: how many epochs were kept, and the last ones
_CELLS_BYTES = 8 * (_EPOCHS + TOLD)

OVERRUNS_BYTES = _CELLS_BYTES + MOST_UPPERS * MAX_NAME_CHARS


class Overruns(Watcher):
    """Counts by node above what the engine notes as it begins to wait.

    Args:
        engine: gives the node's; None: it has none yet.
        comes_back: whether the process has come in the place of another one. In its first turn it lacks also what was
            said in time, as that is only said again: what it waits for then is not counted.
        period_ms: from an epoch of the run to the next; None: it has no rate.
        memory: of `OVERRUNS_BYTES`, zeros at first, in which the counts outlive the process.
    """

    def __init__(
        self,
        engine: Callable[[], Engine | None],
        comes_back: bool,
        period_ms: float | None,
        memory: mmap,
        clock: Clock = time.perf_counter_ns,
    ) -> None:
        self._engine, self._lacks, self._period_ms, self._clock = engine, comes_back, period_ms, clock
        cells, self._names = memoryview(memory)[:_CELLS_BYTES], memoryview(memory)[_CELLS_BYTES:OVERRUNS_BYTES]
        self._counts: Cells = cells.cast("d")
        self._long = Kept(self._counts, _RING, _EPOCHS, TOLD)  # epochs, each with the number of the node above
        self._seen: dict[str, int] = {}
        self._waits_for: list[int] = []  # the numbers of the nodes above
        self._since_ns = 0

    def served(self) -> None:
        engine = self._engine()
        if not isinstance(engine, RatedEngine) or engine.overruns == self._seen:
            return
        uppers = [upper for upper, count in engine.overruns.items() if count != self._seen.get(upper)]
        self._seen = dict(engine.overruns)
        if self._lacks:
            return
        self._since_ns = self._clock()
        self._waits_for = [number for upper in uppers if (number := self._number(upper)) is not None]
        for number in self._waits_for:
            self._counts[number] += 1.0

    def completed(self, completed: Completed) -> None:
        self._lacks = False
        if not self._waits_for:
            return
        waits_for, self._waits_for = self._waits_for, []
        waited_ms, epoch = (self._clock() - self._since_ns) / 1e6, completed.step.epoch
        if self._period_ms is not None and waited_ms > self._period_ms and is_awaited(self._engine(), epoch):
            for number in waits_for:
                self._long.append(epoch * MOST_UPPERS + number)

    def _number(self, upper: str) -> int | None:
        """The place of a node above; None: there is none left."""
        known = self._known()
        if upper not in known and len(known) < MOST_UPPERS:
            name = upper.encode()
            self._names[len(known) * MAX_NAME_CHARS :][: len(name)] = name
            return len(known)
        return known.index(upper) if upper in known else None

    def _known(self) -> list[str]:
        rows = bytes(self._names)
        names = (rows[at : at + MAX_NAME_CHARS] for at in range(0, len(rows), MAX_NAME_CHARS))
        return [name.rstrip(b"\0").decode(errors="replace") for name in names if name[0]]

    def told(self) -> dict[str, Value]:
        """By node above, how often it was waited for, and in which epochs that was longer than a period, and all waited
        for their end."""
        found: dict[str, Value] = {
            upper: {"count": int(self._counts[number]), "epochs": []} for number, upper in enumerate(self._known())
        }
        uppers = list(found)
        for epoch, number in (divmod(int(each), MOST_UPPERS) for each in self._long.numbers()):
            found[uppers[number]]["epochs"].append(epoch)
        return found
