"""Where slots are kept: memory-mapped files, or what a simulation puts in their place."""

import mmap
import os
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from typing import Literal, get_args

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import closed_on_error, errors_named, hold, open_private, private_folder

Durability = Literal["process", "host"]
"""What a record outlives once it is written: the process, or the machine's power too."""

SLOTS = 2
MAGIC = b"hieraxC\x01"  # what each slot's file begins with; the last byte is the format

LARGEST_BYTES = 1 << 30
"""What a slot's file may have; the largest record takes half of it. One that claims more would have the disk filled."""

_PID_BYTES = 20


class CheckpointError(HieraxError):
    """The files of a checkpoint cannot be used; says which and why."""


class Storage(ABC):
    """Two slots of bytes. A crash may tear what is being written, and nothing else."""

    @abstractmethod
    def write(self, slot: int, data: bytes) -> None:
        """Put data at the start of a slot, which grows if need be; what was behind it may stay."""

    @abstractmethod
    def read(self, slot: int) -> bytes:
        """All that a slot holds; zeros if it was never written."""

    @abstractmethod
    def flush(self) -> None:
        """Return when all that was written outlives what the storage promises to outlive."""


class MappedFile(Storage):
    """Two memory-mapped files, ``PATH.0`` and ``PATH.1``, and a lock, ``PATH.lock``.

    What is written is the kernel's at once, so it outlives the process without a call to the kernel; with a durability
    of ``host``, `flush` waits for the disk. A file appears under its name when it is complete, and only grows, in
    place: the other one is not touched, and a slot that grows is the one to be written. Raises `CheckpointError` if
    another process has it, a file is no checkpoint's, or the machine refuses."""

    def __init__(self, path: Path, durability: Durability = "process") -> None:
        if durability not in get_args(Durability):
            raise ValueError(f"durability {durability!r}; expected one of {', '.join(get_args(Durability))}")
        self.path = path  # where; the folder must be there
        self._host = durability == "host"
        self._files: list[_SlotFile] = []
        self._unflushed: set[int] = set()
        self._lock = -1
        try:
            with errors_named(_beside(path, "lock"), "opened", CheckpointError), private_folder(path.parent) as folder:
                self._open(folder)
        except BaseException:
            self.close()
            raise

    def _open(self, folder: int) -> None:
        path = self.path
        self._lock = _locked(folder, path)
        for slot in range(SLOTS):
            self._files.append(_SlotFile(folder, _beside(path, str(slot)), durable=self._host))
        if self._host:
            with errors_named(path.parent, "flushed to disk", CheckpointError):
                _sync_folder(path.parent)

    def write(self, slot: int, data: bytes) -> None:
        self._files[slot].write(data)
        if self._host:
            self._unflushed.add(slot)

    def read(self, slot: int) -> bytes:
        return self._files[slot].read()

    def flush(self) -> None:
        if not self._unflushed:
            return
        for slot in sorted(self._unflushed):
            self._files[slot].flush()
            self._unflushed.remove(slot)

    def close(self) -> None:
        """Let go of the files and the lock; more than once does no harm."""
        while self._files:
            self._files.pop().close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> "MappedFile":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def kept_at(path: Path, durability: Durability) -> MappedFile | None:
    """What a process has kept that has ended; None: it has kept nothing, and no file is made. Raises `CheckpointError`
    as `MappedFile` does."""
    return MappedFile(path, durability) if _beside(path, "0").exists() else None


def remove_kept(path: Path) -> None:
    """Remove what a process has kept, which nobody is to go on with; that is no matter where it cannot be removed."""
    for ending in (*map(str, range(SLOTS)), "lock"):  # the lock last: by it others find the slots
        with suppress(OSError):
            _beside(path, ending).unlink()


class _SlotFile:
    """One slot: `MAGIC`, then its bytes. A new file that is durable waits for the disk before it gets its name."""

    def __init__(self, folder: int, path: Path, *, durable: bool) -> None:
        self._path = path  # made if it is not there
        if not os.path.lexists(path):
            with errors_named(path, "made", CheckpointError):
                _make(folder, path, durable)
        with errors_named(path, "opened", CheckpointError):
            self._file = open_private(folder, path.name, os.O_RDWR, path)
        with closed_on_error(self._file):
            self._map = self._opened()

    def write(self, data: bytes) -> None:
        end = len(MAGIC) + len(data)
        if self._map is not None and end <= len(self._map):
            self._map[len(MAGIC) : end] = data
            return
        grown = self._grown(end)
        grown[len(MAGIC) : end] = data
        grown[: len(MAGIC)] = MAGIC  # last: what was behind a beginning that got lost must not count again
        if self._map is not None:
            self._map.close()
        self._map = grown

    def read(self) -> bytes:
        return b"" if self._map is None else self._map[len(MAGIC) :]

    def flush(self) -> None:
        with errors_named(self._path, "flushed to disk", CheckpointError):
            os.fdatasync(self._file)  # of mapped pages as well, and unlike `mmap.flush` other threads go on meanwhile

    def close(self) -> None:
        if self._map is not None:
            self._map.close()
        os.close(self._file)

    def _opened(self) -> mmap.mmap | None:
        """The file, if it is ours; None where all of it, or at least its beginning, is lost."""
        with errors_named(self._path, "read", CheckpointError):
            size = os.fstat(self._file).st_size
            head = os.pread(self._file, len(MAGIC), 0)
        if head != MAGIC:
            if MAGIC.startswith(head) or not any(head):
                return None
            what = f"begins with {head!r}, so it is no checkpoint that this version can read"
            raise CheckpointError(f"{self._path}: {what}; name another file, or remove it to begin anew")
        if size > LARGEST_BYTES:
            raise CheckpointError(f"{self._path}: has {size} bytes; a checkpoint has at most {LARGEST_BYTES}")
        with errors_named(self._path, "mapped", CheckpointError):
            os.posix_fallocate(self._file, 0, size)
            return mmap.mmap(self._file, size)

    def _grown(self, least: int) -> mmap.mmap:
        """The file with a power of two bytes, and blocks behind them: a page that finds none kills the process."""
        size = max(mmap.PAGESIZE, 1 << (least - 1).bit_length())
        with errors_named(self._path, f"grown to {size} bytes", CheckpointError):
            os.posix_fallocate(self._file, 0, size)
            return mmap.mmap(self._file, size)


def _make(folder: int, path: Path, durable: bool) -> None:
    """A slot's file of one page, complete when it appears."""
    unfinished = _beside(path, "new")
    file = open_private(folder, unfinished.name, os.O_RDWR | os.O_CREAT | os.O_TRUNC, unfinished)
    try:
        os.posix_fallocate(file, 0, mmap.PAGESIZE)
        os.pwrite(file, MAGIC, 0)
        if durable:
            os.fsync(file)
    finally:
        os.close(file)
    os.rename(unfinished.name, path.name, src_dir_fd=folder, dst_dir_fd=folder)


def _sync_folder(folder: Path) -> None:
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _locked(folder: int, path: Path) -> int:
    """An open lock file that nobody else has locked; the kernel unlocks it when the process ends."""
    lock = _beside(path, "lock")
    with errors_named(lock, "opened", CheckpointError):
        file = open_private(folder, lock.name, os.O_RDWR | os.O_CREAT, lock)

    def in_use(holder: str) -> CheckpointError:
        owner = os.pread(file, _PID_BYTES, 0).decode(errors="replace").strip()
        return CheckpointError(f"{path}: this checkpoint is in use by {f'process {owner}' if owner else holder}")

    with closed_on_error(file), errors_named(lock, "locked", CheckpointError):
        hold(file, in_use)
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    return file


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.name}.{suffix}")
