"""Where deployment files and the modules that they name are looked for."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from hierax.runtime.deployment.paths import DeploymentError
from hierax.runtime.loading.nearest import did_you_mean

MAX_FILE_BYTES = 1 << 22
_SUFFIXES = (".yaml", ".yml")


def shipped() -> dict[str, Path]:
    """The deployment files that come with hierax, by name."""
    folder = Path(str(files("hierax.deploy")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_file(name: str | Path) -> Path:
    """The deployment file of a path or a shipped name; `DeploymentError` with the nearest one if there is none."""
    path = Path(name)
    try:
        if path.is_file():
            return path
        exists = path.exists()
    except (OSError, ValueError) as error:  # a name that no file can have
        raise DeploymentError(f"cannot be read: {error}", str(name)) from error
    known = shipped()
    if str(name) in known:
        return known[str(name)]
    if exists:
        raise DeploymentError("is no file; expected a deployment file or the name of a shipped one", str(name))
    wrong = path.stem if path.suffix in _SUFFIXES else path.name
    nearest = did_you_mean(wrong, known, "the shipped ones are")
    raise DeploymentError(f"there is no such file, and no shipped deployment of that name{nearest}", str(name))


def read_text(path: Path) -> str:
    """A file's text. Raises `DeploymentError` if it cannot be read, is too large, or not UTF-8."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise DeploymentError(f"cannot be read: {error.strerror or error}", str(path)) from error
    if len(data) > MAX_FILE_BYTES:
        raise DeploymentError(f"has more than {MAX_FILE_BYTES} bytes; is it a deployment file?", str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"byte {data[error.start]:#04x} is not UTF-8; save the file as UTF-8"
        raise DeploymentError(what, f"{path}:{line}") from error


def import_paths(path: Path) -> tuple[str, ...]:
    """The folders in which a deployment's own modules are looked for: the file's, and the current one."""
    return tuple(dict.fromkeys((str(path.resolve().parent), str(Path.cwd()))))
