"""Recordings with junk in them, and every command that reads recordings, on each.

A command has to end with 0, 1 or 2 and one clear line, whatever a recording says.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import signal
import struct
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import msgpack
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from hierax.runtime.commands.main import main
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.writing import ENDING, INFO, PROFILE
from hierax.runtime.testing.runs import read_recorded
from hierax.schemas.errors import SchemaError
from support.junk import junk, mutated

TOO_LONG_S = 60
"""No command takes so long for these recordings, on a busy machine either."""

NESTED = {"steps": (10, 11, 12, 15)}
"""Fields of a step that are encoded values themselves."""


class Said(NamedTuple):
    """What was recorded on a topic."""

    topic: str
    time_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Contents:
    """All that is in a recording."""

    profile: str
    metadata: dict[str, dict[str, str]]
    said: tuple[Said, ...]

    @staticmethod
    def read(path: Path) -> Contents:
        """Of a file."""
        topics: dict[int, str] = {}
        metadata: dict[str, dict[str, str]] = {}
        said = []
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Metadata):
                    metadata[record.name] = dict(record.metadata)
                elif isinstance(record, Message):
                    said.append(Said(topics[record.channel_id], record.log_time, record.sequence, record.data))
        return Contents(PROFILE, metadata, tuple(said))

    def write(self, path: Path) -> None:
        """Into a file, as a recorder writes it."""
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.NONE)
            writer.start(self.profile, "junk")
            if INFO in self.metadata:
                writer.add_metadata(INFO, self.metadata[INFO])
            channels: dict[str, int] = {}
            for each in self.said:
                if each.topic not in channels:
                    channels[each.topic] = writer.register_channel(each.topic, "msgpack", 0, {})
                writer.add_message(channels[each.topic], each.time_ns, each.data, each.time_ns, each.sequence)
            if ENDING in self.metadata:
                writer.add_metadata(ENDING, self.metadata[ENDING])
            writer.finish()


def spoilt(random_: random.Random, contents: Contents, path: Path) -> str:
    """Write a recording in which something is wrong; what, in words."""
    what, change = random_.choice(WAYS)
    changed = change(random_, contents)
    changed.write(path)
    if what == "bytes":
        _spoil_bytes(random_, path)
    return what


def _metadata(name: str) -> Callable[[random.Random, Contents], Contents]:
    def change(random_: random.Random, contents: Contents) -> Contents:
        given = dict(contents.metadata.get(name, {}))
        field = random_.choice(list(given))
        try:
            value = json.loads(given[field])
        except ValueError:
            value = given[field]
        new = mutated(random_, value) if random_.random() < 0.7 else junk(random_, value)
        kind = random_.randrange(8)
        if kind == 0:
            del given[field]
        elif kind == 1:
            given[field] = given[field][: len(given[field]) // 2]
        elif kind == 2 and isinstance(value, str):
            given[field] = str(new)
        else:
            given[field] = _text(new)
        return replace(contents, metadata={**contents.metadata, name: given})

    return change


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    try:
        return json.dumps(value)
    except TypeError:  # bytes somewhere in it
        return repr(value)


def _of_topic(segment: str) -> Callable[[random.Random, Contents], Contents]:
    def change(random_: random.Random, contents: Contents) -> Contents:
        found = [index for index, each in enumerate(contents.said) if f"/{segment}" in each.topic]
        if not found:
            return replace(contents, said=())
        said = list(contents.said)
        for _ in range(random_.choice((1, 1, 3))):
            index = random_.choice(found)
            said[index] = said[index]._replace(data=_other(random_, segment, said[index].data))
        return replace(contents, said=tuple(said))

    return change


def _other(random_: random.Random, segment: str, data: bytes) -> bytes:
    kind = random_.randrange(12)
    if kind == 0:
        return data[: random_.randrange(len(data))]
    if kind == 1:
        at = random_.randrange(len(data))
        return data[:at] + bytes([random_.randrange(256)]) + data[at + 1 :]
    if kind == 2:
        return _packed(junk(random_))
    try:
        value = msgpack.unpackb(data, strict_map_key=False)
    except Exception:  # large arrays stand behind it
        at = random_.randrange(len(data))
        return data[:at] + random_.randbytes(4) + data[at + 4 :]
    if not isinstance(value, list) or not value:
        return _packed(mutated(random_, value))
    if segment in NESTED and random_.random() < 0.5:
        field = random_.choice(NESTED[segment])
        if value[field]:
            value[field] = _other(random_, "", value[field])
            return _packed(value)
    if segment in NESTED or segment in ("obs", "ctx", "task"):  # its head first of all
        return _packed(mutated(random_, value, (random_.randrange(len(value)),)))
    return _packed(mutated(random_, value))


def _packed(value: Any) -> bytes:
    try:
        return msgpack.packb(value)  # type: ignore[no-any-return]
    except (OverflowError, ValueError, TypeError):
        return msgpack.packb(str(value)[:1000])  # type: ignore[no-any-return]


def _order(random_: random.Random, contents: Contents) -> Contents:
    said = list(contents.said)
    kind = random_.randrange(6)
    some = sorted(random_.sample(range(len(said)), min(len(said), random_.choice((1, 3, 20)))), reverse=True)
    for index in some:
        if kind == 0:
            del said[index]
        elif kind == 1:
            said.insert(index, said[index])
        elif kind == 2:
            said.append(said.pop(index))
        elif kind == 3:
            said.insert(0, said.pop(index))
        elif kind == 4:
            said[index] = said[index]._replace(topic=_topic(random_, said[index].topic))
        else:
            said[index] = said[index]._replace(
                sequence=random_.randrange(1 << 32), time_ns=random_.choice((0, 1 << 63))
            )
    return replace(contents, said=tuple(said))


def _topic(random_: random.Random, topic: str) -> str:
    segments = topic.split("/")
    index = random_.randrange(len(segments))
    segments[index] = random_.choice(("", "x", "obs", "steps", "alive", "epochs", "notes", "roster", "*"))
    return "/".join(segments[: random_.choice((len(segments), index + 1))])


def _without(random_: random.Random, contents: Contents) -> Contents:
    """A kind of thing, or all of it, lacks."""
    segment = random_.choice(("steps", "roster", "epochs", "obs", "ctx", "task", ""))
    return replace(contents, said=tuple(each for each in contents.said if f"/{segment}" not in each.topic))


def _spoil_bytes(random_: random.Random, path: Path) -> None:
    data = bytearray(path.read_bytes())
    kind = random_.randrange(4)
    at = random_.randrange(len(data))
    if kind == 0:
        del data[at:]
    elif kind == 1:
        data[at] = random_.randrange(256)
    elif kind == 2:
        data[at : at + 8] = struct.pack("<Q", random_.choice((0, 1 << 30, (1 << 64) - 1)))
    else:
        data[at:at] = data[at : at + 1000]
    path.write_bytes(bytes(data))


WAYS: tuple[tuple[str, Callable[[random.Random, Contents], Contents]], ...] = (
    *((INFO, _metadata(INFO)),) * 3,
    (ENDING, _metadata(ENDING)),
    *((each, _of_topic(each)) for each in ("steps", "steps", "roster", "roster", "obs", "ctx", "task", "epochs")),
    *((each, _of_topic(each)) for each in ("notes", "alive", "control")),
    ("order", _order),
    ("lacks", _without),
    ("profile", lambda random_, contents: replace(contents, profile=random_.choice(("", "ros2", "hierax2")))),
    ("bytes", lambda random_, contents: contents),
)


# --- commands


@dataclass(frozen=True)
class Subject:
    """A recording of a shipped deployment.

    Attributes:
        name: of the deployment.
        settings: with which it was recorded.
        file: whole.
        contents: of the file.
        node: one of its nodes, not the world.
    """

    name: str
    settings: tuple[str, ...]
    file: Path
    contents: Contents
    node: str

    def commands(self, path: Path) -> Sequence[list[str]]:
        """All command lines that read a recording."""
        at, node, settings = str(path), self.node, [part for each in self.settings for part in ("--set", each)]
        trust = TRUST
        return [
            ["replay", at, *trust],
            ["replay", at],
            ["replay", at, "--verify", "--format", "json", *trust],
            ["replay", at, "--verify", "--world", "again", "--from", "2", *trust],
            ["replay", at, "--node", node, "--verify", "--tolerance", "0.1", *trust],
            ["replay", at, "--with", f"{node}=hierax.nodes.chain:Relay", *trust],
            ["replay", at, *(settings or ["--set", "epochs=3"]), "--speed", "1e9", *trust],
            ["diff", at, str(self.file)],
            ["diff", str(self.file), at, "--format", "json"],
            ["diff", at, self.name, *settings, *trust],
            ["check", at],
            ["check", at, "--format", "json"],
            ["view", at, "--save", f"{at}.rrd", *trust],
            ["export", at, "--rosbag", f"{at}.bag", "--poses", node, "--overwrite"],
        ]


TRUST = ("--trust",)
"""What is changed is no longer known to be one's own; each is read without it, too."""


class Hangs(BaseException):
    """A command takes too long; nothing that a command catches."""


class Fault(NamedTuple):
    """A command that did not end as it should."""

    command: list[str]
    what: str
    text: str


def faults(subject: Subject, path: Path, random_: random.Random, some: int | None = None) -> Iterator[Fault]:
    """What goes wrong when the commands read a recording.

    Args:
        subject: whose recording it was.
        path: of the recording.
        random_: draws which commands.
        some: so many of them; None: all.
    """
    commands = subject.commands(path)
    for command in commands if some is None else random_.sample(commands, some):
        fault = fault_of(command)
        if fault is not None:
            yield fault
    yield from _library_faults(subject, path)


def fault_of(command: list[str]) -> Fault | None:
    """What is wrong with how a command ends."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _alarm():
        try:
            code: int | str = main(command)
        except Hangs:
            code = "hangs"
    said = err.getvalue()
    if code not in (0, 1, 2) or "Traceback" in said:
        return Fault(command, f"exit code {code}", said[-3000:])
    errors = [line for line in said.splitlines() if line.startswith("error: ")]
    if code == 1 and not errors and not out.getvalue():
        return Fault(command, "says nothing", said)
    if any(len(line) > 2000 for line in said.splitlines()):
        return Fault(command, "a line that nobody reads", said[:3000])
    if "json" in command and code == 0:
        json.loads(out.getvalue())
    return None


def _library_faults(subject: Subject, path: Path) -> Iterator[Fault]:
    def everything() -> None:
        recording = Recording.open(path)
        for read in (recording.messages, recording.faults, recording.steps, recording.epochs, recording.digests):
            for _ in read():
                pass

    calls = (("Recording", everything), ("recorded_node", lambda: read_recorded(path, subject.node, trust=True)))
    for name, call in calls:
        error = _raised(call)
        if error is not None and not isinstance(error, (HieraxError, SchemaError)):
            yield Fault([name], type(error).__name__, "".join(traceback.format_exception(error))[-3000:])


def _raised(call: Callable[[], object]) -> BaseException | None:
    try:
        with _alarm():
            call()
    except (Exception, Hangs) as error:
        return error
    return None


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Ends what hangs."""

    def late(number: int, frame: FrameType | None) -> None:
        raise Hangs(f"more than {TOO_LONG_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(TOO_LONG_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
