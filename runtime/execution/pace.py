"""A world with a rate: when its epochs are due, and how late they begin."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from hierax.runtime.deployment.deployment import Late
from hierax.runtime.execution.times import Times

STALL_S = 0.5  # who is so late, and was not so before, was held up by more than work
_WARMING = 2  # epochs


class Pace:
    """Epoch k is due k - 3 periods after the third one: times are counted from there, so that no error adds up. In the
    first two all is made ready, for as long as that takes: nodes have context from the second one on."""

    def __init__(
        self, rate_hz: float, late: Late, times: Times | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.period_s = 1.0 / rate_hz
        self._skips = late == "skip"
        self._times = times or Times()
        self._clock = clock  # seconds
        self._warming = _WARMING
        self._first_s = math.nan
        self._slot = 0  # the next one
        self._overdue = self._was_stalled = False

    def wait_s(self) -> float:
        """How long until the next epoch is due; 0 or less: it is."""
        return 0.0 if math.isnan(self._first_s) else self._first_s + self._slot * self.period_s - self._clock()

    def ended(self) -> None:
        """The epoch before is committed."""
        self._overdue = self.wait_s() < 0.0

    def begin(self, epoch: int) -> str:
        """An epoch begins now; what people should know of it: the first one that is late, the second, the fourth, …,
        and each time that many are, at once."""
        now = self._clock()
        if self._warming:
            self._warming -= 1
            return ""
        if math.isnan(self._first_s):
            self._first_s = now
        lateness_s = now - self._first_s - self._slot * self.period_s
        overdue = math.ceil((now - self._first_s) / self.period_s) - self._slot  # epochs, this one among them
        was_stalled, is_late = self._was_stalled, self._overdue
        self._was_stalled, self._overdue = is_late and lateness_s >= STALL_S, False
        passed = max(0, overdue - 1) if self._skips else 0
        self._slot += 1 + passed
        self._times.begun_late(lateness_s, epoch if is_late else None, passed)
        if not is_late:
            return ""
        begins, count = f"epoch {epoch} begins {1e3 * lateness_s:.1f} ms late", self._times.late.count
        if self._was_stalled and overdue > 1 and not was_stalled:
            return f"{begins}: {overdue} epochs late, {'which are left out' if self._skips else 'which follow at once'}"
        return "" if count & (count - 1) else f"{begins}, as the one before was not done ({count} so far)"

    def told(self) -> dict[str, float | int | Sequence[int]]:
        """How late epochs have begun, in milliseconds; how many, and which, as the one before was not done; and how
        many times have passed by."""
        times = self._times
        p50, p99 = np.percentile(times.lateness_s.numbers(), (50, 99)) if times.lateness_s.count else (0.0, 0.0)
        return {
            "period_ms": 1e3 * self.period_s,
            "p50_ms": 1e3 * float(p50),
            "p99_ms": 1e3 * float(p99),
            "max_ms": 1e3 * times.most_late_s,
            "last_ms": 1e3 * times.lateness_s.last,
            "late": times.late.count,
            "skipped": times.skipped,
            "epochs": times.late.numbers().astype(int).tolist(),
        }
