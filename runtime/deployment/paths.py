"""Paths in a deployment file, as keys, and as text that errors show and ``--set`` takes; and these errors."""

from __future__ import annotations

import re
from typing import Any

from hierax.runtime.core.errors import HieraxError

Keys = tuple[str | int, ...]  # the path of a value: names and, in lists, numbers from 0

_INDEX = re.compile(r"\[(\d+)\]")
_ARROW = re.compile(r"\s*->\s*")


class DeploymentError(HieraxError):
    """A deployment file, or a ``--set``, is wrong. The place is ``file:line``, the file alone, or the ``--set`` as it
    was given; the field is its path, or empty; what is wrong is told with what was expected, and the nearest valid
    name."""

    def __init__(self, what: str, place: str, field: str = "") -> None:
        self.what, self.place, self.field = what, place, field
        super().__init__(": ".join(part for part in (place, field, what) if part))


def field_text(keys: Keys) -> str:
    """A path as errors show it: ``nodes.world.parameters.noise[2]``."""
    text = ""
    for key in keys:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else key
    return text


def edge_name(text: str) -> str:
    """An edge's name with one space on both sides of the arrow."""
    return _ARROW.sub(" -> ", text.strip())


def normal_path(text: str) -> str:
    """A path with ``.0`` for ``[0]`` and one way to write an edge."""
    text = _INDEX.sub(r".\1", text.strip())
    head, dot, rest = text.partition(".")
    return f"{head}{dot}{edge_name(rest)}" if head == "edges" else text


def inside(value: Any, key: str | int) -> Any:
    """What a list or map has at a key; None: nothing."""
    if isinstance(value, list) and isinstance(key, int):
        return value[key]
    return value.get(key) if isinstance(value, dict) else None


def longest_key(value: Any, rest: str) -> str | int | None:
    """The longest key of a map, or the number of a list's item, that `rest` begins with."""
    if isinstance(value, list):
        token = rest.partition(".")[0]
        return int(token) if token in map(str, range(len(value))) else None
    if not isinstance(value, dict):
        return None
    fitting = [key for key in value if rest == key or rest.startswith(f"{key}.")]
    return max(fitting, key=len, default=None)
