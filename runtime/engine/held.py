"""Messages whose time has not come yet: bounded by number and by bytes, as anybody may send them."""

from __future__ import annotations

from collections.abc import Iterator
from sys import getsizeof

import numpy as np

from hierax.runtime.core.elements import Value
from hierax.runtime.engine.table import HELD_BYTES, HELD_MESSAGES, HELD_SLOTS
from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import Message
from hierax.schemas.values import encode_value

_FOREIGN_SHARE = 4


class Held:
    """What is held of each sender and kind."""

    def __init__(self) -> None:
        self._slots: dict[Slot, list[tuple[Message, int]]] = {}
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._slots)

    def put(self, message: Message, is_neighbour: bool) -> list[Message]:
        """Hold a message, if it is not held; gives those for which there is no room. Strangers have less of it."""
        slot = (message.header.sender, message.header.kind)
        held = self._slots.get(slot, [])
        if any(_are_same(other, message) for other, _ in held):
            return []
        if not held and not is_neighbour and len(self._slots) >= HELD_SLOTS:
            return [message]
        size = _weight(message.payload) + _weight(message.header.extensions)
        most = HELD_BYTES if is_neighbour else HELD_BYTES // _FOREIGN_SHARE
        nearest = sorted([*held, (message, size)], key=_how_far)
        before = sum(weight for _, weight in held)
        kept: list[tuple[Message, int]] = []
        left = most - (self._bytes - before)
        for each in nearest[:HELD_MESSAGES]:
            if each[1] > left:
                break
            kept.append(each)
            left -= each[1]
        self._bytes += sum(weight for _, weight in kept) - before
        if kept:
            self._slots[slot] = kept
        else:
            self._slots.pop(slot, None)
        return [each for each, _ in nearest[len(kept) :]]

    def take(self) -> Iterator[Message]:
        """All that is held, by sender and kind, the nearest first; then nothing is."""
        slots, self._slots, self._bytes = self._slots, {}, 0
        for slot in sorted(slots):
            for message, _ in slots[slot]:
                yield message


def _how_far(held: tuple[Message, int]) -> tuple[int, int, int]:
    header = held[0].header
    return header.roster, header.epoch, header.attempt


def _are_same(one: Message, other: Message) -> bool:
    return one.header == other.header and encode_value(one.payload) == encode_value(other.payload)


def _weight(value: Value) -> int:
    """About how many bytes of memory a value takes."""
    if isinstance(value, np.ndarray):
        return 128 + value.nbytes
    if isinstance(value, dict):
        return 64 + sum(getsizeof(key) + _weight(part) for key, part in value.items())
    if isinstance(value, tuple):
        return 64 + sum(map(_weight, value))
    return getsizeof(value)
