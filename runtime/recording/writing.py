"""Writing a recording: an MCAP file, one channel per key, chunks that are whole on disk soon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from hierax.runtime.recording.info import Ending, RecordingError, RunInfo, to_metadata
from hierax.runtime.recording.topics import schema_of

PROFILE = "hierax"
INFO, ENDING = "hierax.run", "hierax.ending"
"""Names of the file's metadata."""

CHUNK_BYTES = 1 << 20
CHUNK_S = 1.0
"""A chunk is written when it is this large or old: what a killed recorder loses."""

Compression = Literal["none", "lz4", "zstd"]


class McapFile:
    """A recording that is being written. Not for two threads at once.

    Args:
        path: of the file; what was there is gone.
        info: of the run.
        compression: of chunks.

    Raises:
        RecordingError: the file cannot be written, or the package ``mcap`` lacks.
    """

    def __init__(self, path: Path, info: RunInfo, compression: Compression = "lz4") -> None:
        self._path = path
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._dirty_s: float | None = None
        with self._mapped():
            self._file = path.open("wb")
            self._writer = _writer(self._file, compression)
            self._writer.start(PROFILE, f"hierax {info.versions.get('hierax', '')}")
            self._writer.add_metadata(INFO, to_metadata(info.plain()))
            text = info.deployment_text.encode()
            self._writer.add_attachment(info.started_ns, info.started_ns, "deployment.yaml", "application/yaml", text)
            self._writer.flush()

    def add(self, key: str, what: str, time_ns: int, epoch: int, data: bytes) -> None:
        """Add what came on a key.

        Args:
            key: the channel's name.
            what: it is, as `hierax.runtime.recording.topics` has it.
            time_ns: when it came, since 1970.
            epoch: of it; 0: of none.
            data: its bytes.

        Raises:
            RecordingError: the file cannot be written.
        """
        channel = self._channels.get(key)
        with self._mapped():
            if channel is None:
                channel = self._channels[key] = self._register(key, what)
            self._writer.add_message(channel, time_ns, data, time_ns, epoch & 0xFFFFFFFF)
        if self._dirty_s is None:
            self._dirty_s = time.monotonic()

    def flush(self, at_once: bool = False) -> None:
        """Write the chunk under way, if it is old enough.

        Raises:
            RecordingError: the file cannot be written.
        """
        if self._dirty_s is None or not (at_once or time.monotonic() - self._dirty_s >= CHUNK_S):
            return
        self._dirty_s = None
        with self._mapped():
            self._writer.flush()

    def close(self, ending: Ending) -> None:
        """Write how it ended, and the file's index.

        Raises:
            RecordingError: the file cannot be written.
        """
        with self._mapped():
            self._writer.flush()
            self._writer.add_metadata(ENDING, to_metadata(ending.plain()))
            self._writer.finish()
            self._file.close()

    def _register(self, key: str, what: str) -> int:
        schema = self._schemas.get(what)
        if schema is None:
            name, text = schema_of(what)
            schema = self._schemas[what] = self._writer.register_schema(name, "jsonschema", text)
        channel: int = self._writer.register_channel(key, "msgpack", schema, {"what": what})
        return channel

    @contextmanager
    def _mapped(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def _writer(file: Any, compression: Compression) -> Any:
    require_mcap()
    from mcap.writer import CompressionType, Writer

    kinds = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
    return Writer(file, chunk_size=CHUNK_BYTES, compression=kinds[compression])


def require_mcap() -> None:
    """See that recordings can be written and read.

    Raises:
        RecordingError: the package lacks.
    """
    try:
        import mcap.writer  # noqa: F401
    except ModuleNotFoundError as error:
        raise RecordingError("recordings need the package mcap: pip install 'hierax[record]'") from error
