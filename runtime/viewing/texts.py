"""Values as a few lines of text, for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from hierax.runtime.core.elements import Value

MOST_LINES = 200  # how many lines one value takes at most; what is longer is cut off, and says so
MOST_ITEMS = 16  # how many items an array that is written out, or a list, has at most
MOST_CHARS, MOST_FIGURES = 80, 4


def belief_text(belief: Value) -> str:
    """A belief as an outline: a line for each part, large arrays by shape alone."""
    text = yaml.dump(_shown(belief), Dumper=_Outline, sort_keys=False, allow_unicode=True, width=10_000)
    lines = text.removesuffix("...\n").splitlines()
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], f"… {len(lines) - MOST_LINES} more lines"]
    return "\n".join(lines)


def figures_text(figures: Mapping[str, float]) -> str:
    """The first figures, a line each."""
    return "\n".join(f"{name} {number:.4g}" for name, number in list(figures.items())[:MOST_FIGURES])


class _Outline(yaml.SafeDumper):
    """Writes lists of numbers and texts in a line."""

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        flat = not any(isinstance(item, (dict, list)) for item in sequence)
        return super().represent_sequence(tag, sequence, flat)


def _shown(value: Value) -> Any:
    """What of a value is shown, of YAML's types."""
    if isinstance(value, Mapping):
        return {str(key): _shown(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.size > MOST_ITEMS:
        return f"{value.dtype} {' × '.join(map(str, value.shape))}"
    if isinstance(value, (np.ndarray, np.generic)):
        return _shown(value.tolist())
    if isinstance(value, (tuple, list)):
        more = [f"… {len(value) - MOST_ITEMS} more"] if len(value) > MOST_ITEMS else []
        return [*map(_shown, value[:MOST_ITEMS]), *more]
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, (bytes, bytearray, memoryview)):
        return f"{len(value)} bytes"
    if value is None or isinstance(value, (bool, int)):
        return value
    text = str(value)
    return text if len(text) <= MOST_CHARS else text[: MOST_CHARS - 1] + "…"
