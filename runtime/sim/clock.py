"""Virtual time: what is to happen, in order."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any


class Clock:
    """Events in the order of their times; of equal times, as they were scheduled."""

    def __init__(self) -> None:
        self.now = 0.0  # seconds
        self._number = 0
        self._events: list[tuple[float, int, Callable[..., None], tuple[Any, ...]]] = []

    def __call__(self) -> float:
        """The time, as production code asks for it."""
        return self.now

    def schedule(self, delay_s: float, event: Callable[..., None], *arguments: Any) -> None:
        self._number += 1
        heappush(self._events, (self.now + delay_s, self._number, event, arguments))

    def step(self) -> bool:
        if not self._events:
            return False
        self.now, _, event, arguments = heappop(self._events)
        event(*arguments)
        return True
