"""Values: they come back as they went, and what cannot travel is named."""

from __future__ import annotations

import dataclasses
import enum
import json
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import msgpack
import numpy as np
import pytest
from hypothesis import given
from support.strategies import values
from support.tagged import tagged, text

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.limits import MAX_CONTAINERS, MAX_DEPTH, MAX_ITEMS
from hierax.schemas.values import decode_value, encode_value, plain


@dataclasses.dataclass
class Pose:
    x: float = 0.0


class Point(NamedTuple):
    x: float
    y: float


class Colour(str, enum.Enum):
    RED = "red"


def nested(levels: int) -> Any:
    value: Any = 1
    for _ in range(levels):
        value = [value]
    return value


@given(values)
def test_values_come_back(value: Any) -> None:
    data = encode_value(value)
    back = decode_value(data)
    assert text(back) == text(value)
    assert encode_value(back) == data


@given(values)
def test_decoded_values_cannot_be_changed_by_accident(value: Any) -> None:
    stack = [decode_value(encode_value((value,)))]
    while stack:
        item = stack.pop()
        assert not isinstance(item, list)
        if isinstance(item, np.ndarray):
            assert not item.flags.writeable
            assert item.flags.aligned
        elif isinstance(item, dict):
            stack += item.values()
        elif isinstance(item, tuple):
            stack += item


@pytest.mark.parametrize(
    ("value", "comes_back"),
    [
        ([1, [2]], (1, (2,))),
        (Point(1.0, 2.0), (1.0, 2.0)),
        (OrderedDict(b=1, a=2), {"b": 1, "a": 2}),
        (np.float32(0.5), 0.5),
        (np.int64(-3), -3),
        (np.uint64((1 << 64) - 1), (1 << 64) - 1),
        (np.bool_(True), True),
        (np.str_("a"), "a"),
        ({np.str_("a"): 1}, {"a": 1}),
        (Colour.RED, "red"),
        (bytearray(b"ab"), b"ab"),
    ],
)
def test_relatives_come_back_as_plain_values(value: Any, comes_back: Any) -> None:
    back = decode_value(encode_value(value))
    assert back == comes_back
    assert type(back) is type(comes_back)


def test_the_encoding_keeps_the_order_of_keys_and_tells_types_apart() -> None:
    distinct = [{"a": 1, "b": 2}, {"b": 2, "a": 1}, 1, 1.0, True, "1", b"1", -0.0, 0.0, None, (), {}]
    assert len({encode_value(value) for value in distinct}) == len(distinct)


@pytest.mark.parametrize(
    ("value", "where", "what"),
    [
        ({1, 2}, "value", "a set cannot be sent; None, bool, int, float, str, bytes, and tuples"),
        ([0, {"pose": {1}}], "value[1].pose", "a set cannot be sent"),
        ({"pose": Pose()}, "value.pose", "a Pose cannot be sent"),
        ({"a": [np.array([None])]}, "value.a[0]", "dtype object"),
        ({"a": np.array([None] * 10_000)}, "value.a", "dtype object"),
        ({"a": 1 << 64}, "value.a", "64 bits"),
        ({"a": -(1 << 63) - 1}, "value.a", "64 bits"),
        ({"a": {3: 4}}, "value.a", "the key 3 is no str"),
        ({"a": {b"k": 4}}, "value.a", "is no str"),
        ({"a": {None: 4}}, "value.a", "the key None is no str"),
        ({"a": {(1, 2): 4}}, "value.a", "the key a tuple is no str"),
        ({"a": 1j}, "value.a", "a complex cannot be sent"),
        ({"a": np.complex64(1j)}, "value.a", "a complex64 cannot be sent"),
        ({"a": np.longdouble(1)}, "value.a", "a longdouble cannot be sent"),
        ({"a": np.datetime64(1, "s")}, "value.a", "a datetime64 cannot be sent"),
        ({"a": msgpack.Timestamp(1)}, "value.a", "time stamp"),
        ({"a": msgpack.ExtType(1, b"")}, "value.a", "extension type 1"),
        ({"a": object}, "value.a", "a type cannot be sent"),
        ({"a": (x for x in "ab")}, "value.a", "a generator cannot be sent"),
        ({"a": "\ud800"}, "value.a", "surrogates not allowed"),
        ({"a": {"\ud800": 1}}, "value.a", "surrogates not allowed"),
        ((1, {"b": 2}, [3, {4}], {5}), "value[2][1]", "a set cannot be sent"),
        ([0] * (MAX_ITEMS + 1), "value", f"{MAX_ITEMS + 1} entries"),
        ([[]] * (MAX_CONTAINERS // 2) + [{}] * (MAX_CONTAINERS // 2 + 1), "value", "tuples and dicts"),
    ],
)
def test_what_cannot_travel_is_named_with_its_path(value: Any, where: str, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        encode_value(value)
    assert raised.value.where == where
    assert what in raised.value.what


def test_nesting_is_limited_alike_in_both_directions() -> None:
    deepest = nested(MAX_DEPTH + 1)
    assert tagged(decode_value(encode_value(deepest))) == deepest
    with pytest.raises(SchemaError, match="nested deeper than 64 levels"):
        encode_value(nested(MAX_DEPTH + 2))
    with pytest.raises(SchemaError, match="nested deeper than 64 levels"):
        decode_value(msgpack.packb(nested(MAX_DEPTH + 2)))


@pytest.mark.parametrize("innermost", [1, (), [], {}, {"k": 1}], ids=repr)
@pytest.mark.parametrize("kinds", ["m", "tm", "mt", "ttm", "o", "tom"])
def test_nesting_counts_containers_of_every_kind(kinds: str, innermost: Any) -> None:
    wrap: dict[str, Callable[[Any], Any]] = {
        "t": lambda value: (value,),
        "m": lambda value: {"k": value},
        "o": lambda value: OrderedDict(k=value),
    }
    own = {"()": 1, "[]": 1, "{}": 1, "{'k': 1}": 1}.get(repr(innermost), 0)
    value = innermost
    for level in range(MAX_DEPTH + 1 - own):
        value = wrap[kinds[level % len(kinds)]](value)
    assert text(decode_value(encode_value(value))) == text(decode_value(msgpack.packb(value)))
    for too_deep in ((value,), {"k": value}):
        with pytest.raises(SchemaError, match="nested deeper than 64 levels"):
            encode_value(too_deep)
        with pytest.raises(SchemaError, match="nested deeper than 64 levels"):
            decode_value(msgpack.packb(too_deep))


@pytest.mark.parametrize("bad", [{3: 4}, msgpack.Timestamp(1), msgpack.ExtType(1, b""), {"k": {b"k": 1}}], ids=repr)
@pytest.mark.parametrize(
    "around",
    [
        lambda bad: bad,
        lambda bad: (0, bad),
        lambda bad: [{"a": 1, "b": bad}],
        lambda bad: {"a": {"b": bad}},
        lambda bad: ({}, (), OrderedDict(a=[bad])),
        lambda bad: Point(0.0, bad),
    ],
)
def test_what_msgpack_would_let_through_is_found_wherever_it_is(around: Callable[[Any], Any], bad: Any) -> None:
    with pytest.raises(SchemaError, match=r"is no str|is no value here"):
        encode_value(around(bad))


def test_maps_are_limited_wherever_they_are() -> None:
    entries = dict.fromkeys(map(str, range(MAX_ITEMS + 1)))
    for value in (entries, (entries,), {"a": entries}):
        with pytest.raises(SchemaError, match=f"{MAX_ITEMS + 1} entries"):
            encode_value(value)


def test_threads_encode_at_the_same_time() -> None:
    def encode(number: int) -> bool:
        value = ({"array": np.full(50, number), "text": str(number) * number},)
        expected = msgpack.packb(str(number) * number)
        return all(encode_value(value).endswith(expected) for _ in range(50))

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(encode, range(64)))


def test_a_value_that_holds_itself_is_refused() -> None:
    value: list[Any] = []
    value += [value, value]
    with pytest.raises(SchemaError, match="nested deeper"):
        encode_value(value)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "not one msgpack value"),
        (b"\xc1", "not one msgpack value"),
        (b"\x01\x02", "extra data"),
        (b"\x92\x01", "not one msgpack value"),
        (b"\xa2\xff\xfe", "utf-8"),
        (b"\xa3\xed\xa0\x80", "utf-8"),
        (b"\x81\x01\x02", "map key"),
        (b"\x81\xc0\x02", "map key"),
        (b"\x81\x90\x02", "map key"),
        (b"\x81\x80\x02", "map key"),
        (b"\x81\xc4\x01k\x02", "no string"),
        (b"\x81\xd6\xff\x00\x00\x00\x01\x02", "map key"),
        (b"\x82\xa1a\x01\xa1a\x02", "a key twice"),
        (b"\xd4\x05\x00", "unknown extension type 5"),
        (b"\xd4\x02\x00", "unknown extension type 2"),
        (b"\xd4\xff\x00", "timestamp"),
        (b"\xd6\xff\x00\x00\x00\x01", "a time stamp"),
        (b"\xd7\xff" + bytes(8), "a time stamp"),
        (b"\xd7\xff" + b"\xff" * 8, "nanoseconds"),
        (b"\xc7\x0c\xff" + bytes(12), "a time stamp"),
        (b"\xc7\x04\xff" + bytes(4), "a time stamp"),
        (b"\xc8\x00\x08\xff" + bytes(8), "a time stamp"),
        (b"\xc9\x00\x00\x00\x04\xff" + bytes(4), "a time stamp"),
        (b"\x91\x81\xa1k\xd6\xff\x00\x00\x00\x01", "a time stamp"),
        (b"\xc7\x00\x01", "too short for an array"),
    ],
)
def test_bad_bytes_are_refused_with_the_reason(data: bytes, what: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_value(data, "belief")
    assert what in raised.value.what
    assert raised.value.where.startswith("belief")


def test_a_fault_inside_names_its_path() -> None:
    with pytest.raises(SchemaError) as raised:
        decode_value(b"\x92\x01\x81\xa1k\xd6\xff\x00\x00\x00\x01", "belief")
    assert raised.value.where == "belief[1].k"


def test_memoryviews_are_read_and_later_changes_do_not_show() -> None:
    buffer = bytearray(encode_value({"a": np.arange(3)}))
    value = decode_value(memoryview(buffer))
    buffer[:] = bytes(len(buffer))
    assert value["a"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("value", ["x" * 10**6, b"x" * 10**6, tuple(range(10**5)), {"a": 1}, 1.5, None])
def test_foreign_values_are_shown_short(value: Any) -> None:
    assert len(shown(value)) < 60


def test_tagging_tells_values_apart() -> None:
    assert json.loads(text((np.arange(2, dtype=">u2"), b"\x01", float("nan"), 1 << 63))) == [
        {"$array": ["<u2", [2], "00000100"]},
        {"$bytes": "01"},
        {"$float": "nan"},
        {"$int": "9223372036854775808"},
    ]


UNLIKE = [
    [1, [2]],
    Point(1.0, 2.0),
    OrderedDict(b=1, a=2),
    np.float64(0.5),
    {"mean": (1, np.float64(0.5))},
    {np.str_("a"): 1},
    (Colour.RED,),
    bytearray(b"ab"),
    {"image": np.zeros((2, 3)).T},
    np.zeros(3, ">f8"),
]


@pytest.mark.parametrize("value", UNLIKE, ids=repr)
def test_what_is_gone_on_with_is_as_its_bytes_have_it(value: Any) -> None:
    settled, read = plain(value), decode_value(encode_value(value))
    assert encode_value(settled) == encode_value(value)
    assert repr(settled) == repr(read)
    assert plain(settled) is settled


LIKE = [None, 1, {"a": (1.0, {"b": b""}), "c": np.zeros((2, 3), np.float32)}, (), np.array(1.0)]


@pytest.mark.parametrize("value", LIKE, ids=repr)
def test_what_is_so_already_is_left_as_it_is(value: Any) -> None:
    assert plain(value) is value


def test_what_cannot_travel_is_left_for_who_sends_it() -> None:
    endless: list[Any] = []
    endless += [endless]
    for value in (object(), {1: 2}, endless, (endless,), {"a": {1, 2}}, 1 << 70):
        assert plain(value) is value
