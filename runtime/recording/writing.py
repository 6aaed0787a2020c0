"""Writing a recording: an MCAP file, one channel per key, chunks that are whole on disk soon."""

import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from hierax.runtime.host.private_files import HeldError, close_held, errors_named, open_held, open_result
from hierax.runtime.recording.info import Ending, RecordingError, RunInfo, to_metadata
from hierax.runtime.recording.topics import Entry, schema_of

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "hierax"
INFO, ENDING = "hierax.run", "hierax.ending"  # names of the file's metadata
CHUNK_BYTES = 4 << 20
CHUNK_S = 1.0
"""A chunk is written when it is this large or old: what a killed recorder loses. An array that is told of twice in a
chunk, as a message and in a belief, takes its room once."""

KEPT_BYTES = 64 << 20  # how much waits for the first epoch to be committed; with more, what was in the file is gone


@dataclass(frozen=True)
class Target:
    """The file of a recording, which this process has for itself, and those that are given its descriptor."""

    path: Path
    descriptor: int


@contextmanager
def claimed(path: Path, overwrite: bool = False) -> Iterator[Target]:
    """Have the file of a recording for oneself; it is made where it lacks, and does not stay if nothing is written.
    Raises `RecordingError` if it cannot be written, another process writes it, there is something already that is
    not replaced (`overwrite` replaces a recording), or the package ``mcap`` lacks."""
    require_mcap()
    with errors_named(path, kind=RecordingError):
        file = open_held(path, lambda holder: HeldError(f"{path}: {holder} is writing it; name another file"))
    try:
        if os.fstat(file).st_size:
            if os.pread(file, len(MAGIC), 0) != MAGIC:
                raise RecordingError(f"{path}: is no recording, so it is not overwritten; name another file")
            if not overwrite:
                raise RecordingError(f"{path}: is there already; --overwrite replaces it, or name another file")
        yield Target(path, file)
    finally:
        close_held(path, file)


class _Late:
    """A file whose content stays until `begin`: what is written is kept until then, or until it is too much."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._kept: BytesIO | None = BytesIO()  # None: it is begun

    @property
    def is_begun(self) -> bool:
        return self._kept is None

    def begin(self) -> None:
        """What was in the file is gone, and what was kept is in it."""
        if self._kept is None:
            return
        kept, self._kept = self._kept, None
        self._file.truncate(0)
        self._file.write(kept.getbuffer())

    def write(self, data: bytes) -> int:
        if self._kept is not None and self._kept.tell() > KEPT_BYTES:
            self.begin()
        return (self._file if self._kept is None else self._kept).write(data)

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self._file.close()


class McapFile:
    """A recording that is being written, with compressed chunks. Not for two threads at once. What was in the file is
    gone: at once if that is a path, with `begin` if it is what `claimed` gave. Raises `RecordingError` if it cannot be
    written, or the package ``mcap`` lacks."""

    def __init__(self, path: Path | Target, info: RunInfo) -> None:
        self._path = path.path if isinstance(path, Target) else path
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._dirty_s: float | None = None
        require_mcap()
        from hierax.runtime.recording.mcap_writer import McapWriter

        with self._mapped():
            descriptor = os.dup(path.descriptor) if isinstance(path, Target) else open_result(path)
            self._file = _Late(os.fdopen(descriptor, "wb"))
            if not isinstance(path, Target):
                self._file.begin()
            library = f"hierax {info.versions.get('hierax', '')}"
            self._writer = McapWriter(self._file, self._path.parent, CHUNK_BYTES, PROFILE, library)
            self._writer.add_metadata(INFO, to_metadata(info.plain()))
            text = info.deployment_text.encode()
            self._writer.add_attachment(info.started_ns, "deployment.yaml", "application/yaml", text)
            self._writer.flush()

    def begin(self) -> None:
        """There is something worth keeping: replace what was in the file. `RecordingError` if it cannot be written."""
        if self._file.is_begun:  # with each message after the first epoch
            return
        with self._mapped():
            self._file.begin()

    def add(self, entry: Entry) -> None:
        """Add what came on a key, which is the channel's name. Raises `RecordingError` if it cannot be written."""
        try:
            if entry.key not in self._channels:
                self._channels[entry.key] = self._register(entry.key, entry.topic.what)
            channel = self._channels[entry.key]
            self._writer.add_message(channel, entry.time_ns, entry.data, entry.epoch & 0xFFFFFFFF)
        except OSError:
            with self._mapped():
                raise
        if self._dirty_s is None:
            self._dirty_s = time.monotonic()

    @property
    def size(self) -> int:
        """How many bytes it takes, at most, with its index, if it is closed now; but for how it ended."""
        return self._writer.size

    @property
    def bulk(self) -> int:
        """How many bytes all that was added would take, at most, with its index, if nothing became less."""
        return self._writer.bulk

    def flush(self, at_once: bool = False) -> None:
        """Write the chunk under way, if it is old enough. Raises `RecordingError` if the file cannot be written."""
        if self._dirty_s is None or not (at_once or time.monotonic() - self._dirty_s >= CHUNK_S):
            return
        self._dirty_s = None
        with self._mapped():
            self._writer.flush()

    def close(self, ending: Ending) -> None:
        """Write how it ended, and the file's index; a file that was not begun stays as it was. Raises `RecordingError`
        if the file cannot be written."""
        with self._mapped():
            self._writer.flush()
            self._writer.add_metadata(ENDING, to_metadata(ending.plain()))
            self._writer.finish()
            self._file.close()

    def _register(self, key: str, what: str) -> int:
        if what not in self._schemas:
            name, text = schema_of(what)
            self._schemas[what] = self._writer.register_schema(name, "jsonschema", text)
        return self._writer.register_channel(key, "msgpack", self._schemas[what], {"what": what})

    def _mapped(self) -> AbstractContextManager[None]:
        return errors_named(self._path, kind=RecordingError)


def require_mcap() -> None:
    """See that recordings can be written and read. Raises `RecordingError` if the package lacks."""
    try:
        import mcap.records  # noqa: F401
    except ModuleNotFoundError as error:
        raise RecordingError("recordings need the package mcap: pip install 'hierax[record]'") from error
