"""The folder of each launch on this machine, which stays when the launch is over: its log; and, beside them, the key of
this user's seals, by which what own runs have written can be told from what somebody else has, or has changed.

A key is 32 random bytes, for each user on each machine. What runs say of themselves is sealed with it (keyed BLAKE2b)
when it is written; only who has the key could have made a seal that fits."""

import functools
import hmac
import json
import logging
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from hashlib import blake2b
from pathlib import Path
from secrets import token_bytes
from typing import Any, TypeVar

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import (
    UnsafeFileError,
    is_shown_alive,
    private_folder,
    read_private,
    write_private,
)

KEPT_RUNS = 20  # how many folders stay of launches that have ended, the last ones
LOGS = "logs"
ABOUT = "about.json"
ALIVE = "alive.lock"  # by which the launch is shown alive

Run = TypeVar("Run")
RECORDING, STATE = "recording", "state"  # what is sealed: no seal of one fits the other
KEY_BYTES = 32
SEAL_BYTES = 32

NOT_OURS = (
    "it names code to run, and nothing shows that this user has written it on this machine and nobody has changed it; "
    "--trust loads and runs what it names"
)
"""Why something is refused that has no seal of ours."""

_log = logging.getLogger("hierax")


def runs_folder() -> Path:
    """Where the folders of this user's launches are."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".local" / "state") / "hierax" / "runs"


def run_folder(run: str) -> Path:
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
    folders = [about.parent for about in files_in(runs_folder(), f"*/{ABOUT}")]
    return sorted(folders, key=_made_ns, reverse=True)


def files_in(folder: Path, pattern: str) -> list[Path]:
    """What is in a folder by that pattern, in order; nothing where it may not be entered, or there can be none."""
    try:
        return sorted(folder.glob(pattern))
    except OSError:
        return []


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
    """Whether the launch may still run."""
    pid = about_run(folder).get("pid")
    return isinstance(pid, int) and pid > 0 and is_there(folder / ALIVE, pid)


def is_there(shown: Path, pid: int) -> bool:
    """Whether there is a supervisor that is shown alive by a file. Where there is no such file, as older versions make
    none, it is if this user has a process of its number, which another process may have by now."""
    alive = is_shown_alive(shown)
    return is_process(pid) if alive is None else alive


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


class NoKeyError(HieraxError):
    """No key can be kept or read; says where, and why."""


def key_file() -> Path:
    """Where the user's key is."""
    return runs_folder().parent / "key"


def seal(what: str, content: Mapping[str, Any]) -> str:
    """The seal of a `RECORDING` or `STATE` with this content, as JSON. Raises `NoKeyError` if no key can be kept."""
    return _sealed(what, content, _key(make=True))


def seal_or_warn(what: str, content: Mapping[str, Any]) -> str:
    """Seal as `seal` does; empty where nothing can be sealed, which is told once."""
    try:
        return seal(what, content)
    except NoKeyError as error:
        _warn(f"what this run leaves will not be known to be yours, and take --trust: {error}")
        return ""


@functools.cache
def _warn(text: str) -> None:
    _log.warning("%s", text)


def is_sealed(what: str, content: Mapping[str, Any], given: str) -> bool:
    """Whether this user wrote a `RECORDING` or `STATE` here, unchanged since; its content is without the given seal."""
    if not given:
        return False
    try:
        wanted = _sealed(what, content, _key(make=False))
    except (NoKeyError, TypeError, ValueError):  # no key, or what nobody could have sealed
        return False
    return hmac.compare_digest(wanted.encode(), given.encode(errors="replace"))


def _sealed(what: str, content: Mapping[str, Any], key: bytes) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return blake2b(text.encode(), key=key, digest_size=SEAL_BYTES, person=what.encode()).hexdigest()


def _key(make: bool) -> bytes:
    """The user's key. Raises `NoKeyError` if there is none, or it is not this user's alone."""
    path = key_file()
    try:
        if make and not path.exists():  # where another process makes one at the same time, it is that one
            write_private(path, token_bytes(KEY_BYTES), replaces=False)
        key = read_private(path)
    except UnsafeFileError as error:
        raise NoKeyError(str(error)) from error
    except OSError as error:
        raise NoKeyError(f"{path}: {error.strerror or error}") from error
    if len(key) != KEY_BYTES:
        what = f"expected {KEY_BYTES} bytes that nobody else can read; remove it to have another made"
        raise NoKeyError(f"{path}: {what}")
    return key
