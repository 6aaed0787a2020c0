"""Messages in pieces, for links that carry no long ones.

A message that is short enough goes as it is. A longer one goes as several: the byte 0xC1, with which
no msgpack begins, then 16 random bytes that tell it from others on the same key, how many pieces
there are and which one this is (32 bits each, big-endian), then the data.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Iterator
from secrets import token_bytes

from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES

_MARK = b"\xc1"
_HEAD = struct.Struct(">c16sII")
_UNFINISHED = 16
"""How many messages at once may lack pieces; the one that was begun first is given up for another."""


def in_pieces(data: bytes, most: int | None) -> Iterator[bytes]:
    """A message as what can be sent.

    Args:
        data: the message.
        most: how many bytes the links carry at once; None: any number.
    """
    if most is None or len(data) <= most:
        yield data
        return
    step = most - _HEAD.size
    name = token_bytes(16)
    count = -(-len(data) // step)
    for number in range(count):
        yield _HEAD.pack(_MARK, name, count, number) + data[number * step : (number + 1) * step]


class Joiner:
    """Puts messages together again; one of which pieces are lost never is. Not for two threads at once."""

    def __init__(self) -> None:
        self._unfinished: OrderedDict[bytes, list[bytes]] = OrderedDict()

    def join(self, data: bytes) -> bytes | None:
        """Take in what came.

        Returns:
            The message that it is, or that it makes whole; None where pieces are missing.

        Raises:
            SchemaError: it begins like a piece, and is none.
        """
        if data[:1] != _MARK:
            return data
        name, count, number = _read_head(data)
        parts = self._unfinished.setdefault(name, [])
        if number != len(parts):  # doubled, or one before it was lost
            del self._unfinished[name]
            return None
        parts.append(data[_HEAD.size :])
        if sum(map(len, parts)) > MAX_MESSAGE_BYTES:
            del self._unfinished[name]
            raise SchemaError(f"is longer than the {MAX_MESSAGE_BYTES} bytes that are allowed", "message in pieces")
        if len(parts) == count:
            return b"".join(self._unfinished.pop(name))
        if len(self._unfinished) > _UNFINISHED:
            self._unfinished.popitem(last=False)
        return None


def _read_head(data: bytes) -> tuple[bytes, int, int]:
    if len(data) <= _HEAD.size:
        raise SchemaError(f"{len(data)} bytes are too short", "piece of a message")
    _, name, count, number = _HEAD.unpack_from(data)
    if number >= count:
        raise SchemaError(f"is number {number} of {count}", "piece of a message")
    return name, count, number
