"""The folder of each launch on this machine, which stays when the launch is over: its log."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from hierax.runtime.host.private_files import UnsafeFileError, private_folder, read_private, write_private

KEPT_RUNS = 20  # how many folders stay of launches that have ended, the last ones
LOGS = "logs"
ABOUT = "about.json"

Run = TypeVar("Run")


def runs_folder() -> Path:
    """Where the folders of this user's launches are."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".local" / "state") / "hierax" / "runs"


def run_folder(run: str) -> Path:
    """The folder of a launch."""
    return runs_folder() / run


def begin_run(run: str, about: Mapping[str, Any]) -> Path:
    """Make the folder of a launch that begins, and remove those of old ones. `about` is told of it, as JSON; ``pid`` is
    that of the supervisor. Raises `OSError` if it cannot be made, and `UnsafeFileError` if others may write there."""
    folder = run_folder(run)
    with private_folder(folder / LOGS, make=True):
        write_private(folder / ABOUT, json.dumps(about, indent=2).encode() + b"\n")
    for old in known_folders()[KEPT_RUNS:]:
        if not is_alive(old):
            shutil.rmtree(old, ignore_errors=True)  # another launch may be doing the same
    return folder


def unwritable(folder: Path) -> str:
    """Why nothing can be put into a private folder, which is made where it lacks; empty: it can."""
    probe = folder / f".{os.getpid()}.probe"
    try:
        write_private(probe, b"")
        probe.unlink()
    except UnsafeFileError as error:
        return str(error)
    except OSError as error:
        return f"{folder} cannot be written: {error.strerror or error}"
    return ""


def known_folders() -> list[Path]:
    """The folders of launches, the youngest first."""
    folders = [about.parent for about in runs_folder().glob(f"*/{ABOUT}")]
    return sorted(folders, key=_made_ns, reverse=True)


def _made_ns(folder: Path) -> int:
    try:
        return (folder / ABOUT).stat().st_mtime_ns
    except OSError:
        return 0  # removed just now


def about_run(folder: Path) -> dict[str, Any]:
    """What is told of a launch; empty where that cannot be read."""
    try:
        return dict(json.loads(read_private(folder / ABOUT)))
    except (OSError, ValueError, TypeError, RecursionError, UnsafeFileError):
        return {}


def is_alive(folder: Path) -> bool:
    """Whether the launch may still run: there is a process with its supervisor's number."""
    pid = about_run(folder).get("pid")
    return isinstance(pid, int) and pid > 0 and is_process(pid)


def is_process(pid: int) -> bool:
    """Whether this user has a process of this number."""
    try:
        os.kill(pid, 0)
    except OSError:  # there is none, or it is another user's by now
        return False
    return True


def meant(which: str, runs: Sequence[Run], names: Callable[[Run], tuple[str, str]]) -> list[Run]:
    """Those that are called so by run or hierarchy, as `names` gives them, or whose run begins so."""
    named = [(each, *names(each)) for each in runs]
    ways = (
        [each for each, run, _ in named if run == which],
        [each for each, _, hierarchy in named if hierarchy == which],
        [each for each, run, _ in named if which and run.startswith(which)],
    )
    return next(filter(None, ways), [])
