"""Processes that one end has lost sight of, though they may live: their link broke, and nobody dials it again.

Zenoh dials the hub again by itself, and peers when the hub tells of them anew. Where the
link between two peers breaks and both keep theirs to the hub, nobody does. Whoever misses
a process then says so, and the hub tells of all of them anew (`Hub.introduce`).
"""

from __future__ import annotations

import time
from collections.abc import Callable

TRIES_S = (0.3, 1.0, 3.0, 10.0)
"""How long after a process was last heard of it is asked for; most that are gone have died."""


class AbsentProcesses:
    """Those that are missed."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock  # seconds
        self._since: dict[str, tuple[float, int]] = {}

    def gone(self, process: str) -> None:
        """Note that its liveliness token is not there any more; any thread may say so."""
        self._since[process] = (self._clock(), 0)

    def came(self, process: str) -> None:
        """Note that its liveliness token is there."""
        self._since.pop(process, None)

    def due(self) -> list[str]:
        """The processes that are to be asked for now."""
        now = self._clock()
        missed = []
        for process, (since_s, tries) in list(self._since.items()):
            if now - since_s < TRIES_S[tries]:
                continue
            missed.append(process)
            if tries + 1 == len(TRIES_S):
                self._since.pop(process, None)
            elif process in self._since:
                self._since[process] = (since_s, tries + 1)
        return missed
