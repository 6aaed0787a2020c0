"""Where two values differ, for errors about values that should be the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hierax.runtime.core.elements import Value
from hierax.schemas.values import encode_value


def difference(expected: Value, got: Value, names: Sequence[str] = (), where: str = "") -> str:
    """The first place where two values differ, and both values there; empty where they are equal.

    Args:
        expected, got: the values.
        names: what the entries of `expected`, a tuple, are called.
        where: what the whole is called.
    """
    if isinstance(expected, dict) and isinstance(got, dict) and list(expected) == list(got):
        pairs = [(f"{where}.{key}".lstrip("."), expected[key], got[key]) for key in expected]
    elif isinstance(expected, (tuple, list)) and isinstance(got, (tuple, list)) and len(expected) == len(got):
        labels = names if len(names) == len(expected) else [f"{where}[{index}]" for index in range(len(expected))]
        pairs = list(zip(labels, expected, got, strict=True))
    else:
        return "" if encode_value(expected) == encode_value(got) else _told(expected, got, where)
    return next(filter(None, (difference(one, other, (), path) for path, one, other in pairs)), "")


def _told(expected: Value, got: Value, where: str) -> str:
    if isinstance(expected, np.ndarray) and isinstance(got, np.ndarray):
        if (expected.dtype, expected.shape) != (got.dtype, got.shape):
            shown = [f"{each.dtype} {each.shape}" for each in (expected, got)]
            return f"{where or 'array'}: {shown[0]}, then {shown[1]}"
        index = tuple(int(each[0]) for each in np.nonzero(_unequal(expected, got)))
        place = ", ".join(map(str, index))
        return f"{where or 'array'}[{place}]: {expected[index].item()!r}, then {got[index].item()!r}"
    return f"{where or 'value'}: {expected!r:.60}, then {got!r:.60}"


def _unequal(one: np.ndarray[Any, Any], other: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Where two arrays have other bytes."""
    raw = [np.ascontiguousarray(each).view(np.uint8).reshape(*each.shape, each.itemsize) for each in (one, other)]
    unequal: np.ndarray[Any, Any] = (raw[0] != raw[1]).any(axis=-1)
    return unequal
