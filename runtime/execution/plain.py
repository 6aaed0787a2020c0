"""Values as plain JSON, for reports.

Bytes become hexadecimal text, arrays nested lists, a complex number [real, imaginary]. JSON has no NaN and no
infinities: they become the strings "NaN", "Infinity" and "-Infinity".

Of an array of more than `SMALL_ARRAY` elements it is told what it is like, and by which digest it is known: ``{"array":
{"dtype", "shape", "blake2b", "min", "max", "mean"}}``. The digest is BLAKE2b-256 of its elements as messages carry
them: in C order, little-endian. The last three lack where it has no finite elements. Bytes of more than `SMALL_BYTES`
become ``{"bytes": {"size", "head", "blake2b"}}``.
"""

from __future__ import annotations

import math
from hashlib import blake2b
from typing import Any

import numpy as np

from hierax.schemas.arrays import array_elements
from hierax.schemas.values import Value

SMALL_ARRAY = 64  # arrays of so many elements are given whole
SMALL_BYTES = 64  # so many bytes are given whole

HEAD_BYTES = 16
_DIGEST_BYTES = 32

Json = Any  # none, a bool, int, finite float, str, list of these or dict from str to these


def plain(value: Value, full: bool = False) -> Json:
    """A value as plain JSON; `full`: also large arrays and long bytes. Raises `TypeError` if it is no value."""
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, complex):
        return [_number(value.real), _number(value.imag)]
    if isinstance(value, (bytes, bytearray, memoryview)):
        given = bytes(value)
        return given.hex() if full or len(given) <= SMALL_BYTES else {"bytes": _about_bytes(given)}
    if isinstance(value, dict):
        return {str(key): plain(item, full) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item, full) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, np.ndarray):
        return _array(value) if full or value.size <= SMALL_ARRAY else {"array": _about_array(value)}
    raise TypeError(f"a {type(value).__name__} is no value")


def statistics(array: np.ndarray[Any, Any]) -> dict[str, Json]:
    """Least, greatest and mean of an array's finite elements, and how many are not; nothing where none is finite."""
    numbers = np.abs(array) if array.dtype.kind == "c" else array
    finite = numbers[np.isfinite(numbers)]
    if not finite.size:
        return {}
    about: dict[str, Json] = {"min": finite.min().item(), "max": finite.max().item()}
    about["mean"] = _number(float(finite.mean(dtype=np.float64)))
    if finite.size < numbers.size:
        about["not_finite"] = int(numbers.size - finite.size)
    return about


def _about_array(array: np.ndarray[Any, Any]) -> dict[str, Json]:
    digest = blake2b(array_elements(array), digest_size=_DIGEST_BYTES).hexdigest()
    return {"dtype": str(array.dtype), "shape": list(array.shape), "blake2b": digest, **statistics(array)}


def _about_bytes(given: bytes) -> dict[str, Json]:
    digest = blake2b(given, digest_size=_DIGEST_BYTES).hexdigest()
    return {"size": len(given), "head": given[:HEAD_BYTES].hex(), "blake2b": digest}


def _array(array: np.ndarray[Any, Any]) -> Json:
    simple = array.dtype.kind in "biu" or (array.dtype.kind == "f" and bool(np.isfinite(array).all()))
    return array.tolist() if simple else plain(array.tolist())


def _number(number: float) -> float | str:
    if math.isfinite(number):
        return float(number)
    if math.isnan(number):
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"
