"""Values as a few lines of text, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hierax.runtime.core.elements import Value

MOST_LINES = 200
"""How many lines one value takes at most; what is longer is cut off, and says so."""

MOST_ITEMS = 16
"""How many items an array that is written out, or a list, has at most."""

MOST_CHARS, MOST_FIGURES = 80, 4


def belief_text(belief: Value) -> str:
    """A belief as an outline: a line for each part, large arrays by shape alone."""
    lines = list(_lines(belief, ""))
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], f"… {len(lines) - MOST_LINES} more lines"]
    return "\n".join(lines)


def figures_text(figures: Mapping[str, float]) -> str:
    """The first figures, a line each."""
    return "\n".join(f"{name} {number:.4g}" for name, number in list(figures.items())[:MOST_FIGURES])


def _lines(value: Value, indent: str) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _entry(f"{key}:", item, indent)
        return
    if _is_matrix(value):
        yield from (f"{indent}{_array(row)}" for row in value)
        return
    if isinstance(value, (tuple, list)) and not _short(value):
        for item in value[:MOST_ITEMS]:
            yield from _entry("-", item, indent)
        if len(value) > MOST_ITEMS:
            yield f"{indent}… {len(value) - MOST_ITEMS} more"
        return
    yield f"{indent}{_leaf(value)}"


def _entry(head: str, item: Value, indent: str) -> Iterator[str]:
    if _short(item):
        yield f"{indent}{head} {_leaf(item)}"
        return
    yield f"{indent}{head}"
    yield from _lines(item, indent + "  ")


def _short(value: Value) -> bool:
    """Whether it fits on a line."""
    if isinstance(value, Mapping):
        return not value
    if isinstance(value, (tuple, list)):
        return len(value) <= MOST_ITEMS and not any(
            isinstance(item, (Mapping, tuple, list, np.ndarray)) for item in value
        )
    return not _is_matrix(value)


def _is_matrix(value: Value) -> bool:
    """Whether it is an array that is written out row by row."""
    return isinstance(value, np.ndarray) and value.ndim == 2 and 0 < value.size <= MOST_ITEMS


def _leaf(value: Value) -> str:
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(_leaf(item) for item in value) + "]"
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, (bytes, bytearray, memoryview)):
        return f"{len(value)} bytes"
    text = str(value) if not isinstance(value, Mapping) else "{}"
    return text if len(text) <= MOST_CHARS else text[: MOST_CHARS - 1] + "…"


def _array(array: np.ndarray[Any, Any]) -> str:
    if array.size > MOST_ITEMS:
        return f"{array.dtype} {' × '.join(str(length) for length in array.shape)}"
    return str(_rounded(array.tolist()))


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value
