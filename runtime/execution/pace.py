"""A world with a rate: when its epochs are due, and how late they begin."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from hierax.runtime.deployment.deployment import Late

KEPT = 65536  # of how many epochs, the last ones, the lateness is kept
TOLD = 1024  # how many late epochs, the last ones, are told by their numbers


class Pace:
    """Epoch k is due k - 2 periods after the second one: times are counted from there, so that no error adds up."""

    def __init__(self, rate_hz: float, late: Late, clock: Callable[[], float] = time.monotonic) -> None:
        self.period_s = 1.0 / rate_hz
        self._skips = late == "skip"
        self._clock = clock  # seconds
        self._is_warm = False
        self._first_s = math.nan
        self._slot = 0  # the next one
        self._overdue = False
        self._lateness_s: deque[float] = deque(maxlen=KEPT)
        self._late: deque[int] = deque(maxlen=TOLD)
        self._late_count = self._skipped = 0
        self._most_s = 0.0

    def wait_s(self) -> float:
        """How long until the next epoch is due; 0 or less: it is."""
        return 0.0 if math.isnan(self._first_s) else self._first_s + self._slot * self.period_s - self._clock()

    def ended(self) -> None:
        """The epoch before is committed."""
        self._overdue = self.wait_s() < 0.0

    def begin(self, epoch: int) -> str:
        """An epoch begins now; what people should know of it: the first one that is late, the second, the fourth, …"""
        now = self._clock()
        if not self._is_warm:  # in the first one all is made ready, for as long as that takes
            self._is_warm = True
            return ""
        if math.isnan(self._first_s):
            self._first_s = now
        lateness_s = now - self._first_s - self._slot * self.period_s
        self._lateness_s.append(lateness_s)
        self._most_s = max(self._most_s, lateness_s)
        is_late, self._overdue = self._overdue, False
        if is_late:
            self._late_count += 1
            self._late.append(epoch)
        self._slot += 1
        if self._skips:
            slot = math.ceil((now - self._first_s) / self.period_s)
            self._skipped += max(0, slot - self._slot)
            self._slot = max(self._slot, slot)
        count = self._late_count
        if not is_late or count & (count - 1):
            return ""
        return f"epoch {epoch} begins {1e3 * lateness_s:.1f} ms late, as the one before was not done ({count} so far)"

    def told(self) -> dict[str, float | int | Sequence[int]]:
        """How late epochs have begun, in milliseconds; how many, and which, as the one before was not done; and how
        many times have passed by."""
        p50, p99 = np.percentile(self._lateness_s, (50, 99)) if self._lateness_s else (0.0, 0.0)
        return {
            "period_ms": 1e3 * self.period_s,
            "p50_ms": 1e3 * float(p50),
            "p99_ms": 1e3 * float(p99),
            "max_ms": 1e3 * self._most_s,
            "last_ms": 1e3 * self._lateness_s[-1] if self._lateness_s else 0.0,
            "late": self._late_count,
            "skipped": self._skipped,
            "epochs": list(self._late),
        }
