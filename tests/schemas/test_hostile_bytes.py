"""Whatever bytes arrive: a value or a `SchemaError` comes out, and memory stays bounded."""

from __future__ import annotations

import random
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.golden import encoded
from support.strategies import messages, randoms, values
from support.sweep import examples
from support.tagged import text

from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_ENTRIES, MAX_PLAIN_BYTES
from hierax.schemas.messages import Header, Message, decode_message, encode_message
from hierax.schemas.roster import Roster
from hierax.schemas.values import decode_value, encode_value

FIXED_BYTES = 16 << 20
BYTES_PER_BYTE = 50
VALID = list(encoded().values())
HEADS = (
    *(bytes([head]) for head in (0x80, 0x8F, 0x90, 0x9F, 0xA0, 0xBF, 0xC0, 0xC1, 0xFF)),
    *(head + b"\xff" * 4 for head in (b"\xc6", b"\xc9", b"\xdb", b"\xdd", b"\xdf")),
    *(head + b"\x7f\xff\xff\xff" for head in (b"\xc6", b"\xdb", b"\xdd", b"\xdf")),
    *(head + b"\xff\xff" for head in (b"\xc5", b"\xc8", b"\xda", b"\xdc", b"\xde")),
    *(b"\xd6\xff" + bytes(4), b"\xd4\x01\x00", b"\xd5\x02\x00\x00", b"\xc7\x04\xff" + bytes(4)),
)
patient = settings(max_examples=examples(25, 80))


@contextmanager
def costing_at_most(size: float) -> Iterator[None]:
    """What is done in it takes no more memory than so many bytes. Nothing else is traced, which costs time."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= size


def outcome(decode: Callable[[bytes], Any], data: bytes) -> Any:
    """What comes out, and that it cost no more memory than it may."""
    with costing_at_most(FIXED_BYTES + BYTES_PER_BYTE * len(data)):
        try:
            result = decode(data)
        except SchemaError as error:
            result = error
    if isinstance(result, SchemaError):
        assert len(str(result)) < 2000
    return result


def survives(data: bytes) -> None:
    """Both decoders, and what they let through can be sent again."""
    message = outcome(decode_message, data)
    if not isinstance(message, SchemaError):
        assert text(decode_message(encode_message(message))) == text(message)
    value = outcome(decode_value, data)
    if not isinstance(value, SchemaError):
        assert text(decode_value(encode_value(value))) == text(value)
        outcome(lambda _: Roster.read(value), data)


def mutated(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """One to four changes: flips, cuts, insertions, splices, lies about lengths."""
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data) + 1)
        to = rng.randrange(at, min(len(data), at + rng.choice((1, 8, len(data)))) + 1)
        start = rng.randrange(len(other) + 1)
        kind = rng.randrange(7)
        if kind == 0:
            data = data[:at] + bytes(byte ^ (1 << rng.randrange(8)) for byte in data[at : at + 1]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at]
        elif kind == 2:
            data = data[:at] + rng.randbytes(rng.randint(1, 8)) + data[at:]
        elif kind == 3:
            data = data[:at] + data[to:]
        elif kind == 4:
            data = data[:at] + other[start : start + rng.randint(1, 200)] + data[to:]
        elif kind == 5:
            data = data[:at] + rng.choice(HEADS) + data[at + rng.randrange(2) :]
        else:
            data = data[:at] + struct.pack(rng.choice((">I", "<Q", ">H")), rng.randrange(1 << 16)) + data[to:]
    return data


@patient
@given(st.binary(max_size=300))
def test_random_bytes(data: bytes) -> None:
    survives(data)
    survives(b"\x9c\x01" + data)
    survives(b"\xdc\x00\x0e" + data)


@patient
@given(messages(), randoms)
def test_mutated_messages(message: Message, rng: random.Random) -> None:
    data = encode_message(message)
    for _ in range(20):
        survives(mutated(rng, data, rng.choice(VALID)))


@patient
@given(values, randoms)
def test_mutated_values(value: Any, rng: random.Random) -> None:
    data = encode_value(value)
    for _ in range(20):
        survives(mutated(rng, data, rng.choice(VALID)))


@pytest.mark.parametrize("data", VALID, ids=list(encoded()))
def test_mutated_golden_files(data: bytes) -> None:
    for seed in range(examples(60, 200)):
        rng = random.Random(seed)
        try:
            survives(mutated(rng, data, rng.choice(VALID)))
        except BaseException as error:
            raise AssertionError(f"seed {seed}") from error


@pytest.mark.parametrize("data", [data for data in VALID if len(data) < 2000], ids=str)
def test_every_truncation(data: bytes) -> None:
    for length in range(len(data)):
        with pytest.raises(SchemaError):
            decode_message(data[:length])
        survives(data[:length])


def claims(head: bytes, levels: int, length: int) -> bytes:
    """Headers within headers, each claiming many entries, and no entries."""
    return (head * levels)[:length].ljust(length, b"\xc0")


def array32(count: int) -> bytes:
    return b"\xdd" + struct.pack(">I", count)


MEGA = 1 << 20
ARRAY0 = struct.pack("<BBH", 0, 3, 0) + b"|u1\x05"
EXT0 = b"\xd7\x01" + ARRAY0
ATTACKS = {
    "nested array32, small": claims(array32(4000), 800, 4000),
    "nested array16, small": claims(b"\xdc\x0f\xa0", 1000, 4000),
    "nested array16 below the prescan's size": claims(b"\xdc\x03\xff", 300, 1000),
    "nested array32, large": claims(array32(MEGA), 1000, MEGA),
    "nested array32 that all end in entries": claims(array32(MEGA), 900, MEGA),
    "nested map32": claims(b"\xdf" + struct.pack(">I", MEGA) + b"\xa1a", 1000, MEGA),
    "nested fixarray": b"\x91" * 100_000 + b"\xc0",
    "nested fixmap": b"\x81\xa1a" * 100_000 + b"\xc0",
    "nested to msgpack's own limit": b"\x91" * 1000 + b"\xc0",
    "array32 of 2^32 - 1": array32((1 << 32) - 1),
    "map32 of 2^32 - 1": b"\xdf" + b"\xff" * 4,
    "bin32 of 2^32 - 1": b"\xc6" + b"\xff" * 4 + b"x",
    "str32 of 2^32 - 1": b"\xdb" + b"\xff" * 4 + b"x",
    "ext32 of 2^32 - 1": b"\xc9" + b"\xff" * 4 + b"\x01",
    "a million empty maps": array32(MEGA) + b"\x80" * MEGA,
    "a million maps": array32(MEGA) + b"\x81\xa1a\xc0" * MEGA,
    "a million empty arrays": array32(MEGA) + b"\x90" * MEGA,
    "a million arrays of one": array32(MEGA) + b"\x91\xc0" * MEGA,
    "many deep chains": array32(MEGA // 64) + (b"\x91" * 60 + b"\xc0") * (MEGA // 64),
    "more than a million nils": array32(MEGA + 1) + b"\xc0" * (MEGA + 1),
    "a million nils": array32(MEGA) + b"\xc0" * MEGA,
    "a million short strings": array32(MEGA) + b"\xa2\xc4\x80" * MEGA,
    "a million floats": array32(MEGA) + (b"\xca" + bytes(4)) * MEGA,
    "arrays without dimensions": array32(MEGA // 32) + EXT0 * (MEGA // 32),
    "time stamps": array32(MEGA // 32) + (b"\xd6\xff" + bytes(4)) * (MEGA // 32),
    "one key a million times": b"\xdf" + struct.pack(">I", MEGA) + b"\xa1a\xc0" * MEGA,
    "many keys": b"\xdf"
    + struct.pack(">I", 1 << 17)
    + b"".join(b"\xa4" + struct.pack(">I", n).hex()[-4:].encode() + b"\xc0" for n in range(1 << 16)) * 2,
    "a format as long as the message": b"\x9c\xdb" + struct.pack(">I", MEGA) + b"x" * MEGA + b"\xc0" * 11,
    "a deep format": b"\x9c" + b"\x91" * 60 + array32(MEGA) + b"\xc0" * (MEGA + 11),
    "an error in the last of a million": array32(MEGA) + b"\xc0" * (MEGA - 1) + b"\xd6\xff" + bytes(4),
    "a tail of 65535": b"\xdc\xff\xff" + b"\xc0" * 11 + b"\xc9\x00\x00\x00\x08\x01" * 60_000 + b"\xce\x00\x05\x7e\x45",
}


@pytest.mark.parametrize("data", ATTACKS.values(), ids=list(ATTACKS))
def test_attacks_cost_no_more_memory_than_they_may(data: bytes) -> None:
    outcome(decode_message, data)
    outcome(decode_value, data)
    outcome(decode_message, b"\x9c\x01\x00\xa1a\xa1b\x01\x00\x00\x00\xcb" + bytes(8) + b"\xc4\x00\x80\x91" + data)


def test_a_lie_in_a_small_message_costs_little() -> None:
    for data in ATTACKS.values():
        if len(data) <= 4096:
            with costing_at_most(4 << 20), suppress(SchemaError):
                decode_value(data)


@pytest.mark.parametrize("leaf", [b"\xa2ab", b"\xcd\x7f\xff", b"\xcb" + bytes(8), b"\xc4\x01a", b"\x01"])
def test_many_small_entries_are_bounded_in_number(leaf: bytes) -> None:
    rows = MAX_ENTRIES // 1000 + 1
    row = b"\xdc\x03\xe8" + leaf * 1000
    data = b"\xdd" + struct.pack(">I", rows) + row * rows
    with costing_at_most(MAX_ENTRIES * 100), pytest.raises(SchemaError, match="entries"):
        decode_value(data)


def test_besides_its_arrays_a_message_is_bounded_by_bytes() -> None:
    header = Header("obs", "low", "mid", 1)
    big = Message(header, (bytes(MAX_PLAIN_BYTES),))
    with pytest.raises(SchemaError, match="use arrays"):
        encode_message(big)
    array = Message(header, (np.zeros(2 * MAX_PLAIN_BYTES, np.uint8),))
    data = encode_message(array)
    assert decode_message(data).payload[0].nbytes == 2 * MAX_PLAIN_BYTES
    with pytest.raises(SchemaError, match="use arrays"):
        encode_message(Message(header, (*array.payload, bytes(MAX_PLAIN_BYTES))))
    fields = (1, 0, "low", "mid", 1, 0, 0, 0, 0.0, b"", {}, (bytes(MAX_PLAIN_BYTES),))
    with pytest.raises(SchemaError, match="use arrays"):
        decode_message(encode_value(fields))
