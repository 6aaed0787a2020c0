"""Values as text for people: arrays summarised, all else as it is, but for what would move a terminal's cursor."""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

from hierax.runtime.execution.report import HEAD_BYTES, statistics
from hierax.runtime.host.streams import printable
from hierax.schemas.values import Value

SMALL_ARRAY = 16  # arrays of so many elements are shown whole
SHOWN_ITEMS = 20  # of longer lists and maps, the first ones are shown as text
_LINE_CHARS = 100
_INDENT = "  "


def tree(value: Value, name: str = "", depth: int = 0) -> Iterator[str]:
    """A value as lines of text, what is inside of what indented."""
    label = f"{_INDENT * depth}{_in_its_line(name)}  " if name else _INDENT * depth
    flat = in_line(value)
    if len(label) + len(flat) <= _LINE_CHARS or not isinstance(value, (dict, tuple, list)):
        yield f"{label}{flat}"
        return
    if name:
        yield label.rstrip()
    else:
        depth -= 1
    items = value.items() if isinstance(value, dict) else ((f"[{index}]", item) for index, item in enumerate(value))
    for count, (key, item) in enumerate(items):
        if count == SHOWN_ITEMS:
            yield f"{_INDENT * (depth + 1)}… {len(value) - SHOWN_ITEMS} more"
            return
        yield from tree(item, str(key), depth + 1)


def in_line(value: Value, most: int | None = None) -> str:
    """A value in one line, of any length; in short with so many items at most of each list, map and array."""
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, (bytes, bytearray, memoryview)):
        head = f" {bytes(value[:HEAD_BYTES]).hex()}{'…' if len(value) > HEAD_BYTES else ''}"
        return f"{len(value)} bytes{'' if most else head}"
    if isinstance(value, np.ndarray):
        return _array_in_line(value, most)
    if isinstance(value, (dict, tuple, list)):
        keys = [f"{_in_its_line(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
        items = value.values() if isinstance(value, dict) else value
        texts = [f"{key}{in_line(item, most)}" for key, item in islice(zip(keys, items, strict=True), most)]
        joined = ", ".join(texts + ["…"] * (len(texts) < len(value)))
        return f"{{{joined}}}" if isinstance(value, dict) else f"[{joined}]"
    return repr(value) if isinstance(value, str) and most is None else _in_its_line(value)


def _in_its_line(value: Value) -> str:
    return printable(str(value), kept="")


def _array_in_line(array: np.ndarray[Any, Any], most: int | None) -> str:
    if array.size <= (most or SMALL_ARRAY):
        return in_line(array.tolist(), most)
    shape = "×".join(map(str, array.shape))
    if most is not None:
        return f"{array.dtype} array {shape}"
    about = statistics(array)
    if "min" not in about:
        return f"{array.dtype} {shape}"
    return f"{array.dtype} {shape}, {about['min']:.6g} to {about['max']:.6g}, mean {about['mean']:.6g}"
