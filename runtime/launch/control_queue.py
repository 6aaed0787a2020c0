"""What others have said to a process, until its node's thread takes it in: bounded, as anybody may say anything."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator

from hierax.schemas.control import Control
from hierax.schemas.limits import MAX_STATE_BYTES

MAX_WORDS = 1024  # how many control messages wait at most; what is more is lost, and said again by who means it
MAX_BYTES = MAX_STATE_BYTES + (1 << 20)  # how many bytes they had on the wire, together
AT_ONCE = 64  # how many of them are taken in between two messages of an epoch


class ControlQueue:
    """Control messages in the order in which they came; any thread may put and take."""

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        self.wake = wake  # called where somebody who waits has to look
        self._posted: deque[Control] = deque()
        self._words: deque[tuple[Control, int]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._woken = False

    def __len__(self) -> int:
        return len(self._posted) + len(self._words)

    def post(self, word: Control) -> None:
        """One more from the process's own supervisor; there is room for it in any case."""
        self._posted.append(word)
        self.wake()

    def put(self, word: Control, size: int) -> bool:
        """One more from anybody, of so many bytes; whether there was room for it."""
        with self._lock:
            if len(self._words) >= MAX_WORDS or self._bytes + size > MAX_BYTES:
                return False
            self._words.append((word, size))
            self._bytes += size
        if not self._woken:
            self._woken = True
            self.wake()
        return True

    def taken(self) -> Iterator[Control]:
        """All that the supervisor has said, then what others have; of that not more than `AT_ONCE`."""
        self._woken = False
        while self._posted:
            yield self._posted.popleft()
        for _ in range(AT_ONCE):
            word = self.take()
            if word is None:
                return
            yield word

    def take(self) -> Control | None:
        """The next one of what others have said, if there is one."""
        with self._lock:
            if not self._words:
                return None
            word, size = self._words.popleft()
            self._bytes -= size
        return word
