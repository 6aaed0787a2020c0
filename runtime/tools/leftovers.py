"""What launches leave behind when they are killed: processes, and folders of checkpoints."""

import os
import re
import signal
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from hierax.runtime.host.private_files import is_held

NODE_PROCESS = "hierax.runtime.launch.forking"  # what they are forked from, and so they themselves
_FOLDER = re.compile(r"hierax-[a-z0-9_]{8}")
_OURS = re.compile(r".+\.(0|1|lock|budget|times|overruns)|run\.json(\.outdated)?")


class Orphan(NamedTuple):
    """A process of a node without a supervisor; `began` tells it from a later one with its number."""

    pid: int
    began: str


def orphaned_processes(proc: Path = Path("/proc")) -> Iterator[Orphan]:
    """This user's processes of nodes whose parent is no Python program any more. A node's process ends within 2 s when
    its supervisor dies; one that hangs in an operator may not."""
    for folder in sorted(proc.glob("[0-9]*")):
        with suppress(OSError, IndexError):  # it has ended just now
            if folder.stat().st_uid != os.getuid() or NODE_PROCESS not in _command(folder):
                continue
            state, parent, began = _status(folder)
            above = _command(proc / parent) or [""]
            if state != "Z" and "python" not in Path(above[0]).name and "hierax" not in above:
                yield Orphan(int(folder.name), began)


def end_process(orphan: Orphan) -> None:
    """Kill an orphan, if it is still the same process."""
    try:
        handle = os.pidfd_open(orphan.pid)
    except ProcessLookupError:
        return
    try:
        if _status(Path(f"/proc/{orphan.pid}"))[2] == orphan.began:
            signal.pidfd_send_signal(handle, signal.SIGKILL)
    except (ProcessLookupError, FileNotFoundError):
        return
    finally:
        os.close(handle)


def _command(process: Path) -> list[str]:
    try:
        return [part.decode(errors="replace") for part in (process / "cmdline").read_bytes().split(b"\0")]
    except FileNotFoundError:
        return []


def _status(process: Path) -> tuple[str, str, str]:
    """State, parent's number, and when it began."""
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    return fields[0], fields[1], fields[19]


def unused_folders(base: Path | None = None) -> Iterator[Path]:
    """This user's temporary folders of launches in which no checkpoint is in use."""
    for folder in sorted((base or Path(tempfile.gettempdir())).glob("hierax-*")):
        if _FOLDER.fullmatch(folder.name) and _is_unused(folder):
            yield folder


def _is_unused(folder: Path) -> bool:
    try:
        files = list(folder.iterdir())
        if folder.is_symlink() or folder.stat().st_uid != os.getuid() or not files:
            return False
        if not all(_OURS.fullmatch(path.name) for path in files):
            return False  # not ours after all
        return not any(is_held(os.open(path, os.O_RDONLY | os.O_CLOEXEC)) for path in files if path.suffix == ".lock")
    except OSError:
        return False  # being removed
