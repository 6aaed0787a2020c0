"""An MCAP file while it is written: in chunks, with an index at its end that takes no memory however long it becomes.

The writer of the package ``mcap`` keeps what the index says of each chunk until the end, a kilobyte and more; of a
recorder that writes a chunk a second this becomes gigabytes a week. The format is https://mcap.dev/spec."""

import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any, Protocol

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdCompressor

ZSTD_LEVEL = 1  # the level of Zstandard; the default, 3, takes four times as long for images, for 7 % less
SPOOLED_BYTES = 256 << 10
"""So much of the index is in memory; with more it waits in a file without a name, in the folder of the recording."""

_COPIED_BYTES = 1 << 20  # how much of that file is copied at once
_MESSAGE = struct.Struct("<BQHIQQ")
_PLACE = struct.Struct("<QQ")  # when a message was heard, and where in its chunk it is
_INDEX_HEAD = struct.Struct("<BQHI")
_PREFIX_BYTES = 9  # in front of a record: its kind and its length, which does not count them

_CHUNK_BYTES = 256  # what a chunk takes more than what is in it, in the index too, but for its channels
_CHANNEL_BYTES = 25  # what a channel that is in a chunk takes more, in the chunk's index and in the file's
_COUNTED_BYTES = 10  # what a channel takes in the statistics
_END_BYTES = 512  # what the file's end takes more than what is told of schemas, channels, chunks, metadata


class Output(Protocol):
    """What is written to."""

    def write(self, data: bytes, /) -> int: ...

    def flush(self) -> None: ...


class McapWriter:
    """Writes an MCAP file in compressed chunks, from its beginning, which is written at once, to `finish`. A chunk is
    ended when it has more than so many bytes, or by `flush`. The folder is where the index waits. Raises `OSError` if
    it cannot be written."""

    def __init__(self, output: Output, folder: Path, chunk_bytes: int, profile: str, library: str) -> None:
        self._output = output
        self._chunk_bytes = chunk_bytes
        self._written = 0  # how many bytes of the file
        self._crc = 0  # the sum of what was written of the index
        self._compressor = ZstdCompressor(level=ZSTD_LEVEL)
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._metadata: list[bytes] = []
        self._attachments: list[bytes] = []
        # the folder of a file that is written over may be somebody else's
        at = str(folder) if os.access(folder, os.W_OK) else None
        self._chunks = SpooledTemporaryFile(SPOOLED_BYTES, dir=at)  # noqa: SIM115 - what the index says of chunks
        self._index_bytes = _END_BYTES  # what the index takes at most, of all that was written
        self._ended_bytes = 0  # as `bulk`, of the chunks that were ended
        self._chunk = bytearray()  # the one under way
        self._messages = 0  # how many are in it
        self._places: dict[int, bytearray] = {}  # where they are, by channel
        self._times = [0, 0]  # of its first and its last message
        self._statistics = records.Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
        self._write(MCAP0_MAGIC)
        self._write(_packed(records.Header(profile, library)))

    @property
    def size(self) -> int:
        """How many bytes the file takes, at most, if it is finished now."""
        return self._written + self._index_bytes + self._under_way

    @property
    def bulk(self) -> int:
        """How many bytes all that is in its chunks would take, at most, if nothing became less by compression."""
        return self._ended_bytes + self._under_way

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Add metadata, which come after what was added before."""
        at, record = self._aside(records.Metadata(name, dict(data)))
        self._keep(self._metadata, records.MetadataIndex(at, len(record), name))
        self._statistics.metadata_count += 1

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Add a file of another kind, which comes after what was added before."""
        at, record = self._aside(records.Attachment(time_ns, time_ns, name, media_type, data))
        index = records.AttachmentIndex(at, len(record), time_ns, time_ns, len(data), name, media_type)
        self._keep(self._attachments, index)
        self._statistics.attachment_count += 1

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Describe what is on channels; the number by which they name it."""
        number = len(self._schemas) + 1
        schema = records.Schema(id=number, name=name, encoding=encoding, data=data)
        self._chunk += self._keep(self._schemas, schema)
        self._statistics.schema_count += 1
        return number

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Add a channel; the number by which messages name it."""
        number = len(self._channels) + 1
        channel = records.Channel(number, topic, encoding, dict(metadata), schema)
        self._chunk += self._keep(self._channels, channel)
        self._index_bytes += _COUNTED_BYTES
        self._statistics.channel_count += 1
        self._statistics.channel_message_counts[number] = 0
        return number

    def add_message(self, channel: int, time_ns: int, data: bytes, sequence: int) -> None:
        """Add a message to the chunk under way."""
        if not self._places:
            self._times = [time_ns, time_ns]
        first_ns, last_ns = self._times
        self._times = [min(first_ns, time_ns), max(last_ns, time_ns)]
        if channel not in self._places:
            self._places[channel] = bytearray()
        self._places[channel] += _PLACE.pack(time_ns, len(self._chunk))
        self._messages += 1
        length = _MESSAGE.size - _PREFIX_BYTES + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time_ns, time_ns)
        self._chunk += data
        if len(self._chunk) > self._chunk_bytes:
            self._end_chunk()

    def flush(self) -> None:
        """End the chunk under way, and have all that was added in the file."""
        self._end_chunk()
        self._output.flush()

    def finish(self) -> None:
        """End the file. Nothing is added any more."""
        self._end_chunk()
        self._write(_packed(records.DataEnd(0)))
        begins = self._written
        groups: list[tuple[int, Iterable[bytes]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [_packed(self._statistics)]),
            (Opcode.CHUNK_INDEX, self._kept_chunks()),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        offsets = [self._write_group(kind, parts) for kind, parts in groups]
        offsets_begin = self._written
        for offset in offsets:
            self._write_summed(_packed(offset))
        # the last field of the footer is the sum of all before it
        self._write_summed(_packed(records.Footer(begins, offsets_begin, 0))[:-4])
        self._write(self._crc.to_bytes(4, "little") + MCAP0_MAGIC)
        self._output.flush()
        self._chunks.close()

    # --- chunks

    @property
    def _under_way(self) -> int:
        """How many bytes the chunk under way takes, at most, with what is told of it in the index."""
        places = _PLACE.size * self._messages + _CHANNEL_BYTES * len(self._places)
        return len(self._chunk) + (len(self._chunk) >> 8) + places + _CHUNK_BYTES

    def _end_chunk(self) -> None:
        if not self._places:
            return  # schemas and channels alone wait for messages
        self._ended_bytes = self.bulk
        data, (first_ns, last_ns) = self._compressor.compress(self._chunk), self._times
        chunk = records.Chunk("zstd", data, last_ns, first_ns, zlib.crc32(self._chunk), len(self._chunk))
        begins = self._written
        self._write(_packed(chunk))
        ends = self._written
        offsets = {channel: self._write_places(channel, places) for channel, places in self._places.items()}
        told = records.ChunkIndex(
            *(ends - begins, begins, "zstd", len(data), last_ns, self._written - ends, offsets, first_ns),
            uncompressed_size=len(self._chunk),
        )
        self._index_bytes += self._chunks.write(_packed(told))
        self._count_chunk()
        self._chunk, self._places, self._messages = bytearray(), {}, 0

    def _write_places(self, channel: int, places: bytearray) -> int:
        """Write where messages of a channel are in the chunk before; where that is written."""
        at = self._written
        length = _INDEX_HEAD.size - _PREFIX_BYTES + len(places)
        self._write(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length, channel, len(places)) + places)
        self._statistics.channel_message_counts[channel] += len(places) // _PLACE.size
        return at

    def _count_chunk(self) -> None:
        statistics, (first_ns, last_ns) = self._statistics, self._times
        is_first = not statistics.chunk_count
        statistics.message_start_time = first_ns if is_first else min(first_ns, statistics.message_start_time)
        statistics.message_end_time = max(last_ns, statistics.message_end_time)
        statistics.message_count += self._messages
        statistics.chunk_count += 1

    # --- the index

    def _keep(self, group: list[bytes], record: records.McapRecord) -> bytes:
        """Keep a record for the index; its bytes."""
        packed = _packed(record)
        group.append(packed)
        self._index_bytes += len(packed)
        return packed

    def _kept_chunks(self) -> Iterator[bytes]:
        self._chunks.seek(0)
        while part := self._chunks.read(_COPIED_BYTES):
            yield part

    def _write_group(self, kind: int, parts: Iterable[bytes]) -> records.SummaryOffset:
        begins = self._written
        for part in parts:
            self._write_summed(part)
        return records.SummaryOffset(kind, begins, self._written - begins)

    # --- the file

    def _aside(self, record: records.McapRecord) -> tuple[int, bytes]:
        """Write a record that is in no chunk; where it is, and its bytes."""
        self._end_chunk()
        at, packed = self._written, _packed(record)
        self._write(packed)
        return at, packed

    def _write(self, data: bytes) -> None:
        self._output.write(data)
        self._written += len(data)

    def _write_summed(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._write(data)


def _packed(record: records.McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()
    return packed
