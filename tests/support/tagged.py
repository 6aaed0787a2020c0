"""Values as plain JSON with tags, for golden files and for comparing decoders. Imports nothing of hierax.

A list stands for a tuple; bytes, arrays, numbers that JSON lacks, and ints that a
JavaScript number cannot hold are tagged::

    {"$bytes": hex}, {"$array": [dtype, shape, hex]}, {"$float": "nan"}, {"$int": "18446744073709551615"}

Elements and bytes of more than 64 bytes are given by their SHA-256.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

import numpy as np

SAFE_INT = 1 << 53
HEX_BYTES = 64


def tagged(value: Any) -> Any:
    """A value as JSON can hold it."""
    if isinstance(value, np.ndarray):
        little = value.astype(value.dtype.newbyteorder("<"))
        return {"$array": [little.dtype.str, list(value.shape), digested(little.tobytes("C"))]}
    if isinstance(value, bytes):
        return {"$bytes": digested(value)}
    if isinstance(value, float) and not math.isfinite(value):
        return {"$float": str(value)}
    if isinstance(value, int) and abs(value) >= SAFE_INT:
        return {"$int": str(value)}
    if isinstance(value, dict):
        return {key: tagged(part) for key, part in value.items()}
    if isinstance(value, (tuple, list)):
        return [tagged(part) for part in value]
    return value


def text(value: Any) -> str:
    """A value as text that is equal for equal values only: types, dtypes, order of keys and NaN included."""
    return json.dumps(tagged(value))


def digested(data: bytes) -> str:
    """Hex of a few bytes, the hash of many."""
    return data.hex() if len(data) <= HEX_BYTES else "sha256:" + hashlib.sha256(data).hexdigest()
