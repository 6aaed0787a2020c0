"""A clock for deadlines of others: it does not count the time in which nobody looked at it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

GAP_S = 0.5  # who looks at the clock again and again, and has not for so long, was stopped itself, or had no processor


class SteadyClock:
    """Gives seconds; it has to be asked again and again, within `GAP_S`.

    Where a process was stopped, or its machine was asleep, it must not blame others for the time that has passed
    meanwhile: they may have said all they had to.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now  # seconds, never going back
        self._lock = threading.Lock()
        self._asked_s = now()
        self._left_out_s = 0.0

    def __call__(self) -> float:
        with self._lock:
            now = self._now()
            gap_s, self._asked_s = now - self._asked_s, now
            if gap_s > GAP_S:
                self._left_out_s += gap_s
            return now - self._left_out_s
