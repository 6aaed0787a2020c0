"""Files and folders that nobody else has put there: opened without following links, looked at when they are open.

What a launch believes later (checkpoints, what it takes to resume, where launches are found)
is in folders that nobody else can write to, and no other user can read it. What a run gives
its user (outputs, recordings) is as readable as that user's other files."""

import errno
import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

from hierax.runtime.core.errors import HieraxError

FILE_MODE, FOLDER_MODE = 0o600, 0o700
LARGEST = 16 << 20  # how many bytes a private file that is read at once may have
_AT_ONCE = os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK  # the flags for all files; a FIFO is refused, not waited for
_LOOK = os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_LINKS = 40
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class UnsafeFileError(HieraxError):
    """A file or folder is somebody else's, or open to others; says which and why."""


class HeldError(HieraxError):
    """Another process writes a file; says which one."""


@contextmanager
def errors_named(place: Path | str, done: str = "written", kind: type[HieraxError] = HieraxError) -> Iterator[None]:
    """The machine's errors as ours: what cannot be done with a file or folder, and why."""
    try:
        yield
    except OSError as error:
        raise kind(f"{place}: cannot be {done}: {error.strerror or error}") from error


def check_encodable(place: Path | str) -> None:
    """Raises `HieraxError` where a path is not UTF-8, as all has to be that a run says of itself."""
    try:
        str(place).encode()
    except UnicodeEncodeError as error:
        raise HieraxError(f"{place}: expected a path in UTF-8; rename what is not, or name another one") from error


@contextmanager
def private_folder(path: Path, make: bool = False) -> Iterator[int]:
    """A folder that nobody but this user can put anything into, nor into those above it, open for `open_private`.
    `make` has it made, and those above it, where they lack, for this user alone. Raises `UnsafeFileError` if it or a
    folder above it is another user's, or others may write there, and `OSError` if it cannot be opened or made."""
    folder = _walked(path, make)
    try:
        found = os.fstat(folder)
        if found.st_uid != os.geteuid():
            raise UnsafeFileError(f"{path} belongs to another user (uid {found.st_uid}); expected a folder of your own")
        if found.st_mode & _OTHERS_WRITE:
            mode = f"others may write there (mode {stat.S_IMODE(found.st_mode):04o})"
            raise UnsafeFileError(f"{path}: {mode}; expected a folder for you alone: chmod 700")
        yield folder
    finally:
        os.close(folder)


def open_private(folder: int, name: str, flags: int, path: Path) -> int:
    """Open a file of this user alone in a `private_folder`; one that others could read is theirs no more. The flags are
    those of `os.open`, and errors name the path. Raises `UnsafeFileError` if it is a link, no regular file, or another
    user's, and `OSError` if it cannot be opened."""
    with _links_named(path):
        file = os.open(name, flags & ~os.O_TRUNC | _AT_ONCE, FILE_MODE, dir_fd=folder)
    with closed_on_error(file):
        if _own(file, path).st_mode & 0o077:
            os.fchmod(file, FILE_MODE)
        if flags & os.O_TRUNC:
            os.ftruncate(file, 0)
    return file


def read_private(path: Path) -> bytes:
    """What is in a private file; `UnsafeFileError` if it may not be this user's alone, or is large, or `OSError`."""
    with private_folder(path.parent) as folder:
        file = open_private(folder, path.name, os.O_RDONLY, path)
    with os.fdopen(file, "rb") as stream:
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise UnsafeFileError(f"{path}: is larger than {LARGEST} bytes, so it is not what hierax writes there")
    return content


def write_private(path: Path, content: bytes, replaces: bool = True, durable: bool = False) -> None:
    """Write a private file, whole or not at all; its folder is made where it lacks. One that `replaces` none is left
    out where another process has made one meanwhile; that one, and what is `durable`, is on the disk for good. Raises
    `UnsafeFileError` if its folder is not of this user alone, and `OSError` if it cannot be written."""
    unfinished = f".{path.name}.{token_hex(4)}.tmp"
    with private_folder(path.parent, make=True) as folder:
        file = open_private(folder, unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, path)
        try:
            with os.fdopen(file, "wb") as stream:
                stream.write(content)
                if durable or not replaces:
                    stream.flush()
                    os.fsync(stream.fileno())
            if replaces:
                os.rename(unfinished, path.name, src_dir_fd=folder, dst_dir_fd=folder)
                if durable:
                    os.fsync(folder)
            else:
                with suppress(FileExistsError):
                    os.link(unfinished, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        finally:
            with suppress(FileNotFoundError):  # renamed
                os.unlink(unfinished, dir_fd=folder)


def open_result(path: Path | str, append: bool = False, private: bool = False) -> int:
    """Open a file that a run writes for its user, to be read and written; what is in it stays. Its folder is there.
    `append` has everything go to its end; `private` has it for this user alone. Raises `UnsafeFileError` if it is a
    link, no regular file, or another user's, and `OSError` if it cannot be opened."""
    flags = os.O_RDWR | os.O_CREAT | _AT_ONCE | (os.O_APPEND if append else 0)
    with _links_named(path):
        file = os.open(path, flags, FILE_MODE if private else 0o666)
    with closed_on_error(file):
        if _own(file, path).st_mode & 0o077 and private:  # it was there before
            os.fchmod(file, FILE_MODE)
    return file


def write_result(path: Path, content: bytes) -> None:
    """Write a file for the user; what was in it is gone. Raises as `open_result` does."""
    with os.fdopen(open_result(path), "wb") as file:
        file.truncate(0)
        file.write(content)


def hold(file: int, refusal: Callable[[str], HieraxError]) -> None:
    """Have an open file for this process, and those that inherit it; else the refusal of who has it is raised."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise refusal(_holder(file)) from error


def open_held(path: Path | str, refusal: Callable[[str], HieraxError]) -> int:
    """Open a file that a run writes for its user, as `open_result` does, and `hold` it. Raises as both do."""
    while True:
        file = open_result(path)
        with closed_on_error(file), errors_named(path, "locked"):
            hold(file, refusal)
        if _is_at(path, file):
            return file
        os.close(file)  # who had it has removed it meanwhile, as nothing was in it


def close_held(path: Path | str, file: int) -> None:
    """Let go of a file that `open_held` gave; one that is empty is removed."""
    try:
        if not os.fstat(file).st_size and _is_at(path, file):
            os.unlink(path)
    finally:
        os.close(file)


def _is_at(path: Path | str, file: int) -> bool:
    """Whether an open file is the one that is found at a path."""
    try:
        return os.path.samestat(os.lstat(path), os.fstat(file))
    except FileNotFoundError:
        return False


@contextmanager
def held_file(path: Path, refusal: Callable[[str], HieraxError]) -> Iterator[None]:
    """Hold a private file, made where it lacks, as `hold` does; the kernel lets go of it where the process ends before
    the block. Raises the refusal, `UnsafeFileError` as `open_private` does, `HieraxError` if it cannot be locked."""
    with errors_named(path, "locked"), private_folder(path.parent) as folder:
        file = open_private(folder, path.name, os.O_RDWR | os.O_CREAT, path)
    try:
        with errors_named(path, "locked"):
            hold(file, refusal)
        yield
    finally:
        os.close(file)


def shown_alive(path: Path) -> int:
    """Show that this process is there by a private file, made where it lacks, for as long as the descriptor that is
    given is open. It holds between containers, and over starts anew, where numbers of processes mean others. On a file
    system without locks there is no file. Raises as `open_private` does."""
    with private_folder(path.parent, make=True) as folder:
        file = open_private(folder, path.name, os.O_RDWR | os.O_CREAT, path)
        with closed_on_error(file):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.unlink(path.name, dir_fd=folder)
    return file


def is_shown_alive(path: Path) -> bool | None:
    """Whether a process is there that has `shown_alive` by a file; None: none has. Where it cannot be told, one is."""
    try:
        with private_folder(path.parent) as folder:
            file = open_private(folder, path.name, os.O_RDONLY, path)
    except FileNotFoundError:
        return None
    except (OSError, UnsafeFileError):
        return True
    return is_held(file)


def is_held(file: int) -> bool:
    """Whether a process holds a file, by a descriptor of it, which is closed. Where it cannot be told, one does."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(file)
    return False


@contextmanager
def unswept(folder: Path) -> Iterator[None]:
    """Have a folder, and all in it, left alone by what sweeps temporary folders, until the block or this process ends.

    A file that is mapped looks, on tmpfs, as old as it was when it was opened, however often it is written to.
    systemd-tmpfiles passes over folders that somebody has locked; nobody else is kept out. Raises `OSError` if the
    folder cannot be opened."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        yield
    finally:
        os.close(file)


def _walked(path: Path, make: bool) -> int:
    """A folder, opened from the root on, so that nobody can exchange one that was looked at already."""
    left = _parts(os.path.join(os.getcwd(), path))
    links = 0
    folder = _root()
    try:
        while left:
            name = left.pop()
            inner = _inner(folder, name, make)
            with closed_on_error(inner):
                target = _target(inner, name, path, is_last=not left)
            if not target:
                os.close(folder)
                folder = inner
                continue
            os.close(inner)
            links += 1
            if links > _MOST_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
            left += _parts(target)
            if target.startswith("/"):
                os.close(folder)
                folder = _root()
        return folder
    except BaseException:
        os.close(folder)
        raise


def _root() -> int:
    return os.open("/", _LOOK | os.O_DIRECTORY)


def _parts(path: str) -> list[str]:
    """The names in a path, the first one last."""
    return [part for part in reversed(path.split("/")) if part not in ("", ".")]


def _target(inner: int, name: str, path: Path, *, is_last: bool) -> str:
    """Where a link on the way leads to; empty: it is a folder. Raises `UnsafeFileError` if others could change that."""
    found = os.fstat(inner)
    is_link = stat.S_ISLNK(found.st_mode)
    if is_link or not is_last:
        # the last one: root, where a container calls it otherwise
        if found.st_uid not in (0, os.geteuid(), os.stat("/").st_uid):
            raise UnsafeFileError(f"{path}: {name!r} on the way there belongs to another user (uid {found.st_uid})")
        if not is_link and found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
            raise UnsafeFileError(f"{path}: anybody may exchange what is in {name!r} on the way there")
    return os.readlink("", dir_fd=inner) if is_link else ""


def _inner(folder: int, name: str, make: bool) -> int:
    """What is in a folder, a link itself and not where it leads to."""
    try:
        inner = os.open(name, _LOOK, dir_fd=folder)
    except FileNotFoundError:
        if not make:
            raise
        with suppress(FileExistsError):
            os.mkdir(name, FOLDER_MODE, dir_fd=folder)
        inner = os.open(name, _LOOK, dir_fd=folder)
    if stat.S_IFMT(os.fstat(inner).st_mode) in (stat.S_IFDIR, stat.S_IFLNK):
        return inner
    os.close(inner)
    raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))


def _own(file: int, path: Path | str) -> os.stat_result:
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode):
        raise UnsafeFileError(f"{path} is no regular file")
    if found.st_uid != os.geteuid():
        raise UnsafeFileError(f"{path} belongs to another user (uid {found.st_uid})")
    return found


@contextmanager
def closed_on_error(file: int) -> Iterator[None]:
    """Close a descriptor where the block raises."""
    try:
        yield
    except BaseException:
        os.close(file)
        raise


@contextmanager
def _links_named(path: Path | str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise UnsafeFileError(f"{path} is a symbolic link, which is not followed") from error
        if error.errno == errno.ENXIO:
            raise UnsafeFileError(f"{path} is no regular file") from error
        raise


def _holder(file: int) -> str:
    """Which process has a file open too, in words."""
    wanted, mine = os.fstat(file), str(os.getpid())
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == mine:
            continue
        with suppress(OSError):  # it has ended, or is another user's
            for each in (process / "fd").iterdir():
                with suppress(OSError):
                    if os.path.samestat(each.stat(), wanted):
                        return f"process {process.name}"
    return "another process"
