"""Files that nodes read: what is wrong with one is told in a line, with what was expected."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from yaml.constructor import ConstructorError

from hierax.runtime.core.errors import HieraxError

UNFINISHED = ".part"  # what the name of a file that is being written ends with

UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
MAX_FILE_BYTES = 1 << 26  # of a model, an image, a calibration
_HUGE = 10**300


class DataError(HieraxError):
    """A file, or what a camera gives, is missing or damaged; the message names it and what was expected."""


def told_of(error: Exception) -> str:
    """The kind of an error of a library, and the first line of what it says."""
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]:.200}"


def read_file(path: Path, expected: str) -> bytes:
    """What is in a file. Raises DataError, which says what was expected: it is missing, no file, or too large."""
    try:
        if path.exists() and not path.is_file():  # reading a FIFO waits for ever
            raise DataError(f"{path}: is no file; expected {expected}")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file; expected {expected}") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}; expected {expected}") from error
    if len(data) > MAX_FILE_BYTES:
        raise DataError(f"{path}: has more than {MAX_FILE_BYTES} bytes; expected {expected} of at most that")
    return data


class Loader(yaml.SafeLoader):
    """Reads what PyYAML and OpenCV's FileStorage write."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """What a node holds. Raises ConstructorError: it is not what its tag says; PyYAML has errors of many kinds."""
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, ValueError) as error:
            what = f"{shown(node.value)} cannot be read as {node.tag.rpartition(':')[2]:.40}"
            raise ConstructorError(None, None, what, node.start_mark) from error


def _matrix(loader: Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)
_FLOAT = re.compile(r"[-+]?[0-9]*\.?[0-9]*e[-+]?[0-9]+$", re.IGNORECASE)  # YAML 1.1 would have a dot and a sign
Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, "-+.0123456789")


def read_yaml(path: Path, expected: str) -> dict[str, Any]:
    """A YAML file that holds a map. Raises DataError, which says what was expected: it is missing or damaged."""
    text = read_file(path, expected).decode("utf-8", "replace")
    if text.startswith("%YAML:"):  # no YAML, but all else of it is
        text = text.partition("\n")[2]
    try:
        content = yaml.load(text, Loader)
    except yaml.MarkedYAMLError as error:
        at = "" if error.problem_mark is None else f", line {error.problem_mark.line + 1}"
        raise DataError(f"{path}{at}: {error.problem or error.context}; expected {expected}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(f"{path}: {str(error).splitlines()[0]:.100}; expected {expected}") from error
    if not isinstance(content, dict):
        raise DataError(f"{path}: expected a map, {expected}")
    return content


def read_numbers(where: str, entry: Any, key: str, count: int) -> NDArray[np.float64]:
    """A list of so many finite numbers. Raises DataError: it is missing, or something else."""
    values = entry.get(key) if isinstance(entry, dict) else None
    if isinstance(values, list) and len(values) == count and all(type(value) in (int, float) for value in values):
        numbers = np.array([float(min(max(value, -_HUGE), _HUGE)) for value in values])
        if np.all(np.isfinite(numbers)):
            return numbers
    raise DataError(f"{where}: {key}: expected {count} numbers")


def shown(value: Any) -> str:
    """What came in place of what was expected, as errors tell it: a list or a map by its type alone, as a small file
    may have huge ones, and a number that is too long to be written likewise."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a map"
    return "a huge number" if isinstance(value, int) and abs(value) > _HUGE else f"{value!r:.40}"


@contextmanager
def writing(path: Path | None = None) -> Iterator[None]:
    """`DataError` for what the system refuses meanwhile: it names the path, or else the file that the system names."""
    try:
        yield
    except OSError as error:
        raise DataError(f"{path or error.filename}: cannot be written: {error.strerror}") from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is whole at every moment at which it is there. Raises DataError: it cannot be written; nothing
    of it is left then."""
    unfinished = path.with_name(path.name + UNFINISHED)
    try:
        with writing(path):
            unfinished.write_bytes(content)
            os.replace(unfinished, path)
    except DataError:
        with suppress(OSError):
            unfinished.unlink()
        raise
