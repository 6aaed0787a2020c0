"""A file as a stream of msgpack arrays, which outlives the process that writes it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import msgpack

from hierax.runtime.host.private_files import errors_named, open_result
from hierax.schemas.limits import MAX_MESSAGE_BYTES


class Log:
    """A file as a stream of msgpack arrays. Raises `HieraxError` if it cannot be written, now or later."""

    def __init__(self, path: Path, append: bool = False) -> None:
        self._path = path  # of the file
        with errors_named(self._path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = os.fdopen(open_result(path, append), "ab" if append else "wb")
            if not append:
                self._file.truncate(0)
        # Go on behind what is there, but for an entry that was cut off; this is looked at when something is written, as
        # until then another process may still be writing.
        self._behind = append

    def write(self, *fields: int | bytes) -> None:
        """Append an array."""
        try:  # entering a context would take longer, and this runs in every epoch
            if self._behind:
                self._behind = False
                os.truncate(self._path, _whole_bytes(self._path))
            self._file.write(msgpack.packb(fields))
        except OSError:
            with errors_named(self._path):
                raise

    def flush(self) -> None:
        """Give what is buffered to the system: then it outlives the process."""
        with errors_named(self._path):
            self._file.flush()

    def close(self) -> None:
        """Write out what is buffered."""
        with errors_named(self._path):
            self._file.close()


def _whole_bytes(path: Path) -> int:
    """Up to where a stream of msgpack arrays holds whole ones."""
    with path.open("rb") as file:
        unpacker = msgpack.Unpacker(file, max_buffer_size=MAX_MESSAGE_BYTES)
        whole = 0
        try:
            while True:
                unpacker.skip()
                whole = unpacker.tell()
        except (msgpack.OutOfData, ValueError):
            return whole
