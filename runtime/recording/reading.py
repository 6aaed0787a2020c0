"""Reading a recording, also one whose recorder was killed."""

import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.recording.info import ENDING_TEXTS, INFO_TEXTS, Ending, RecordingError, RunInfo, from_metadata
from hierax.runtime.recording.topics import EPOCH, MESSAGE, NOTE, ROSTER, STEP, TOKEN, Entry, Fault, Topic, topic_of
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
            if self._read(entry, lambda entry=entry: assembly.take(entry)):
                yield from assembly.ripe()
        yield from assembly.ripe(at_end=True)

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
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as file, suppress(McapError, struct.error, UnicodeDecodeError):
        if file.seek(0, 2) < 2 * len(MAGIC):
            return None
        file.seek(-len(MAGIC), 2)
        if file.read() != MAGIC:
            return None
        file.seek(0)
        for record in make_reader(file).iter_metadata():
            if record.name == ENDING:
                return Ending.read(from_metadata(record.metadata, ENDING_TEXTS))
    return None


def _records(path: Path) -> Iterator[Any]:
    """The file's records, those in chunks too, up to where it was cut off; `RecordingError` if it is damaged before."""
    from mcap.exceptions import EndOfFile, McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk
    from zstandard import ZstdError

    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=_LARGEST_RECORD).records:
                if isinstance(record, Chunk):
                    yield from breakup_chunk(_unpacked(record), validate_crc=True)
                else:
                    yield record
        except (EndOfFile, struct.error):
            return  # it was cut off
        except (McapError, ValueError, RuntimeError, ZstdError) as error:
            raise RecordingError(f"{path}: is damaged before byte {file.tell()}: {error}") from error


def _unpacked(chunk: Any) -> Any:
    """A chunk that is not compressed any more; `ValueError` if it is larger than it says, or than any may be."""
    from zstandard import ZstdDecompressor

    size = chunk.uncompressed_size
    if size > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes; at most {_LARGEST_CHUNK} are allowed")
    if chunk.compression == "zstd":
        data = ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk compressed by {chunk.compression!r:.40}; expected zstd or lz4")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError(f"a chunk says that it has {size} bytes, and has {'more' if len(data) > size else len(data)}")
    return replace(chunk, compression="", data=data)
