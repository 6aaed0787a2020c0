"""Files about runs: one beside its checkpoints, to go on with it; one in a common place, to find it while it runs."""

import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import (
    HeldError,
    UnsafeFileError,
    errors_named,
    held_file,
    private_folder,
    read_private,
    shown_alive,
    unswept,
    write_private,
)
from hierax.runtime.host.run_folder import NOT_OURS, STATE, files_in, is_sealed, is_there, runs_folder, seal_or_warn
from hierax.runtime.host.run_secret import key_text, read_key
from hierax.runtime.recovery.disk import SLOTS
from hierax.schemas.keys import is_name

_RUN = "run.json"
_OUTDATED = "run.json.outdated"  # the last one, where a change has come into force that could not be written there
_LOCK = "_run.lock"  # in the same folder, held as long as a launch runs; no node can be called so
_KEY = ".key"
_ALIVE = ".lock"
_KINDS = {"deployment": str, "output": str, "settings": list, "seed": int, "terms": dict, "coming": dict}
_TEMPORARY = Path("/tmp")
_PROBE = ".probe"  # written to see that it can be
_LOOPBACK = re.compile(r"[a-z]+/(127(\.\d+){3}|localhost|\[::1\])(:|$)")  # and not a name that begins so


@dataclass(frozen=True)
class Run:
    """What it takes to go on with a run, beside its checkpoints."""

    deployment: str  # path of the file
    settings: Sequence[str]  # with which it was read; of secret ones the paths alone
    seed: int  # of the run
    epochs: int | None  # how many; None: until the world has finished
    output: str  # folder; empty: none
    terms: Mapping[str, Mapping[str, Any]]  # by node, the fields of its `ProcessTerms`
    coming: Mapping[str, Mapping[str, Mapping[str, Any]]]  # by change that was not answered yet, those of its new nodes


@dataclass(frozen=True)
class Running:
    """A launch that runs."""

    run: str  # its identification, by which commands name it
    hierarchy: str  # its name
    endpoint: str  # where its supervisor is reached
    pid: int  # of the supervisor
    deployment: str  # path of the file
    settings: Sequence[str]  # with which it was read; of secret ones the paths alone
    open: bool = False  # whether anybody who reaches it may speak to it; else there is a key beside this

    @property
    def secret(self) -> str:
        """What it takes to speak to it; empty: nothing. Raises `HieraxError` if its key cannot be read."""
        return "" if self.open else read_key(key_path(self.run))


def write_run(state: Path, run: Run, durable: bool = False) -> None:
    """Write it into the folder of the checkpoints, whole or not at all; what is `durable` outlives the machine's crash.
    Raises `HieraxError` if that fails."""
    content = asdict(run)
    _write(state / _RUN, {**content, "seal": seal_or_warn(STATE, content)}, durable)
    with suppress(OSError):
        (state / _OUTDATED).unlink()


def outdate_run(state: Path) -> None:
    """Have nobody go on with a run by what was written before a change, until it is written anew; a full disk has room
    for that."""
    with suppress(OSError):
        (state / _RUN).replace(state / _OUTDATED)


def has_run(state: Path) -> bool:
    """Whether a run has left something in a folder."""
    return (state / _RUN).exists() or (state / _OUTDATED).exists()


def read_run(state: Path, trust: bool = False) -> Run:
    """The run whose checkpoints are in a folder.

    `trust`: whether what it says is run, whoever has written it. Raises `HieraxError` if there is none, or others may
    have written it; or it is not known to be this user's own, and not trusted.
    """
    path = state / _RUN
    try:
        content = json.loads(read_private(path))
        given = content.pop("seal", "")
        if not trust and not (isinstance(given, str) and is_sealed(STATE, content, given)):
            raise HieraxError(f"{path}: {NOT_OURS}")
        return _run(content)
    except FileNotFoundError as error:
        if (state / _OUTDATED).exists():
            why = f"{_RUN} could not be written after the last change of its roster"
            raise HieraxError(f"{state}: the run cannot be resumed: {why}") from error
        raise HieraxError(f"{state}: there is no run to resume: {_RUN} is missing") from error
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise HieraxError(f"{path}: expected what a launch of this version with --state wrote: {error}") from error


def make_state(state: Path) -> None:
    """Make a folder for checkpoints. Raises `HieraxError` if it cannot be written, or others may write there."""
    try:
        write_private(state / _PROBE, b"")
        (state / _PROBE).unlink()
    except OSError as error:
        raise HieraxError(f"--state {state}: it cannot be written: {error.strerror or error}") from error
    except UnsafeFileError as error:
        raise HieraxError(f"--state {error}") from error


@contextmanager
def held_state(state: Path, resumes: bool, overwrite: bool = False) -> Iterator[None]:
    """Have a folder for checkpoints, as `make_state` makes it, for this launch alone, until the block or this process
    ends. A run that does not resume the one there begins only where there is none; `overwrite` removes what is left of
    one. Raises `HieraxError` as `make_state` does, if another launch has the folder, or if there is a run in it."""
    make_state(state)
    with held_file(state / _LOCK, lambda holder: _in_use(state, holder)):
        left = [] if resumes else _left_in(state)
        if left and not overwrite:
            what = f"there is a run in it already ({left[0].name})"
            how = f"--resume {state} goes on with it, --overwrite removes it and begins anew, or name another folder"
            raise HieraxError(f"--state {state}: {what}; {how}")
        for path in left:
            path.unlink(missing_ok=True)
        yield


def _in_use(state: Path, holder: str) -> HeldError:
    return HeldError(
        f"{state}: {holder} is running with its checkpoints there; wait for its end, or name another folder"
    )


def _left_in(state: Path) -> list[Path]:
    """The files of a run in a folder: first what it takes to resume it, then its checkpoints, which have locks."""
    slots = [lock.with_suffix(f".{slot}") for lock in sorted(state.glob("*.lock")) for slot in range(SLOTS)]
    return [path for path in (state / _RUN, state / _OUTDATED, *slots) if path.exists()]


@contextmanager
def passing_state() -> Iterator[Path]:
    """A temporary folder for checkpoints, which goes at the block's end."""
    with tempfile.TemporaryDirectory(prefix="hierax-", ignore_cleanup_errors=True) as name, unswept(Path(name)):
        yield Path(name)


@contextmanager
def known_here(running: Running, secret: str = "") -> Iterator[None]:
    """Have a run be known here, as `register` does, until the block ends, or this process does, however that is."""
    folder = _fit_folder()
    with errors_named(folder):
        alive = shown_alive(folder / f"{running.run}{_ALIVE}")  # before anybody finds it, and looks whether it is
    try:
        with unswept(register(running, secret).parent):
            yield
    finally:
        forget(running.run)
        os.close(alive)


def register(running: Running, secret: str = "") -> Path:
    """Make a run known here until it is forgotten, by a file beside its key. Raises `HieraxError` if that fails."""
    folder = _fit_folder()
    if secret:
        with errors_named(folder):
            write_private(folder / f"{running.run}{_KEY}", key_text(secret))
    path = folder / f"{running.run}.json"
    _write(path, asdict(running))
    return path


def forget(run: str) -> None:
    """Have a run not be known here any more; its key is good for nothing."""
    for folder in launch_folders():
        for suffix in (".json", _KEY, _ALIVE):
            with suppress(OSError):
                (folder / f"{run}{suffix}").unlink()


def key_path(run: str) -> Path:
    """Where the key of a run is, if that is closed, and known here."""
    paths = [folder / f"{run}{_KEY}" for folder in launch_folders()]
    return next(filter(_is_own, paths), paths[0])


def _is_own(path: Path) -> bool:
    """Whether a file is there that this user has written: others may have taken the folder, and names in it."""
    try:
        return os.lstat(path).st_uid == os.geteuid()
    except OSError:
        return False


def is_loopback(endpoint: str) -> bool:
    """Whether an endpoint is reached from its own machine alone."""
    return _LOOPBACK.match(endpoint) is not None


def warning_of(endpoint: str, secret: str) -> str:
    """What everybody is told who has to do with a launch that is not protected as others are; empty: it is."""
    if not secret:
        return f"open: true: anybody who reaches {endpoint} may read and change this run"
    if endpoint.startswith("tcp/") and not is_loopback(endpoint):
        return f"insecure: true: what is said to and from {endpoint} passes between machines unencrypted"
    return ""


def known_runs() -> list[Running]:
    """The launches that run on this machine; what dead ones left behind is removed."""
    _fit_folder()
    found = {}
    for folder in launch_folders():
        for path in files_in(folder, "*.json"):
            try:
                running = _running(json.loads(read_private(path)))
                is_alive = is_there(path.with_suffix(_ALIVE), running.pid)
            except (OSError, ValueError, TypeError, UnsafeFileError, RecursionError):
                continue  # being written or removed, of another version, or another user's
            if is_alive:
                found[running.run] = running
            else:
                forget(running.run)
    return [found[run] for run in sorted(found)]


def launch_folders() -> list[Path]:
    """Where runs may be found. In the system's temporary folder, anybody may have taken the name."""
    given = os.environ.get("XDG_RUNTIME_DIR")
    if given:
        return [Path(given) / "hierax"]
    return [_TEMPORARY / f"hierax-{os.getuid()}" / "hierax", runs_folder().parent / "running"]


def _fit_folder() -> Path:
    """Where runs can be registered. Raises `HieraxError` if that is nowhere."""
    why = ""
    for folder in launch_folders():
        try:
            with private_folder(folder, make=True):
                return folder
        except UnsafeFileError as error:  # noqa: PERF203 - each for itself
            why = f"{error}; set XDG_RUNTIME_DIR to a folder of your own"
        except OSError as error:
            why = f"{folder}: the folder of runs cannot be made: {error.strerror or error}"
    raise HieraxError(why)


def _running(content: Any) -> Running:
    running = Running(**content)
    if not (is_name(running.run) and is_name(running.hierarchy) and running.pid > 0):
        raise ValueError("expected names of a run and its hierarchy, and a process")
    return running


def _run(content: Any) -> Run:
    run = Run(**content)
    for name, kind in _KINDS.items():
        if not isinstance(getattr(run, name), kind):
            raise TypeError(f"{name}: expected a {kind.__name__}, got {getattr(run, name)!r:.40}")
    if run.epochs is not None and not isinstance(run.epochs, int):
        raise TypeError(f"epochs: expected a number, got {run.epochs!r:.40}")
    return run


def _write(path: Path, content: Mapping[str, Any], durable: bool = False) -> None:
    with errors_named(path):
        write_private(path, json.dumps(content, indent=2).encode() + b"\n", durable=durable)
