"""What is on which key, how it is read, and how it is described in the file; and what of a run is recorded."""

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any, NamedTuple, get_origin, get_type_hints

import msgpack

from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RecordingError
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.messages import EDGE_KINDS, KINDS, Header, Message, decode_message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep, decode_step
from hierax.schemas.values import decode_value

MESSAGE, STEP, ROSTER, EPOCH, NOTE, CONTROL, TOKEN = "message", "step", "roster", "epoch", "note", "control", "token"
"""What there is in a recording."""

_BY_SEGMENT = {"steps": STEP, "roster": ROSTER, "epochs": EPOCH, "notes": NOTE, "alive": TOKEN}
_BY_SEGMENT |= {"control": CONTROL, "words": CONTROL}  # what processes, and the roster's owner, are told
_ROOT_SEGMENTS = 3
LEAVABLE = ("obs", "task", "ctx", "steps", "notes", "control", "words", "alive")
"""What a key begins with that may be left out; the roster and the digests are always recorded."""

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kMGT]?)(i?)B?")
_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*([smhd]?)")
_POWERS = {"": 0, "k": 1, "M": 2, "G": 3, "T": 4}
_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


class Topic(NamedTuple):
    """A key, taken apart."""

    what: str  # one of `MESSAGE` to `TOKEN`
    kind: str  # of a message, one of obs, task and ctx; else empty
    names: tuple[str, ...]  # what stands behind: sender and receiver, a node, an address, a node and its process


@lru_cache(maxsize=4096)
def topic_of(key: str) -> Topic | None:
    """A key of a run, taken apart; None: nothing that is recorded."""
    segments = key.split("/")
    if len(segments) <= _ROOT_SEGMENTS:
        return None
    head, *names = segments[_ROOT_SEGMENTS:]
    if head in EDGE_KINDS:
        return Topic(MESSAGE, head, tuple(names)) if len(names) == 2 else None
    what = _BY_SEGMENT.get(head)
    return None if what is None else Topic(what, "", tuple(names))


def glance(data: bytes) -> tuple[Header, int]:
    """A message's header, and where the payload begins; `SchemaError` if it begins otherwise."""
    unpacker = msgpack.Unpacker()
    unpacker.feed(data[:_GLANCED_BYTES])
    try:
        unpacker.read_array_header()
        unpack = unpacker.unpack
        unpack()  # the format
        code, *fields = unpack(), unpack(), unpack(), unpack(), unpack(), unpack(), unpack(), unpack(), unpack()
        fields.append(unpack())  # the extensions
        if tuple(map(type, (code, *fields))) != _HEAD or min(code, *fields[2:6]) < 0:
            raise ValueError("another one is not so typed")
        return Header(KINDS[code], *fields), unpacker.tell()
    except (ValueError, TypeError, IndexError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise SchemaError(f"does not begin like a message: {data[:8].hex()}", "message") from error


class Entry(NamedTuple):
    """Something that was recorded."""

    key: str  # on which it came
    topic: Topic  # that key, taken apart
    time_ns: int  # when, since 1970
    epoch: int  # of it, modulo 2³²; 0: of none
    data: bytes

    def message(self) -> Message:
        """The message that it is. Raises `SchemaError` if it is none."""
        return decode_message(self.data)

    def step(self) -> NodeStep:
        """The step that it is. Raises `SchemaError` if it is none."""
        return decode_step(self.data)

    def roster(self) -> Roster:
        """The roster that it is. Raises `SchemaError` if it is none."""
        return Roster.read(decode_value(self.data, "roster"))

    def commit(self) -> tuple[int, bytes]:
        """The epoch and the run's digest that it tells. Raises `SchemaError` if it tells none."""
        value = decode_value(self.data, "epoch")
        if type(value) is not tuple or tuple(map(type, value)) != (int, bytes) or value[0] < 0:
            raise SchemaError(f"expected an epoch's number and digest, got {shown(value)}", "epoch")
        return value

    def fault(self) -> "Fault":
        """What happened to a process. Raises `SchemaError` if it tells nothing of the kind."""
        value = decode_value(self.data, self.topic.what)
        if self.topic.what == NOTE:
            if type(value) is not str:
                raise SchemaError(f"expected a text, got {shown(value)}", "note")
            return Fault(self.time_ns, value)
        if type(value) is not tuple or tuple(map(type, value)) != (str, str, bool):
            raise SchemaError(f"expected a node, its process and whether it is there, got {shown(value)}", "token")
        name, process, up = value
        return Fault(self.time_ns, f"process {process} {'is there' if up else 'is gone'}", name)


class Fault(NamedTuple):
    """Something that happened to a process, in words, and when, since 1970. Without a node the words say whose."""

    time_ns: int
    what: str
    node: str = ""


_GLANCED_BYTES = 4096
_HEAD = (int, str, str, int, int, int, int, float, bytes, dict)
_WHOLE: dict[str, Any] = {"type": "integer", "minimum": 0}
_TEXT: dict[str, Any] = {"type": "string"}
_BOOLEAN: dict[str, Any] = {"type": "boolean"}
_BYTES: dict[str, Any] = {"description": "bytes"}
_KIND = {"enum": [*range(len(KINDS))], "description": ", ".join(f"{i}: {kind}" for i, kind in enumerate(KINDS))}
_BY_TYPE = {int: _WHOLE, str: _TEXT, bytes: _BYTES, float: {"type": "number"}, tuple: {"type": "array"}}


def _by_type(record: type, **others: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The fields of a named tuple by their types, but for the others."""
    hints = get_type_hints(record)
    return {name: others.get(name) or _BY_TYPE[get_origin(hint) or hint] for name, hint in hints.items()}


def _array(title: str, description: str, **fields: dict[str, Any]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": description,
        "type": "array",
        "prefixItems": [{"title": name, **schema} for name, schema in fields.items()],
    }


_SCHEMAS: dict[str, dict[str, Any]] = {
    MESSAGE: _array(
        "hierax.Message",
        "One msgpack array; see hierax.schemas.messages. Numpy arrays are msgpack extension 1 (hierax.schemas.arrays); "
        "large ones stand behind the payload.",
        format=_WHOLE,
        **_by_type(Header, kind=_KIND, extensions={"type": "object"}),
        payload={"type": "array", "description": "observations, task parameters or context elements"},
    ),
    STEP: _array(
        "hierax.NodeStep",
        "What a node did in an epoch; see hierax.schemas.steps.",
        format=_WHOLE,
        **_by_type(NodeStep, state={**_BYTES, "description": "encoded [belief, policy, actions]"}),
    ),
    ROSTER: {"title": "hierax.Roster", "type": "object", "description": "see hierax.schemas.roster"},
    EPOCH: _array("hierax.Epoch", "A committed epoch and the run's digest.", epoch=_WHOLE, digest=_BYTES),
    NOTE: {"title": "hierax.Note", "type": "string", "description": "what happened to a process, in words"},
    CONTROL: {
        "title": "hierax.Control",
        "type": "array",
        "description": "what the roster's owner and the processes say to one another; see hierax.schemas.control",
    },
    TOKEN: _array("hierax.Token", "A node's process appeared, or is gone.", name=_TEXT, process=_TEXT, up=_BOOLEAN),
}


def schema_of(what: str) -> tuple[str, bytes]:
    """Name and JSON Schema of what is in a recording."""
    schema = _SCHEMAS[what]
    return schema["title"], json.dumps(schema, indent=1).encode()


@dataclass(frozen=True)
class Selection:
    """What of a run is recorded."""

    exclude: Sequence[str] = ()  # patterns of keys, as `leaves_out` has them
    max_bytes: int | None = None  # of the file; None: no bound
    max_duration_s: float | None = None  # None: no bound

    def leaves_out(self, key: str) -> str:
        """The pattern by which what comes on a key is left out; empty: it is recorded."""
        names = key.split("/")[_ROOT_SEGMENTS:]
        return next((pattern for pattern in self.exclude if _fits(pattern.split("/"), names)), "")


EVERYTHING = Selection()


def check_pattern(pattern: str) -> str:
    """A pattern of keys to be left out, such as ``obs/camera/*``. Its parts stand for those of a key, with ``*`` for
    anything in one and ``?`` for any letter; ``**`` at its end stands for all that is left. Raises `RecordingError` if
    no key that may be left out is like it."""
    head = pattern.split("/")[0]
    if "" in pattern.split("/") or not any(head == "**" or fnmatchcase(kind, head) for kind in LEAVABLE):
        near = did_you_mean(head, LEAVABLE, "they begin with")
        raise RecordingError(f"--exclude {pattern}: expected a pattern of keys, such as obs/camera/*{near}")
    return pattern


def read_size(text: str) -> int:
    """Bytes, such as ``500 MB`` or ``2GiB``. Raises `RecordingError` if it is no size."""

    def unit(found: re.Match[str]) -> float:
        return float((1024 if found[3] else 1000) ** _POWERS[found[2]])

    return int(_measured(_SIZE, unit, text, "--max-size", "a size, such as 500MB or 2GiB"))


def read_duration(text: str, option: str = "--max-duration") -> float:
    """Seconds, such as ``90``, ``90s``, ``15m`` or ``2h``. Raises `RecordingError` if it is no time."""
    return _measured(_DURATION, lambda found: _SECONDS[found[2]], text, option, "a time, such as 90s, 15m or 2h")


def _measured(
    pattern: re.Pattern[str], unit: Callable[[re.Match[str]], float], text: str, option: str, expected: str
) -> float:
    """A number and a unit; `RecordingError` if it is something else, nothing, or more than any number."""
    found = pattern.fullmatch(text.strip())
    measured = 0.0 if found is None else float(found[1]) * unit(found)
    if not 0 < measured < math.inf:
        raise RecordingError(f"{option} {text:.80}: expected {expected}")
    return measured


def _fits(pattern: Sequence[str], names: Sequence[str]) -> bool:
    if names[0] not in LEAVABLE:
        return False
    if pattern[-1] == "**":
        pattern = [*pattern[:-1], *("*" for _ in range(len(names) - len(pattern) + 1))]
    return len(pattern) == len(names) and all(map(fnmatchcase, names, pattern))
