"""Values: what beliefs, actions, observations, task parameters and context are made of.

A value is None, a bool, an int of 64 bits, a float, a str, bytes, a tuple or list of values, a dict from str to values,
or a numpy array of numbers or bools. One value has one encoding (a dict keeps its order); a list or named tuple comes
back as a tuple, a numpy scalar as a Python number."""

from collections.abc import Callable, Collection, Iterator
from types import NoneType
from typing import Any, get_args, get_origin

import msgpack
import numpy as np

from hierax.schemas.arrays import ARRAY, check_array, decode_array, encode_array
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.limits import MAX_CONTAINERS, MAX_DEPTH, MAX_ENTRIES, MAX_ITEMS, MAX_MESSAGE_BYTES

Value = Any
ExtHook = Callable[[int, bytes], Value]
Names = tuple[str, ...]
Types = frozenset[type]

SENDABLE = "None, bool, int, float, str, bytes, and tuples, lists, dicts and arrays of such"
"""For errors: what a value is."""

_PRESCAN_BYTES = 1024
_PATH_CHARS = 200
_KEPT_BYTES = 1 << 16
_SURE = frozenset({NoneType, bool, float, bytes})
_CONTAINER = 1
_MARKS = bytes(_CONTAINER * (0x80 <= byte <= 0x9F or 0xDC <= byte <= 0xDF) for byte in range(256))
_STAMP = 0xFF
_PLAIN = _SURE | {int, str}
_LEAVES = _PLAIN | {np.ndarray}
_NOTHING = ()

_unpackb = msgpack.unpackb


class Packers:
    """Packers kept for reuse, as one takes longer to make than to pack with; `default` as msgpack has it."""

    def __init__(self, default: Callable[[Any], Any]) -> None:
        self._default = default
        self.idle: list[Any] = []

    def new(self) -> Any:
        """A packer, to be put among the idle ones after use."""
        return msgpack.Packer(default=self._default)


def encode_value(value: Value) -> bytes:
    """The one encoding of a value, also for digests and checkpoints. Raises `SchemaError` saying what cannot travel."""
    if not is_sound(value, 0):
        raise fault(value, "value", ())
    return pack(value, PACKERS)


def encode_frozen(value: Value) -> bytes:
    """Do as `encode_value` does; and nobody can write into the value's arrays any more."""
    if not is_sound(value, 0):
        raise fault(value, "value", ())
    return pack(value, _FREEZING)


def decode_value(data: bytes | memoryview, where: str = "value") -> Value:
    """Read what `encode_value` wrote. Raises `SchemaError` if the bytes are not exactly one value."""
    return unpack(data, read_extension, where)


def pack(value: Value, packers: Packers, where: str = "value", names: Names = ()) -> bytes:
    """Pack a value that `is_sound`, by packers that know what to do with what msgpack does not know. In errors it is
    called `where`, and its entries, where it is a tuple, `names`. Raises `SchemaError` if something cannot travel; says
    where and what."""
    idle = packers.idle
    try:
        packer = idle.pop()
    except IndexError:  # asking first would be too early: other threads take packers, too
        packer = packers.new()
    try:
        packed: bytes = packer.pack(value)
    except SchemaError as error:
        raise fault(value, where, names, _SURE, error.what) from error
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise fault(value, where, names, _SURE, f"cannot be sent: {error}") from error
    if len(packed) <= _KEPT_BYTES:  # a packer's buffer stays as large as its largest value was
        idle.append(packer)
        return packed
    if len(packed) > MAX_MESSAGE_BYTES:
        raise SchemaError(f"has {len(packed)} bytes; at most {MAX_MESSAGE_BYTES} are allowed", where)
    if len(packed) > MAX_CONTAINERS:
        entries = [len(item) for _, _, item in _walk("", 0, value, _LEAVES) if isinstance(item, (dict, tuple, list))]
        if len(entries) > MAX_CONTAINERS:
            raise SchemaError(f"has more than {MAX_CONTAINERS} tuples and dicts; use arrays", where)
        if sum(entries) > MAX_ENTRIES:
            raise SchemaError(f"its tuples and dicts have more than {MAX_ENTRIES} entries; use arrays", where)
    return packed


def unpack(data: bytes | memoryview, ext_hook: ExtHook, where: str, names: Names = ()) -> Value:
    """Unpack exactly one value; memory stays in proportion to `data`. `ext_hook` reads extension types. `where` and
    `names` are as `pack` has them. Raises `SchemaError` if the bytes are not exactly one value."""
    size = len(data)
    if size > MAX_MESSAGE_BYTES:
        raise SchemaError(f"{size} bytes; at most {MAX_MESSAGE_BYTES} are allowed", where)
    if type(data) is not bytes:
        data = bytes(data)
    try:
        if size <= _PRESCAN_BYTES:
            value = _unpackb(data, use_list=False, ext_hook=ext_hook, object_pairs_hook=_mapping)
        else:
            value = _unpack_large(data, ext_hook)
    except SchemaError as error:
        raise SchemaError(error.what, f"{where}: {error.where}" if error.where else where) from error
    except (ValueError, TypeError, OverflowError, msgpack.exceptions.UnpackException) as error:
        raise SchemaError(f"not one msgpack value: {str(error) or type(error).__name__}", where) from error
    # A time stamp, extension type -1, has the byte 255 somewhere, and deep nesting takes many
    # containers. Either may be there for a better reason: then a second look tells.
    suspect = _STAMP in data or (size > MAX_DEPTH and data.translate(_MARKS).count(_CONTAINER) > MAX_DEPTH)
    if suspect and not is_sound(value, 0):
        raise fault(value, where, names)
    return value


def _unpack_large(data: bytes, ext_hook: ExtHook) -> Value:
    """Unpack what is large enough to lie about lengths, or to hold too many containers."""
    unpacker = msgpack.Unpacker(max_buffer_size=len(data))
    unpacker.feed(data)
    unpacker.skip()  # walks the structure without building it: lengths that lie end here, before they take memory
    hooks = _Hooks() if len(data) > MAX_CONTAINERS else None
    return msgpack.unpackb(
        data,
        use_list=False,
        ext_hook=ext_hook,
        object_pairs_hook=hooks.mapping if hooks else _mapping,
        list_hook=hooks.array if hooks else None,
        max_array_len=min(len(data), MAX_ITEMS),
        max_map_len=min(len(data), MAX_ITEMS),
    )


def replace_numpy(value: Any) -> Any:
    """A numpy scalar as a Python number. Raises `SchemaError` if it is something else that cannot travel."""
    if isinstance(value, np.generic):
        plain = value.item()
        if isinstance(plain, (bool, int, float)):
            return plain
    if isinstance(value, int):
        raise SchemaError("an int of more than 64 bits cannot be sent")
    raise SchemaError(f"a {type(value).__name__} cannot be sent; {SENDABLE} can")


def array_in_place(value: Any) -> Any:
    """What msgpack does not know, as what it does: an array as extension `ARRAY`. Raises `SchemaError` for the rest."""
    if isinstance(value, np.ndarray):
        return msgpack.ExtType(ARRAY, encode_array(value))
    return replace_numpy(value)


def _frozen_in_place(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    return array_in_place(value)


PACKERS = Packers(array_in_place)
_FREEZING = Packers(_frozen_in_place)


def read_extension(code: int, data: bytes) -> Value:
    """The array that extension `ARRAY` holds. Raises `SchemaError` if it is another extension, or no array."""
    if code == ARRAY:
        return decode_array(data)
    raise SchemaError(f"unknown extension type {code}; expected {ARRAY} (an array)")


def _mapping(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    if not pairs:  # the extensions of nearly every header
        return {}
    if len(pairs) == 1:  # a small payload
        key, value = pairs[0]
        if type(key) is str:
            return {key: value}
    result = dict(pairs)
    if len(result) != len(pairs):
        raise SchemaError("a map holds a key twice")
    for key in result:
        if type(key) is not str:
            raise SchemaError("a map holds a key that is no string")
    return result


class _Hooks:
    """Counts arrays, maps and their entries while they are built; only data that is large can hold too many."""

    def __init__(self) -> None:
        self._left = MAX_CONTAINERS
        self._entries_left = MAX_ENTRIES

    def mapping(self, pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
        self._count(len(pairs))
        return _mapping(pairs)

    def array(self, items: tuple[Any, ...]) -> tuple[Any, ...]:
        self._count(len(items))
        return items

    def _count(self, entries: int) -> None:
        self._left -= 1
        self._entries_left -= entries
        if self._left < 0:
            raise SchemaError(f"more than {MAX_CONTAINERS} arrays and maps")
        if self._entries_left < 0:
            raise SchemaError(f"more than {MAX_ENTRIES} entries of arrays and maps")


def is_sound(value: Any, depth: int) -> bool:
    """What msgpack lets through and we don't, in either direction; `_flaw` says what. Runs for every message and state:
    maps are looked into from where they stand, as a call takes longer."""
    kind = type(value)
    if kind is tuple or kind is list:
        parts: Collection[Any] = value
    elif kind is dict or isinstance(value, dict):
        if not _are_keys(value):
            return False
        parts = value.values()
    elif isinstance(value, (tuple, list)) and not isinstance(value, msgpack.ExtType):
        parts = value
    else:
        return not isinstance(value, (msgpack.Timestamp, msgpack.ExtType))
    if depth >= MAX_DEPTH or len(parts) > MAX_ITEMS:  # what is as deep as may be holds nothing that holds something
        leaves = (type(part) in _LEAVES or is_sound(part, MAX_DEPTH + 1) for part in parts)
        return depth == MAX_DEPTH and len(parts) <= MAX_ITEMS and all(leaves)
    for part in parts:
        kind = type(part)
        if kind in _LEAVES or part is _NOTHING:
            continue
        if kind is dict and len(part) <= MAX_ITEMS:
            for key, entry in part.items():
                if type(key) is not str and not isinstance(key, str):
                    return False
                if type(entry) not in _LEAVES and not is_sound(entry, depth + 2):
                    return False
        elif not is_sound(part, depth + 1):
            return False
    return True


def plain(value: Value) -> Value:
    """A value as whoever has read its bytes has it, so that it makes no difference who goes on with it; what cannot
    travel as it is: that is told where it is sent.

    A number of numpy's is a Python number then, which takes another part in numpy's choice of dtypes; and an array that
    had another order may add up to another sum."""
    if _is_plain(value, 0):
        return value
    try:
        return decode_value(encode_value(value))
    except SchemaError:
        return value


def _is_plain(value: Value, depth: int) -> bool:
    kind = type(value)
    if kind is dict:
        parts: Collection[Any] = value.values()
        for key in value:  # a generator takes three times as long
            if type(key) is not str:
                return False
    elif kind is tuple:
        parts = value
    else:
        return kind in _PLAIN or (kind is np.ndarray and value.flags.c_contiguous and value.dtype.isnative)
    for part in parts:
        if type(part) not in _PLAIN and (depth > MAX_DEPTH or not _is_plain(part, depth + 1)):
            return False
    return True


def fits(value: Value, hint: Any) -> bool:
    """Whether a value that was read is of a type: of a plain one, `Value`, or tuples and dicts of such."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is tuple:
        kinds = inner[:1] * len(value) if type(value) is tuple and inner[-1] is Ellipsis else inner
        return type(value) is tuple and len(value) == len(kinds) and all(map(fits, value, kinds))
    if origin is dict:
        return type(value) is dict and all(fits(part, inner[1]) for part in value.values())
    return hint is Value or type(value) is hint


def _are_keys(names: Collection[Any]) -> bool:
    for name in names:  # noqa: SIM110 - a loop takes half the time of all()
        if type(name) is not str and not isinstance(name, str):
            return False
    return True


def _flaw(item: Any, depth: int) -> str:
    """Why a part, apart from what it holds, cannot travel; empty where it can."""
    if isinstance(item, msgpack.Timestamp):
        return "a time stamp is no value here"
    if isinstance(item, msgpack.ExtType):
        return f"extension type {item.code} is no value here"
    if isinstance(item, (dict, tuple, list)):
        if depth > MAX_DEPTH:
            return f"nested deeper than {MAX_DEPTH} levels"
        if len(item) > MAX_ITEMS:
            return f"{len(item)} entries; at most {MAX_ITEMS} are allowed"
        keys = (_key_flaw(key) for key in item) if isinstance(item, dict) else ()
        return next(filter(None, keys), "")
    try:
        if isinstance(item, np.ndarray):
            check_array(item)
        else:
            msgpack.packb(item, default=replace_numpy)
    except SchemaError as error:
        return error.what
    except (ValueError, TypeError, OverflowError) as error:
        return f"cannot be sent: {error}"
    return ""


def _key_flaw(key: Any) -> str:
    if not isinstance(key, str):
        return f"the key {shown(key)} is no str"
    try:
        key.encode()
    except UnicodeEncodeError as error:
        return f"the key {shown(key)} cannot be sent: {error}"
    return ""


def fault(value: Value, where: str, names: Names, sure: Types = _LEAVES, otherwise: str = "") -> SchemaError:
    """The first part that cannot travel, as an error; `value`, `where` and `names` as `pack` has them. Parts of `sure`
    types need no look; `otherwise` is said of the whole if nothing is found."""
    named = type(value) is tuple and len(value) == len(names)
    roots = zip(names, value, strict=True) if named else [(where, value)]
    for name, root in roots:
        for path, depth, item in _walk(name, int(named), root, sure):
            flaw = _flaw(item, depth)
            if flaw:
                return SchemaError(flaw, path if len(path) <= _PATH_CHARS else path[:_PATH_CHARS] + "…")
    return SchemaError(otherwise, where)


def _walk(path: str, depth: int, value: Value, sure: Types) -> Iterator[tuple[str, int, Any]]:
    """A value and its parts, but those of `sure` types, with path and depth, in order."""
    yield path, depth, value
    if depth > MAX_DEPTH:
        return
    if isinstance(value, dict):
        for key, part in value.items():
            if type(part) not in sure:
                yield from _walk(f"{path}.{key}", depth + 1, part, sure)
    elif isinstance(value, (tuple, list)):
        for index, part in enumerate(value):
            if type(part) not in sure:
                yield from _walk(f"{path}[{index}]", depth + 1, part, sure)
