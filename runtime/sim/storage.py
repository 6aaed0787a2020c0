"""A simulated disk, whose writes a crash can tear."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from hierax.runtime.recovery.disk import SLOTS, Storage

BLOCK_BYTES = 64  # what a torn write leaves behind is made of such blocks: a cache line


class Crash(BaseException):
    """The process dies here. No `Exception`: nothing may catch it on its way."""


class SimStorage(Storage):
    """Two slots that outlive the process that writes them."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._slots = [bytes(BLOCK_BYTES)] * SLOTS
        self._last = 0
        self.tears: Callable[[], bool] = lambda: False  # asked before each write whether the process dies in it

    def write(self, slot: int, data: bytes) -> None:
        if self.tears():
            self._slots[slot] = self._torn(self._slots[slot], data)
            raise Crash
        self._last = slot
        old = self._slots[slot]
        self._slots[slot] = data + old[len(data) :]

    def read(self, slot: int) -> bytes:
        return self._slots[slot]

    def flush(self) -> None:
        return

    def damage(self) -> bool:
        data = bytearray(self._slots[self._last])
        if not any(data):
            return False
        length = min(len(data), 64)  # in the head or the first of the data: what counts, surely
        data[self._rng.randrange(length)] ^= 1 << self._rng.randrange(8)
        self._slots[self._last] = bytes(data)
        return True

    def _torn(self, old: bytes, data: bytes) -> bytes:
        """What is there when only some blocks of the new data, or only its beginning, came to be written."""
        whole = data + old[len(data) :]
        before = old + bytes(len(whole) - len(old))
        if self._rng.random() < 0.5:
            end = self._rng.randrange(len(data))
            return whole[:end] + before[end:]
        blocks = range(0, len(whole), BLOCK_BYTES)
        return b"".join((whole if self._rng.random() < 0.5 else before)[at : at + BLOCK_BYTES] for at in blocks)
