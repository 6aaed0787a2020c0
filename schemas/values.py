"""Values: what beliefs, actions, observations, task parameters and context are made of.

A value is None, a bool, an int of 64 bits, a float, a str, bytes, a tuple or list of
values, a dict from str to values, or a numpy array of numbers or bools. One value has
one encoding (a dict keeps its order); a list comes back as a tuple, a numpy scalar as
a Python number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np

from hierax.schemas.arrays import ARRAY, decode_array, encode_array
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_DEPTH, MAX_ITEMS, MAX_MESSAGE_BYTES

Value = Any
ExtHook = Callable[[int, bytes], Value]

_PRESCAN_BYTES = 4096
_PLAIN_BYTES = bytes(b for b in range(256) if not (0x80 <= b <= 0x9F or 0xDC <= b <= 0xDF))
_TIMESTAMP_HEADS = (b"\xd6\xff", b"\xd7\xff", b"\xc7\x0c\xff")


def encode_value(value: Value) -> bytes:
    """The one encoding of a value: what digests are taken over and checkpoints hold.

    Raises:
        SchemaError: the value holds something that cannot travel; it says where and what.
    """
    return pack(value, _array_in_place)


def decode_value(data: bytes | memoryview, where: str = "value") -> Value:
    """Read what `encode_value` wrote.

    Raises:
        SchemaError: the bytes are not exactly one value.
    """
    return unpack(data, _ext_in_place, where)


def pack(value: Value, default: Callable[[Any], Any]) -> bytes:
    """Pack a value with `default` for what msgpack does not know, errors mapped."""
    try:
        packed: bytes = msgpack.packb(value, default=default)
    except SchemaError as error:
        raise SchemaError(error.what, _first_fault(value) or error.where) from error
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise SchemaError(f"cannot be sent: {error}", _first_fault(value)) from error
    return packed


def unpack(data: bytes | memoryview, ext_hook: ExtHook, where: str) -> Value:
    """Unpack exactly one value; memory stays in proportion to `data`."""
    if len(data) > MAX_MESSAGE_BYTES:
        raise SchemaError(f"{len(data)} bytes; at most {MAX_MESSAGE_BYTES} are allowed", where)
    data = bytes(data)
    try:
        if len(data) > _PRESCAN_BYTES:
            _prescan(data)
        value = msgpack.unpackb(
            data,
            use_list=False,
            ext_hook=ext_hook,
            object_pairs_hook=_mapping,
            max_array_len=min(len(data), MAX_ITEMS),
            max_map_len=min(len(data), MAX_ITEMS),
        )
    except SchemaError as error:
        raise SchemaError(error.what, f"{where}: {error.where}" if error.where else where) from error
    except (ValueError, TypeError, OverflowError, msgpack.exceptions.UnpackException) as error:
        raise SchemaError(f"not one msgpack value: {error or type(error).__name__}", where) from error
    _check_contents(data, value, where)
    return value


def replace_numpy(value: Any) -> Any:
    """A numpy scalar as a Python number.

    Raises:
        SchemaError: it is something else that cannot travel.
    """
    if isinstance(value, np.generic):
        plain = value.item()
        if isinstance(plain, (bool, int, float)):
            return plain
    raise SchemaError(f"a {type(value).__name__} cannot be sent; see hierax.schemas.values for what can")


def _array_in_place(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return msgpack.ExtType(ARRAY, encode_array(value))
    return replace_numpy(value)


def _ext_in_place(code: int, data: bytes) -> Value:
    if code == ARRAY:
        return decode_array(data)
    raise SchemaError(f"unknown extension type {code}; expected {ARRAY} (an array)")


def _mapping(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise SchemaError("a map holds a key twice")
    if not all(type(key) is str for key in result):
        raise SchemaError("a map holds a key that is no string")
    return result


def _prescan(data: bytes) -> None:
    """Walk the structure without building it: lengths that lie end here, before they take memory."""
    unpacker = msgpack.Unpacker(max_buffer_size=len(data))
    unpacker.feed(data)
    unpacker.skip()


def _check_contents(data: bytes, value: Value, where: str) -> None:
    """What msgpack lets through and we don't: deep nesting and time stamps."""
    deep = len(data.translate(None, _PLAIN_BYTES)) > MAX_DEPTH
    stamped = any(head in data for head in _TIMESTAMP_HEADS)
    if not (deep or stamped):
        return
    for path, depth, item in _walk(value):
        if depth > MAX_DEPTH:
            raise SchemaError(f"nested deeper than {MAX_DEPTH} levels", where)
        if isinstance(item, msgpack.Timestamp):
            raise SchemaError("a time stamp, which is no value here", f"{where}{path}")


def _walk(value: Value) -> Iterator[tuple[str, int, Any]]:
    """Every part of a value with its path and depth, without recursion."""
    stack: list[tuple[str, int, Any]] = [("", 0, value)]
    while stack:
        path, depth, item = stack.pop()
        yield path, depth, item
        if depth > MAX_DEPTH:
            continue
        if isinstance(item, dict):
            stack.extend((f"{path}.{key}", depth + 1, part) for key, part in item.items())
        elif isinstance(item, (tuple, list)):
            stack.extend((f"{path}[{index}]", depth + 1, part) for index, part in enumerate(item))


def _first_fault(value: Value) -> str:
    """The path of the part that cannot be packed by itself, for the error."""
    for path, depth, item in _walk(value):
        if depth > MAX_DEPTH:
            return path[:80] + "…"
        if isinstance(item, (dict, tuple, list)):
            continue
        try:
            msgpack.packb(item, default=_array_in_place)
        except (ValueError, TypeError, OverflowError):
            return path
    return ""
