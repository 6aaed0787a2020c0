"""What is said again and again in a log is said some times, and then counted."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

OURS = "hierax"
"""The logger whose records are counted: a node's own records are its user's matter."""

FIRST = 20
"""So many records of a kind go through; then one for each pause."""

PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""The pauses, each longer than the one before; the last one is kept. What is quiet for as long begins anew."""

MAX_KINDS = 512
"""How many kinds of records are counted apart."""


@dataclass
class _Kind:
    passed: int = 0
    pause: int = 0
    since_s: float = 0.0
    left_out: int = 0


class Throttle(logging.Filter):
    """Lets through some records of each kind (of one text before its arguments are put in), and counts the rest."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._kinds: dict[tuple[int, str], _Kind] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record goes through; one that does says how many like it did not."""
        if record.name != OURS or record.levelno >= logging.ERROR:
            return True
        found = getattr(record, "throttled", None)
        if found is None:  # else another handler has asked
            found = record.throttled = self._passes(record)
        return bool(found)

    def take_left_out(self) -> list[tuple[int, str, int]]:
        """Level, text and number of the records that were left out and are not told yet; then they are."""
        found = [(level, text, kind.left_out) for (level, text), kind in self._kinds.items() if kind.left_out]
        self._kinds.clear()
        return found

    def _passes(self, record: logging.LogRecord) -> bool:
        key = (record.levelno, str(record.msg))
        if key not in self._kinds and len(self._kinds) >= MAX_KINDS:
            self._kinds.pop(next(iter(self._kinds)))
        kind = self._kinds.setdefault(key, _Kind(since_s=self._clock()))
        now = self._clock()
        quiet_s = now - kind.since_s
        if kind.passed < FIRST and not kind.left_out:
            kind.passed += 1
            if quiet_s > PAUSES_S[0]:
                kind.passed = 1
            kind.since_s = now
            return True
        if quiet_s < PAUSES_S[kind.pause]:
            kind.left_out += 1
            return False
        if kind.left_out:
            record.msg = f"{record.getMessage()} (and {kind.left_out} more like it in the last {quiet_s:.0f} s)"
            record.args = ()
            kind.pause = min(kind.pause + 1, len(PAUSES_S) - 1)
            kind.left_out = 0
        else:
            kind.passed, kind.pause = 1, 0
        kind.since_s = now
        return True
