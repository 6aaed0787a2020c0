"""What others have said to a process, until its node's thread takes it in: bounded, as anybody may say anything."""

from __future__ import annotations

import threading
from collections import deque

from hierax.schemas.control import Control
from hierax.schemas.limits import MAX_STATE_BYTES

MAX_WORDS = 1024  # how many control messages wait at most; what is more is lost, and said again by who means it
MAX_BYTES = MAX_STATE_BYTES + (1 << 20)  # how many bytes they had on the wire, together


class ControlQueue:
    """Control messages in the order in which they came; any thread may put and take."""

    def __init__(self) -> None:
        self._words: deque[tuple[Control, int]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._words)

    def put(self, word: Control, size: int) -> bool:
        """One more, of so many bytes; whether there was room for it."""
        with self._lock:
            if len(self._words) >= MAX_WORDS or self._bytes + size > MAX_BYTES:
                return False
            self._words.append((word, size))
            self._bytes += size
        return True

    def take(self) -> Control | None:
        """The next one, if there is one."""
        with self._lock:
            if not self._words:
                return None
            word, size = self._words.popleft()
            self._bytes -= size
        return word
