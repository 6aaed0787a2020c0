"""Files about runs: one beside its checkpoints, to go on with it; one in a common place, to find it while it runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HieraxError

_RUN = "run.json"


@dataclass(frozen=True)
class Run:
    """What it takes to go on with a run, beside its checkpoints.

    Attributes:
        deployment: path of the file.
        settings: with which it was read.
        seed: of the run.
        epochs: how many; None: until the world has finished.
        output: folder; empty: none.
        lineages: by node that was attached or replaced, the name of its checkpoint.
        restarts: by node, the fields of its `RestartPolicy`.
    """

    deployment: str
    settings: Sequence[str]
    seed: int
    epochs: int | None
    output: str
    lineages: Mapping[str, str]
    restarts: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Running:
    """A launch that runs.

    Attributes:
        run: its identification, by which commands name it.
        hierarchy: its name.
        endpoint: where its supervisor is reached.
        pid: of the supervisor.
        deployment: path of the file.
        settings: with which it was read.
    """

    run: str
    hierarchy: str
    endpoint: str
    pid: int
    deployment: str
    settings: Sequence[str]

    @property
    def alive(self) -> bool:
        """Whether the supervisor's process is still there."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True
        return True


def write_run(state: Path, run: Run) -> None:
    """Write it into the folder of the checkpoints, whole or not at all.

    Raises:
        HieraxError: it cannot be written.
    """
    _write(state / _RUN, asdict(run))


def read_run(state: Path) -> Run:
    """The run whose checkpoints are in a folder.

    Raises:
        HieraxError: there is none.
    """
    path = state / _RUN
    try:
        return Run(**json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError as error:
        raise HieraxError(f"{state}: there is no run to resume: {_RUN} is missing") from error
    except (OSError, ValueError, TypeError) as error:
        raise HieraxError(f"{path}: expected what a launch with --state wrote: {error}") from error


def register(running: Running) -> Path:
    """Make a run known on this machine; the file is to be removed when it is over.

    Raises:
        HieraxError: it cannot be written.
    """
    path = _folder() / f"{running.run}.json"
    _write(path, asdict(running))
    return path


def known_runs() -> list[Running]:
    """The launches that run on this machine; what dead ones left behind is removed."""
    found = []
    for path in sorted(_folder().glob("*.json")):
        try:
            running = Running(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            continue  # being written, removed, or of another version
        if running.alive:
            found.append(running)
        else:
            path.unlink(missing_ok=True)
    return found


def _folder() -> Path:
    """Where runs are found: a folder of this user's alone."""
    base = os.environ.get("XDG_RUNTIME_DIR") or f"/tmp/hierax-{os.getuid()}"
    folder = Path(base) / "hierax"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            raise HieraxError(f"{folder} belongs to another user; set XDG_RUNTIME_DIR to a folder of your own")
    except OSError as error:
        raise HieraxError(f"{folder}: the folder of runs cannot be made: {error.strerror or error}") from error
    return folder


def _write(path: Path, content: Mapping[str, Any]) -> None:
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        raise HieraxError(f"{path}: cannot be written: {error.strerror or error}") from error
