"""How long a run's epochs took, and how late they began: what belongs to the run, and not to a process of it."""

from mmap import mmap

from hierax.runtime.watch.kept import TOLD, Cells, Kept

KEPT = 65536  # of how many epochs, the last ones, it is kept how long they took, and how late they began

_RUN, _BEGUN, _FIRST_S, _LAST_S, _SKIPPED, _MOST_S, _TOOK, _LATENESS, _LATE = range(9)
_NUMBERS = 16

TIMES_BYTES = 8 * (_NUMBERS + 2 * KEPT + TOLD)


class Times:
    """The times of a run, in seconds of one clock, which has to go on while the run does.

    Args:
        memory: of `TIMES_BYTES`, zeros at first, that outlives the process; None: of this process alone.
        run: its number; where the memory was another one's the run is resumed, and the pause between is left out.
    """

    def __init__(self, memory: mmap | None = None, run: int = 1) -> None:
        cells: Cells = memoryview(bytearray(TIMES_BYTES) if memory is None else memory).cast("d")
        self._cells, self._run = cells, float(run)
        first = _NUMBERS
        self.took_s = Kept(cells, _TOOK, first, KEPT)
        self.lateness_s = Kept(cells, _LATENESS, first + KEPT, KEPT)
        self.late = Kept(cells, _LATE, first + 2 * KEPT, TOLD)  # the numbers of epochs

    def begun(self, now_s: float) -> None:
        """An epoch begins."""
        cells = self._cells
        if not cells[_BEGUN]:
            cells[_BEGUN], cells[_FIRST_S], cells[_LAST_S] = 1.0, now_s, now_s
        elif cells[_RUN] != self._run:
            cells[_FIRST_S], cells[_LAST_S] = now_s - self.wall_s, now_s
        cells[_RUN] = self._run

    def ended(self, now_s: float, took_s: float) -> None:
        """An epoch is committed, after so long."""
        self._cells[_LAST_S] = now_s
        self.took_s.append(took_s)

    @property
    def wall_s(self) -> float:
        """The time from the beginning of the first epoch to the commit of the last."""
        return float(self._cells[_LAST_S] - self._cells[_FIRST_S])

    def begun_late(self, lateness_s: float, late: int | None, skipped: int) -> None:
        """An epoch begins so long after it was due; `late`: its number, where the one before was not done."""
        cells = self._cells
        self.lateness_s.append(lateness_s)
        cells[_MOST_S] = max(cells[_MOST_S], lateness_s)
        cells[_SKIPPED] += skipped
        if late is not None:
            self.late.append(late)

    @property
    def most_late_s(self) -> float:
        return float(self._cells[_MOST_S])

    @property
    def skipped(self) -> int:
        """How many times have passed by."""
        return int(self._cells[_SKIPPED])
