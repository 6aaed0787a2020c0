"""Reading a recording, also one whose recorder was killed."""

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.recording.info import ENDING_TEXTS, INFO_TEXTS, Ending, RecordingError, RunInfo, from_metadata
from hierax.runtime.recording.topics import (
    EPOCH,
    MESSAGE,
    NOTE,
    ROSTER,
    STEP,
    TOKEN,
    Entry,
    Fault,
    Selection,
    Topic,
    topic_of,
)
from hierax.runtime.recording.trace import Assembly, EpochTrace, check_roster
from hierax.runtime.recording.writing import CHUNK_BYTES, ENDING, INFO, MAGIC, PROFILE, require_mcap
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.messages import Message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep

_LARGEST_RECORD = 1 << 30
_LARGEST_CHUNK = CHUNK_BYTES + MAX_MESSAGE_BYTES + (1 << 16)
"""How many bytes an unpacked chunk may have: a recorder writes one as soon as it has more than `CHUNK_BYTES`."""

_PREFIX = struct.Struct("<BQ")  # in front of a record: its kind, and how many bytes follow
_MESSAGE = struct.Struct("<HIQQ")  # in front of a message's data
_FOOTER_BYTES = _PREFIX.size + 20 + len(MAGIC)  # with what stands behind it, to the file's end


@dataclass(frozen=True)
class Recording:
    """A recording; what is in it is read when it is asked for."""

    path: Path  # of the file
    info: RunInfo  # what it is of
    ending: Ending | None  # how it ended; None: it was cut off, its recorder was killed

    @staticmethod
    def open(path: Path | str) -> "Recording":
        """Open a recording. Raises `RecordingError` if it cannot be read, or is none."""
        require_mcap()
        path = Path(path)
        try:
            with path.open("rb") as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise RecordingError(f"{path}: is no recording; expected an MCAP file that hierax wrote")
            info, ending = _metadata(path)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
        except RecordingError as error:
            raise RecordingError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error
        return Recording(path, info, ending)

    @property
    def loss(self) -> str:
        """What is known to lack, in words; empty: nothing."""
        ending = self.ending
        lacks = [f"{', '.join(self.info.left_out)} was left out (--exclude)"] if self.info.left_out else []
        if ending is None:
            chunk = f"its last chunk, of a second or {CHUNK_BYTES >> 20} MiB"
            lacks.append(f"it was cut off: {chunk}, and what waited to be written, is not in it")
        elif ending.cut:
            lacks.append(f"it ends with epoch {ending.last} ({ending.cut})")
        if ending is not None and ending.lost:
            lacks.append(f"{ending.lost} things that were said in the run are not in it")
        return "; ".join(lacks)

    def entries(self, *what: str) -> Iterator[Entry]:
        """All that was recorded, in the order in which it was heard. `what`: kinds, as
        `hierax.runtime.recording.topics` has them; none: all. Raises `RecordingError` if the file is damaged."""
        from mcap.records import Channel
        from mcap.records import Message as McapMessage

        topics: dict[int, tuple[str, Topic]] = {}
        for record in _records(self.path):
            if isinstance(record, McapMessage) and record.channel_id in topics:
                yield Entry(*topics[record.channel_id], record.log_time, record.sequence, record.data)
            elif isinstance(record, Channel):
                topic = topic_of(record.topic)
                topics.pop(record.id, None)
                if topic is not None and (not what or topic.what in what):
                    topics[record.id] = (record.topic, topic)

    def messages(
        self, first: int = 0, last: int | None = None, node: str | None = None, kind: str | None = None
    ) -> Iterator[tuple[int, Message]]:
        """Messages along edges, of all attempts, in the order in which they were heard. `first`, `last`: epochs.
        `node`: sender or receiver. `kind`: obs, task or ctx. Yields when it came, in nanoseconds since 1970, and the
        message."""
        for entry in self.entries(MESSAGE):
            _, entry_kind, names = entry.topic
            outside = entry.epoch < first or (last is not None and entry.epoch > last)
            if not outside and (node is None or node in names) and (kind is None or kind == entry_kind):
                yield entry.time_ns, self._read(entry, entry.message)

    def steps(self, node: str | None = None) -> Iterator[NodeStep]:
        """What nodes did in each epoch, of all attempts."""
        for entry in self.entries(STEP):
            if node is None or entry.topic.names == (node,):
                yield self._read(entry, entry.step)

    def rosters(self) -> Mapping[int, Roster]:
        """The rosters, by version."""
        found = (self._read(entry, lambda entry=entry: check_roster(entry.roster())) for entry in self.entries(ROSTER))
        return {roster.version: roster for roster in found}

    def digests(self) -> Mapping[int, bytes]:
        """The run's digests by epoch, as the world told them."""
        digests = {step.epoch: step.chain for step in self.steps() if step.chain}
        for entry in self.entries(EPOCH):
            digests.setdefault(*self._read(entry, entry.commit))
        return dict(sorted(digests.items()))

    def faults(self) -> Iterator[Fault]:
        """What happened to processes: those that came and went, and what their supervisor said."""
        for entry in self.entries(TOKEN, NOTE):
            yield self._read(entry, entry.fault)

    def epochs(self, first: int = 1, last: int | None = None) -> Iterator[EpochTrace]:
        """The epochs that were committed, of these ones, in order; of each the attempt that was."""
        for epoch in self._assembled():
            if last is not None and epoch.epoch > last:
                return
            if epoch.epoch >= first:
                yield epoch

    def _assembled(self) -> Iterator[EpochTrace]:
        assembly = Assembly(self.info.how_stale, str(self.path))
        for entry in self.entries(MESSAGE, STEP, ROSTER, EPOCH):
            if entry.topic.what == ROSTER:
                self._check_world(entry)
            if self._read(entry, lambda entry=entry: assembly.take(entry)):
                yield from assembly.ripe()
        yield from assembly.ripe(at_end=True)

    def _check_world(self, entry: Entry) -> None:
        """Raises `RecordingError` if the steps of a roster's world were left out."""
        steps = f"steps/{self._read(entry, entry.roster).world}"
        pattern = Selection(self.info.left_out).leaves_out(f"{entry.key.rpartition('/')[0]}/{steps}")
        if pattern:
            what = "no step of the world is recorded, so it is not known which epochs were committed"
            raise RecordingError(f"{self.path}: {what}: {steps} was left out (--exclude {pattern})")

    def _read(self, entry: Entry, reads: Any) -> Any:
        try:
            return reads()
        except (SchemaError, HierarchyError) as error:
            raise RecordingError(f"{self.path}: {entry.key!r:.100}: {error}") from error


def _metadata(path: Path) -> tuple[RunInfo, Ending | None]:
    """The first metadata, and the last if the file has its end."""
    from mcap.records import Header, Metadata

    for record in _records(path):
        if isinstance(record, Header) and record.profile != PROFILE:
            raise RecordingError(f"is an MCAP file of profile {record.profile!r:.40}, not one that hierax wrote")
        if isinstance(record, Metadata) and record.name == INFO:
            return RunInfo.read(from_metadata(record.metadata, INFO_TEXTS)), _ending(path)
    raise RecordingError("was cut off before it says what it is of")


def _ending(path: Path) -> Ending | None:
    """How it ended, by the file's index, without going through all of it; None where there is no index."""
    with path.open("rb") as file:
        try:
            metadata = _last_metadata(file)
        except _damages():
            return None
    return None if metadata is None else Ending.read(from_metadata(metadata, ENDING_TEXTS))


def _last_metadata(file: BinaryIO) -> Mapping[str, str] | None:
    """The metadata of the file's end, by its index, of which there may be gigabytes: of other records nothing is kept.
    Raises one of `_damages`."""
    from mcap.records import Footer, Metadata, MetadataIndex

    if file.seek(0, os.SEEK_END) < _FOOTER_BYTES:
        return None
    file.seek(-len(MAGIC), os.SEEK_END)
    if file.read() != MAGIC:
        return None
    file.seek(-_FOOTER_BYTES, os.SEEK_END)
    footer = next(_walk(file), None)
    if not isinstance(footer, Footer):
        return None
    file.seek(_metadata_begin(file, footer))
    named = (each for each in _walk(file) if isinstance(each, (Metadata, MetadataIndex)) and each.name == ENDING)
    found = next(named, None)
    if isinstance(found, MetadataIndex):
        file.seek(found.offset)
        found = next(_walk(file), None)
    return found.metadata if isinstance(found, Metadata) and found.name == ENDING else None


def _metadata_begin(file: BinaryIO, footer: Any) -> int:
    """Where what the index says of metadata begins; where it does not tell, the index, or else the file's records."""
    from mcap.opcode import Opcode
    from mcap.records import SummaryOffset

    if footer.summary_offset_start:
        file.seek(footer.summary_offset_start)
        for record in _walk(file):
            if isinstance(record, SummaryOffset) and record.group_opcode == Opcode.METADATA_INDEX:
                return record.group_start
    return footer.summary_start or len(MAGIC)


def _records(path: Path) -> Iterator[Any]:
    """The file's records, those in chunks too, up to where it was cut off; `RecordingError` if it is damaged before."""
    from mcap.records import Chunk, DataEnd

    with path.open("rb") as file:
        try:
            file.seek(len(MAGIC))
            for record in _walk(file):
                if isinstance(record, Chunk):
                    yield from _in_chunk(_unpacked(record))
                elif isinstance(record, DataEnd):
                    return  # what follows is the index
                else:
                    yield record
        except _damages() as error:
            what = str(error) or type(error).__name__
            raise RecordingError(f"{path}: is damaged before byte {file.tell()}: {what}") from error


def _damages() -> tuple[type[Exception], ...]:
    """What is raised where a file does not hold what a recorder writes, or claims to hold more than there is room."""
    from zstandard import ZstdError

    return (ValueError, RuntimeError, OverflowError, MemoryError, ZstdError)


class _Content(BytesIO):
    """What is in a record, of which nothing can be read that is not there."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._length = len(data)

    def read(self, size: int | None = -1, /) -> bytes:
        rest = self._length - self.tell()
        if size is None or not 0 <= size <= rest:
            raise ValueError(f"a field of {size} bytes in a record that has {rest} more")
        return super().read(size)


def _walk(file: BinaryIO) -> Iterator[Any]:
    """The records of a file from where it is, but for those that nobody asks for, up to where it was cut off. Raises
    `ValueError` if one is none."""
    readers = _readers()
    while len(head := file.read(_PREFIX.size)) == _PREFIX.size:
        kind, length = _PREFIX.unpack(head)
        if length > _LARGEST_RECORD:
            raise ValueError(f"a record of {length} bytes; at most {_LARGEST_RECORD} are allowed")
        if kind not in readers:
            file.seek(length, os.SEEK_CUR)
            continue
        content = file.read(length)
        if len(content) < length:
            return
        yield readers[kind](content)


def _in_chunk(data: bytes) -> Iterator[Any]:
    """The records of a chunk, one after the other; `ValueError` if one is none, or ends behind the chunk."""
    readers, at = _readers(), 0
    while at < len(data):
        begins = at + _PREFIX.size
        if begins > len(data):
            raise ValueError(f"a chunk whose last record has {len(data) - at} bytes; expected {_PREFIX.size} at least")
        kind, length = _PREFIX.unpack_from(data, at)
        at = begins + length
        if at > len(data):
            raise ValueError(f"a record of {length} bytes in a chunk that has {len(data) - begins} more")
        if kind in readers:
            yield readers[kind](data[begins:at])


@cache
def _readers() -> Mapping[int, Callable[[bytes], Any]]:
    """How a record is read from what is in it, of each kind that is asked for. Raises `ValueError` if it is none."""
    from mcap import records
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode

    kinds = {
        Opcode.HEADER: records.Header,
        Opcode.FOOTER: records.Footer,
        Opcode.CHANNEL: records.Channel,
        Opcode.CHUNK: records.Chunk,
        Opcode.METADATA: records.Metadata,
        Opcode.METADATA_INDEX: records.MetadataIndex,
        Opcode.SUMMARY_OFFSET: records.SummaryOffset,
        Opcode.DATA_END: records.DataEnd,
    }

    def read(record: Any, content: bytes) -> Any:
        return record.read(ReadDataStream(_Content(content)))

    def message(content: bytes) -> Any:
        if len(content) < _MESSAGE.size:
            raise ValueError(f"a message of {len(content)} bytes; expected {_MESSAGE.size} at least")
        channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
        return records.Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)

    return {Opcode.MESSAGE: message, **{kind: partial(read, record) for kind, record in kinds.items()}}


def _unpacked(chunk: Any) -> bytes:
    """What is in a chunk; `ValueError` if it is larger than it says, or than any may be, or something else."""
    from zstandard import ZstdDecompressor

    size = chunk.uncompressed_size
    if size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes; at most {_LARGEST_CHUNK} are allowed")
    if chunk.compression == "zstd":
        data: bytes = ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk compressed by {chunk.compression!r:.40}; expected zstd or lz4")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"a chunk says that it has {size} bytes, and has {'more' if len(data) > size else len(data)}")
    if chunk.uncompressed_crc and chunk.uncompressed_crc != zlib.crc32(data):
        raise ValueError("a chunk has another sum of its bytes (CRC-32) than it says")
    return data
