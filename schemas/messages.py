"""The message that travels along an edge, and its bytes.

A message is one msgpack array that any msgpack library reads::

    [format, kind, sender, receiver, epoch, attempt, roster, instance, time_s, digest,
     extensions, payload]

Arrays inside the payload are extension `ARRAY` (see `hierax.schemas.arrays`). An array of `LARGE_ARRAY_BYTES` or more
is extension `TAIL_ARRAY` in the payload, whose data is its number (unsigned 16 bits, big-endian); the array itself,
extension `ARRAY`, follows the payload as a further element of the message, and after the last one stands the number of
bytes of all that follows the payload (unsigned 32 bits). So large arrays are read in place, without a copy.

Between processes of one machine that have agreed on it, an array behind the payload may be extension `SHARED_ARRAY`
instead: where it lies in shared memory of the sender's (see `hierax.runtime.transport.shared_arrays`), in whatever form
the two agree on. Only the two of them can read such a message, and it counts as what it stands for."""

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import msgpack
import numpy as np

from hierax.schemas.arrays import ARRAY, array_elements, array_head, check_array, decode_array
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.limits import LARGE_ARRAY_BYTES, MAX_EXTENSIONS, MAX_MESSAGE_BYTES, MAX_NAME_CHARS, MAX_PLAIN_BYTES
from hierax.schemas.values import Packers, Value, array_in_place, fault, is_sound, pack, read_extension, unpack

FORMAT = 1
TAIL_ARRAY = 2
SHARED_ARRAY = 3

Lend = Callable[[np.ndarray[Any, Any]], bytes | None]
"""Puts an array where its receiver can read it, and gives what the receiver needs to find it; None: it cannot."""

Borrow = Callable[[bytes], np.ndarray[Any, Any]]
"""Gives the array that `Lend` gave these bytes for, read-only. Raises `SchemaError` if there is none."""

OBSERVATIONS = "obs"
TASKS = "task"
CONTEXT = "ctx"
HELLO = "hello"
EDGE_KINDS = (OBSERVATIONS, TASKS, CONTEXT)
KINDS = (*EDGE_KINDS, HELLO)

DRAIN = "drain"
"""The header's extension of observations, where epochs overlap: this one does not, at its end every node is done."""

GREETING = 0  # the epoch of a message that says nothing but that its sender is there

DIGEST_BYTES = 32
NO_EXTENSIONS: Mapping[str, Value] = {}

_KIND_CODES = {kind: code for code, kind in enumerate(KINDS)}
_NAMES = (
    *("format", "kind", "sender", "receiver", "epoch", "attempt", "roster", "instance"),
    *("time_s", "digest", "extensions", "payload"),
)
_TYPES = (int, int, str, str, int, int, int, int, float, bytes, dict, tuple)
TYPE_NAMES = {
    int: "a whole number",
    bool: "true or false",
    str: "a string",
    float: "a float",
    bytes: "bytes",
    dict: "a map",
    tuple: "an array of elements",
}
_new = tuple.__new__
_FIELD_COUNT, _KIND_COUNT = len(_NAMES), len(KINDS)
_FIXARRAY = bytes([0x90 | _FIELD_COUNT])
_ARRAY16 = struct.Struct(">BH")
_EXT32 = struct.Struct(">BIb")
_TAIL_BYTES = struct.Struct(">BI")
_INDEX = struct.Struct(">H")


class Header(NamedTuple):
    """What every message says of itself.

    Attributes:
        kind: one of `KINDS`.
        sender, receiver: names of the nodes; the message travels along their edge.
        epoch: counts from 1.
        attempt: how often the epoch has been begun, from 0.
        roster: version of the roster that the sender is in.
        instance: the sender's instance number, new at every start of its process.
        time_s: the epoch's time in seconds, as the world set it.
        digest: the sender's digest of the epoch (downward messages), else empty.
        extensions: open map; unknown keys are kept.
    """

    kind: str
    sender: str
    receiver: str
    epoch: int
    attempt: int = 0
    roster: int = 0
    instance: int = 0
    time_s: float = 0.0
    digest: bytes = b""
    extensions: Mapping[str, Value] = NO_EXTENSIONS

    @property
    def when(self) -> tuple[int, int]:
        """The epoch and the attempt of it."""
        return self.epoch, self.attempt

    @property
    def line(self) -> tuple[str, str, str]:
        """Kind, sender and receiver."""
        return self.kind, self.sender, self.receiver


class Message(NamedTuple):
    """A header and the elements: observations, task parameters or context."""

    header: Header
    payload: tuple[Value, ...]


class SaidMessage(Message):
    """A message that is written down and sent: its bytes are made once. What `_replace` makes of it has none yet."""

    data: bytes = b""  # empty: not yet made

    def keep_encoded(self) -> bytes:
        """Its bytes. Raises `SchemaError` as `encode_message` does."""
        if not self.data:
            self.data = encode_message(self)
        return self.data


def encode_message(message: Message, lend: Lend | None = None) -> bytes:
    """The bytes of a message, with large arrays lent where `lend` can. Raises `SchemaError` if the payload holds
    something that cannot travel."""
    if type(message) is SaidMessage and message.data and (lend is None or len(message.data) < LARGE_ARRAY_BYTES):
        return message.data  # nothing in it is large enough to be lent
    (kind, sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions), payload = message
    code = _KIND_CODES[kind]
    fields = (FORMAT, code, sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions, payload)
    if not is_sound(payload, 1) or (extensions and not is_sound(extensions, 1)):
        raise fault(fields, "message", _NAMES)
    try:
        packed = pack(fields, _PACKERS, "message", _NAMES)
    except _LargeArray:
        return _encode_large(fields, lend)
    if len(packed) > MAX_PLAIN_BYTES:
        raise _too_plain(len(packed))
    return packed


class _LargeArray(Exception):  # noqa: N818 - no error: the other way of encoding is wanted
    """An array is too large to be encoded in place."""


def _in_place(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.nbytes >= LARGE_ARRAY_BYTES:
        raise _LargeArray
    return array_in_place(value)


_PACKERS = Packers(_in_place)


def _encode_large(fields: tuple[Value, ...], lend: Lend | None) -> bytes:
    tail = _Tail()
    packed = pack(fields, Packers(tail.default), "message", _NAMES)
    if len(packed) > MAX_PLAIN_BYTES:
        raise _too_plain(len(packed))
    data = _with_tail(packed, tail.arrays, lend)
    if len(data) > MAX_MESSAGE_BYTES:
        raise SchemaError(f"has {len(data)} bytes; at most {MAX_MESSAGE_BYTES} are allowed", "message")
    return data


def decode_message(data: bytes, borrow: Borrow | None = None) -> Message:
    """Read a message, whose large arrays are read-only views of `data`, or of what `borrow` finds. Raises `SchemaError`
    if it is none."""
    if data[:1] == _FIXARRAY:
        if len(data) > MAX_PLAIN_BYTES:
            raise _too_plain(len(data))
        fields = unpack(data, read_extension, "message", _NAMES)
    elif data[:1] == b"\xdc":
        fields = _split_tail(data, borrow)
    else:
        raise SchemaError(f"does not begin like a message: {data[:4].hex() or 'empty'}", "message")
    return _message(fields)


class _Tail:
    """Takes the large arrays out of a payload while it is packed."""

    def __init__(self) -> None:
        self.arrays: list[np.ndarray[Any, Any]] = []
        self._left = MAX_MESSAGE_BYTES

    def default(self, value: Any) -> Any:
        if not isinstance(value, np.ndarray) or value.nbytes < LARGE_ARRAY_BYTES:
            return _in_place(value)
        check_array(value)
        self._left -= value.nbytes
        if self._left < 0:
            raise SchemaError(f"its arrays have more than the {MAX_MESSAGE_BYTES} bytes that are allowed")
        self.arrays.append(value)
        return msgpack.ExtType(TAIL_ARRAY, _INDEX.pack(len(self.arrays) - 1))


def _with_tail(packed: bytes, large: list[np.ndarray[Any, Any]], lend: Lend | None) -> bytes:
    parts: list[bytes | memoryview] = [_ARRAY16.pack(0xDC, _FIELD_COUNT + len(large) + 1), packed[1:]]
    start = offset = _ARRAY16.size + len(packed) - 1
    for array in large:
        place = None if lend is None else lend(array)
        if place is None:
            head = array_head(array, offset + _EXT32.size)
            length = len(head) + array.nbytes
            parts += (_EXT32.pack(0xC9, length, ARRAY), head, array_elements(array))
        else:
            length = len(place)
            parts += (_EXT32.pack(0xC9, length, SHARED_ARRAY), place)
        offset += _EXT32.size + length
    parts.append(_TAIL_BYTES.pack(0xCE, offset + _TAIL_BYTES.size - start))
    return b"".join(parts)


def _tail_of(data: bytes) -> tuple[int, int]:
    """Where the arrays behind the payload begin, and how many they are."""
    if len(data) < _ARRAY16.size + _TAIL_BYTES.size:
        raise SchemaError(f"{len(data)} bytes are too short", "message")
    count = _ARRAY16.unpack_from(data)[1] - _FIELD_COUNT - 1
    marker, tail_bytes = _TAIL_BYTES.unpack_from(data, len(data) - _TAIL_BYTES.size)
    start = len(data) - tail_bytes
    if marker != 0xCE or count < 1 or start < _ARRAY16.size or tail_bytes < _TAIL_BYTES.size:
        raise SchemaError("the arrays behind the payload are not laid out as expected", "message")
    return start, count


def _split_tail(data: bytes, borrow: Borrow | None) -> tuple[Value, ...]:
    start, count = _tail_of(data)
    if start > MAX_PLAIN_BYTES:
        raise _too_plain(start)
    arrays = []
    for index, (code, content) in enumerate(_behind(memoryview(data).toreadonly(), start, count)):
        where = f"message: array {index} behind the payload"
        if code == ARRAY:
            arrays.append(decode_array(content, where))
        elif borrow is None:
            raise SchemaError("it lies in shared memory of its sender's, which is not read here", where)
        else:
            arrays.append(borrow(bytes(content)))
    unused = set(range(count))

    def resolve(code: int, content: bytes) -> Value:
        if code != TAIL_ARRAY:
            return read_extension(code, content)
        index = _INDEX.unpack(content)[0] if len(content) == _INDEX.size else count
        if index not in unused:
            raise SchemaError(f"refers to array {content[:8].hex()} behind the payload, which is not there or taken")
        unused.remove(index)
        return arrays[index]

    fields: tuple[Value, ...] = unpack(_FIXARRAY + data[_ARRAY16.size : start], resolve, "message", _NAMES)
    if unused:
        raise SchemaError(f"nothing refers to {len(unused)} of the arrays behind the payload", "message")
    return fields


def is_lent(data: bytes) -> bool:
    """Whether arrays of a message lie elsewhere. Raises `SchemaError` if it is none."""
    if data[:1] != b"\xdc":
        return False
    return any(code == SHARED_ARRAY for code, _ in _behind(memoryview(data), *_tail_of(data)))


def _behind(view: memoryview, offset: int, count: int) -> Iterator[tuple[int, memoryview]]:
    """Codes and contents of the extensions behind the payload."""
    end = len(view) - _TAIL_BYTES.size
    for index in range(count):
        where = f"message: array {index} behind the payload"
        if offset + _EXT32.size > end:
            raise SchemaError("cut off", where)
        marker, length, code = _EXT32.unpack_from(view, offset)
        offset += _EXT32.size
        if marker != 0xC9 or code not in (ARRAY, SHARED_ARRAY) or offset + length > end:
            raise SchemaError("not an array extension, or cut off", where)
        yield code, view[offset : offset + length]
        offset += length
    if offset != end:
        raise SchemaError(f"{end - offset} bytes too many behind the payload", "message")


def _message(fields: Any) -> Message:
    if type(fields) is not tuple or len(fields) != _FIELD_COUNT:
        raise SchemaError(f"expected an array of {_FIELD_COUNT} fields", "message")
    form, kind, sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions, payload = fields
    if not (
        type(form) is int
        and type(kind) is int
        and type(sender) is str
        and type(receiver) is str
        and type(epoch) is int
        and type(attempt) is int
        and type(roster) is int
        and type(instance) is int
        and type(time_s) is float
        and type(digest) is bytes
        and type(extensions) is dict
        and type(payload) is tuple
        and form == FORMAT
        and 0 <= kind < _KIND_COUNT
        and 0 < len(sender) <= MAX_NAME_CHARS
        and 0 < len(receiver) <= MAX_NAME_CHARS
        and epoch >= 0
        and attempt >= 0
        and roster >= 0
        and instance >= 0
        and (not digest or len(digest) == DIGEST_BYTES)
        and (not extensions or len(extensions) <= MAX_EXTENSIONS)
    ):
        raise _wrong_field(fields)
    # the named tuples' own constructors take twice as long
    header = _new(Header, (KINDS[kind], sender, receiver, epoch, attempt, roster, instance, time_s, digest, extensions))
    return _new(Message, (header, payload))


def _too_plain(size: int) -> SchemaError:
    what = f"has {size} bytes besides arrays of {LARGE_ARRAY_BYTES} bytes and more; at most {MAX_PLAIN_BYTES}"
    return SchemaError(f"{what} are allowed; use arrays", "message")


def _wrong_field(fields: tuple[Value, ...]) -> SchemaError:
    for name, expected, field in zip(_NAMES, _TYPES, fields, strict=True):
        if type(field) is not expected:
            return SchemaError(f"expected {TYPE_NAMES[expected]}, got {shown(field)}", f"message.{name}")
    form, kind, sender, receiver, epoch, attempt, roster, instance, _, digest, extensions, _ = fields
    if form != FORMAT:
        return SchemaError(f"format {form}; this version reads format {FORMAT}", "message.format")
    if not 0 <= kind < _KIND_COUNT:
        return SchemaError(f"unknown kind {kind}; expected 0 to {_KIND_COUNT - 1}", "message.kind")
    if not (0 < len(sender) <= MAX_NAME_CHARS and 0 < len(receiver) <= MAX_NAME_CHARS):
        return SchemaError(f"expected names of 1 to {MAX_NAME_CHARS} characters", "message.sender, message.receiver")
    if min(epoch, attempt, roster, instance) < 0:
        return SchemaError("expected whole numbers from 0", "message.epoch, .attempt, .roster, .instance")
    if len(digest) not in (0, DIGEST_BYTES):
        return SchemaError(f"expected no or {DIGEST_BYTES} bytes, got {len(digest)}", "message.digest")
    return SchemaError(f"expected at most {MAX_EXTENSIONS} entries, got {len(extensions)}", "message.extensions")
