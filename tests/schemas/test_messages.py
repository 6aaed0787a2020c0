"""Messages: round trips in place, the tail of large arrays, what is refused."""

from __future__ import annotations

import struct
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from support.strategies import messages
from support.tagged import text

from hierax.schemas import messages as schema
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import LARGE_ARRAY_BYTES, MAX_EXTENSIONS, MAX_NAME_CHARS
from hierax.schemas.messages import Header, Message, SaidMessage, decode_message, encode_message

HEADER = Header("obs", "world", "arm", 1)
FIELDS = [1, 0, "world", "arm", 1, 0, 0, 0, 0.0, b"", {}, []]
LARGE = LARGE_ARRAY_BYTES // 8


def large_arrays(value: Any) -> list[np.ndarray]:
    if isinstance(value, np.ndarray):
        return [value] if value.nbytes >= LARGE_ARRAY_BYTES else []
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ()
    return [array for part in parts for array in large_arrays(part)]


@given(messages())
def test_messages_come_back(message: Message) -> None:
    data = encode_message(message)
    back = decode_message(data)
    assert type(back.header) is Header
    assert text(back) == text(message)
    assert encode_message(back) == data


@given(messages())
def test_kept_bytes_are_those_of_the_message(message: Message) -> None:
    kept = SaidMessage(*message)
    data = kept.keep_encoded()
    assert data == encode_message(kept) == encode_message(message)
    other = kept._replace(header=kept.header._replace(epoch=kept.header.epoch ^ 1))
    assert encode_message(other) == encode_message(message._replace(header=other.header))


def test_large_arrays_of_a_kept_message_are_lent() -> None:
    kept = SaidMessage(HEADER, (np.zeros(LARGE),))
    lent: list[np.ndarray] = []
    assert len(kept.keep_encoded()) > LARGE_ARRAY_BYTES
    data = encode_message(kept, lambda array: lent.append(array) or b"there")
    assert len(lent) == 1
    assert len(data) < LARGE_ARRAY_BYTES


@given(messages())
def test_large_arrays_are_read_in_place(message: Message) -> None:
    data = encode_message(message)
    received = np.frombuffer(data, np.uint8)
    back = decode_message(data)
    arrays = large_arrays(back.payload)
    assert len(arrays) == len(large_arrays(message.payload))
    for array in arrays:
        assert np.shares_memory(array, received)
        assert array.flags.aligned
        assert array.ctypes.data % 16 == received.ctypes.data % 16
        assert not array.flags.writeable


@pytest.mark.parametrize("count", [LARGE - 1, LARGE])
def test_the_limit_between_in_place_and_behind(count: int) -> None:
    data = encode_message(Message(HEADER, (np.zeros(count),)))
    assert (data[0] == 0xDC) == (count == LARGE)
    assert len(decode_message(data).payload[0]) == count


def test_one_array_twice_is_two_arrays() -> None:
    array = np.arange(LARGE)
    back = decode_message(encode_message(Message(HEADER, ([array, array],))))
    assert [part.tolist() for part in back.payload[0]] == [array.tolist()] * 2


def test_unknown_extensions_are_kept() -> None:
    header = HEADER._replace(extensions={"later-version": {"x": (1, None)}, "trace": b"\x01"})
    back = decode_message(encode_message(Message(header, ())))
    assert back.header == header
    assert list(back.header.extensions) == ["later-version", "trace"]


@pytest.mark.parametrize(
    ("message", "where", "what"),
    [
        (Message(HEADER, ({"pose": {1}},)), "payload[0].pose", "a set"),
        (Message(HEADER, (1, {"a": [np.array([None] * LARGE)]})), "payload[1].a[0]", "dtype object"),
        (Message(HEADER, ({1: 2},)), "payload[0]", "the key 1"),
        (Message(HEADER._replace(extensions={"t": {1}}), ()), "extensions.t", "a set"),
        (Message(HEADER._replace(epoch=1 << 64), ()), "epoch", "64 bits"),
        (Message(HEADER, (np.broadcast_to(0.0, (1 << 40,)),)), "payload[0]", "bytes; at most"),
        (Message(HEADER, (np.zeros(LARGE),) * 65_537), "message", "arrays have more than"),
    ],
)
def test_what_cannot_travel_is_named_with_its_path(message: Message, where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        encode_message(message)
    assert raised.value.where == where
    assert what in raised.value.what


def changed(index: int, field: Any) -> bytes:
    fields = list(FIELDS)
    fields[index] = field
    return msgpack.packb(fields)


@pytest.mark.parametrize(
    ("data", "where", "what"),
    [
        (b"", "message", "empty"),
        (b"\x80", "message", "does not begin like a message: 80"),
        (msgpack.packb(FIELDS[:-1]), "message", "does not begin"),
        (msgpack.packb([*FIELDS, 1]), "message", "does not begin"),
        (changed(0, 2), "message.format", "format 2; this version reads format 1"),
        (changed(0, True), "message.format", "expected a whole number, got True"),
        (changed(0, "x" * 10**6), "message.format", "expected a whole number"),
        (changed(1, 4), "message.kind", "expected 0 to 3"),
        (changed(1, -1), "message.kind", "expected 0 to 3"),
        (changed(1, "obs"), "message.kind", "got 'obs'"),
        (changed(2, ""), "message.sender", "1 to 128"),
        (changed(3, "x" * (MAX_NAME_CHARS + 1)), "message.receiver", "1 to 128"),
        (changed(3, b"arm"), "message.receiver", "expected a string"),
        (changed(4, -1), "message.epoch", "from 0"),
        (changed(4, 1.0), "message.epoch", "expected a whole number, got 1.0"),
        (changed(5, None), "message.attempt", "expected a whole number"),
        (changed(6, True), "message.roster", "expected a whole number"),
        (changed(7, []), "message.instance", "got a tuple"),
        (changed(8, 1), "message.time_s", "expected a float, got 1"),
        (changed(9, bytes(31)), "message.digest", "no or 32 bytes, got 31"),
        (changed(9, "x" * 32), "message.digest", "expected bytes"),
        (changed(10, []), "message.extensions", "expected a map"),
        (changed(10, {str(n): n for n in range(MAX_EXTENSIONS + 1)}), "message.extensions", "at most 64 entries"),
        (changed(11, {}), "message.payload", "expected an array of elements"),
        (changed(11, [msgpack.ExtType(schema.TAIL_ARRAY, b"\x00\x00")]), "message", "unknown extension type 2"),
        (changed(11, [{"t": msgpack.Timestamp(1)}]), "payload[0].t", "time stamp"),
    ],
)
def test_bad_fields_are_named(data: bytes, where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_message(data)
    assert where in raised.value.where
    assert what in raised.value.what
    assert len(str(raised.value)) < 300


def tail_message(payload: Any, arrays: list[bytes], count: int | None = None, size: int | None = None) -> bytes:
    """A message with a tail, well formed or not."""
    fields = msgpack.packb([*FIELDS[:-1], payload])[1:]
    tail = b"".join(b"\xc9" + struct.pack(">Ib", len(array), 1) + array for array in arrays)
    elements = len(FIELDS) + len(arrays) + 1 if count is None else count
    length = len(tail) + 5 if size is None else size
    return b"\xdc" + struct.pack(">H", elements) + fields + tail + b"\xce" + struct.pack(">I", length)


ARRAY = struct.pack("<BBH", 1, 3, 0) + b"|u1" + struct.pack("<Q", 2) + b"\x05\x06"
FIRST = msgpack.ExtType(schema.TAIL_ARRAY, b"\x00\x00")
SECOND = msgpack.ExtType(schema.TAIL_ARRAY, b"\x00\x01")


def test_a_tail_written_by_hand_is_read() -> None:
    back = decode_message(tail_message([SECOND, FIRST], [ARRAY, ARRAY[:-1] + b"\x07"]))
    assert [array.tolist() for array in back.payload] == [[5, 7], [5, 6]]


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\xdc", "too short"),
        (b"\xdc\x00\x0d\xce\x00\x00", "too short"),
        (tail_message([], []), "not laid out"),
        (tail_message([FIRST], [ARRAY], count=12), "not laid out"),
        (tail_message([FIRST], [ARRAY], count=0), "not laid out"),
        (tail_message([FIRST], [ARRAY], size=4), "not laid out"),
        (tail_message([FIRST], [ARRAY], size=0), "not laid out"),
        (tail_message([FIRST], [ARRAY], size=1 << 31), "not laid out"),
        (tail_message([FIRST], [ARRAY])[:-1] + b"\x99", "not laid out"),
        (tail_message([FIRST], [ARRAY]) + b"\xc0", "not laid out"),
        (tail_message([FIRST], [ARRAY], count=15), "cut off"),
        (tail_message([FIRST], [ARRAY], count=65535), "cut off"),
        (tail_message([FIRST, SECOND], [ARRAY, ARRAY], count=14), "bytes too many"),
        (tail_message([FIRST], [ARRAY[:-1]]), "wants 2 bytes"),
        (tail_message([FIRST], [b""]), "too short"),
        (tail_message([FIRST, FIRST], [ARRAY]), "not there or taken"),
        (tail_message([SECOND], [ARRAY]), "not there or taken"),
        (tail_message([msgpack.ExtType(2, b"")], [ARRAY]), "not there or taken"),
        (tail_message([msgpack.ExtType(2, bytes(9))], [ARRAY]), "not there or taken"),
        (tail_message([msgpack.ExtType(3, b"\x00\x00")], [ARRAY]), "unknown extension type 3"),
        (tail_message([], [ARRAY]), "nothing refers to 1"),
        (
            tail_message([FIRST], [ARRAY]).replace(b"\xc9\x00\x00\x00\x11\x01", b"\xc9\x00\x00\x00\x11\x02"),
            "not an array",
        ),
        (tail_message([FIRST], [ARRAY]).replace(b"\xc9\x00\x00\x00\x11\x01", b"\xc9\xff\xff\xff\xff\x01"), "cut off"),
    ],
)
def test_a_tail_that_lies_is_refused(data: bytes, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_message(data)
    assert what in raised.value.what
