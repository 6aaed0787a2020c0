"""Values as plain JSON, for reports.

Bytes become hexadecimal text, arrays nested lists, a complex number [real, imaginary].
JSON has no NaN and no infinities: they become the strings "NaN", "Infinity" and
"-Infinity".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hierax.schemas.values import Value

Json = Any
"""None, a bool, int, finite float, str, list of these or dict from str to these."""


def plain(value: Value) -> Json:
    """A value as plain JSON.

    Args:
        value: as `hierax.schemas.values` describes it.

    Raises:
        TypeError: it is no value.
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, complex):
        return [_number(value.real), _number(value.imag)]
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value).hex()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, np.ndarray):
        return _array(value)
    raise TypeError(f"a {type(value).__name__} is no value")


def _array(array: np.ndarray[Any, Any]) -> Json:
    simple = array.dtype.kind in "biu" or (array.dtype.kind == "f" and bool(np.isfinite(array).all()))
    return array.tolist() if simple else plain(array.tolist())


def _number(number: float) -> float | str:
    if math.isfinite(number):
        return float(number)
    if math.isnan(number):
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"
