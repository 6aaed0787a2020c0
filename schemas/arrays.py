"""Numpy arrays as a msgpack extension type.

The data of extension `ARRAY` (code 1) is a head and the raw elements::

    offset  size  field
    0       1     ndim
    1       1     length n of the dtype string
    2       2     length p of the padding, little-endian
    4       n     dtype, numpy's string form, little-endian, e.g. "<f8"
    4+n     8·ndim  shape, unsigned little-endian
    ...     p     zeros
    ...           elements, C order

The padding (0 to 15) puts the elements on a multiple of 16, counted from the start of the data or, for an array behind
the payload, of the message: numpy then reads them in place and aligned."""

import struct
from functools import lru_cache
from math import prod
from typing import Any

import numpy as np

from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import LARGE_ARRAY_BYTES, MAX_ARRAY_BYTES, MAX_ARRAY_NDIM

ARRAY = 1
"""Extension code of an array given in place."""

ALIGNMENT = 16

_CODES = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8", "<c8", "<c16")
_DTYPES = {code: np.dtype(code) for code in _CODES}
_BOOL = _DTYPES["|b1"]
_LITTLE_NUMBERS = {dtype: code for code, dtype in _DTYPES.items() if dtype != _BOOL}
_KEPT_HEADS = 256
_FIXED = struct.Struct("<BBH")


def check_array(array: np.ndarray[Any, Any]) -> None:
    """Raises `SchemaError` if an array cannot travel, for its dtype (objects, strings), mask, dimensions or size."""
    if _code(array) not in _DTYPES:
        raise SchemaError(f"an array of dtype {array.dtype} cannot be sent; use a number or bool dtype")
    if isinstance(array, np.ma.MaskedArray):
        raise SchemaError("a masked array cannot be sent; send its data and its mask")
    if array.ndim > MAX_ARRAY_NDIM:
        raise SchemaError(f"an array has {array.ndim} dimensions; at most {MAX_ARRAY_NDIM} are allowed")
    if array.nbytes > MAX_ARRAY_BYTES:
        raise SchemaError(f"an array has {array.nbytes} bytes; at most {MAX_ARRAY_BYTES} are allowed")
    if array.dtype == _BOOL and _is_bad_bool(np.ascontiguousarray(array)):
        raise SchemaError("a bool array holds bytes other than 0 and 1; compare with != 0 instead of viewing")


def array_head(array: np.ndarray[Any, Any], offset: int = 0) -> bytes:
    """The bytes that stand before an array's elements, in a message whose array data begins at this offset in bytes.
    The padding counts from there. Raises `SchemaError` as `check_array` does."""
    check_array(array)
    return _head(_code(array), array.shape, offset)


def array_elements(array: np.ndarray[Any, Any]) -> memoryview:
    """The elements in C order, little-endian, as a flat view of bytes (a copy only where needed)."""
    little = array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)
    flat = np.ascontiguousarray(little).reshape(-1)
    return flat.view(np.uint8).data


def encode_array(array: np.ndarray[Any, Any]) -> bytes:
    """The data of extension `ARRAY`: head and elements. Raises `SchemaError` as `check_array` does."""
    code = _LITTLE_NUMBERS.get(array.dtype)
    if (
        code is not None
        and type(array) is np.ndarray
        and array.nbytes < LARGE_ARRAY_BYTES
        and array.ndim <= MAX_ARRAY_NDIM
    ):  # nothing else to check, and a copy takes less than a view
        return _kept_head(code, array.shape) + array.tobytes()
    return b"".join((array_head(array), array_elements(array)))


def decode_array(data: bytes | memoryview, where: str = "array") -> np.ndarray[Any, Any]:
    """Read the data of extension `ARRAY` in place: read-only, and aligned without a copy where the elements lie so.
    Raises `SchemaError`, with `where` in it, if the data is not an array as described above."""
    if len(data) < _FIXED.size:
        raise SchemaError(f"{len(data)} bytes are too short for an array's head", where)
    ndim, name_length, padding = _FIXED.unpack_from(data)
    if ndim > MAX_ARRAY_NDIM:
        raise SchemaError(f"{ndim} dimensions; at most {MAX_ARRAY_NDIM} are allowed", where)
    shape_at = _FIXED.size + name_length
    start = shape_at + 8 * ndim + padding
    if padding >= ALIGNMENT or start > len(data):
        raise SchemaError("the array's head is cut off or its padding is wrong", where)
    dtype, shape, size = _layout(bytes(data[: start - padding]))
    if dtype is None:
        code = bytes(data[_FIXED.size : shape_at]).decode("ascii", "replace")
        raise SchemaError(f"unknown dtype {code!r}; expected one of {', '.join(_DTYPES)}", where)
    if size != len(data) - start:
        raise SchemaError(f"shape {shape} of {dtype.str} wants {size} bytes, {len(data) - start} are there", where)
    try:
        array = _view(data, dtype, shape, start)
    except (ValueError, OverflowError) as error:  # a shape with a zero and numbers past what numpy counts
        raise SchemaError(f"shape {shape} of {dtype.str} is no array: {error}", where) from error
    if dtype is _BOOL and _is_bad_bool(array):
        raise SchemaError("a bool array holds bytes other than 0 and 1", where)
    if not array.flags.aligned:  # a foreign sender's padding, or data that begins anywhere
        array = array.copy()
    if array.flags.writeable:
        array.flags.writeable = False
    return array


def _view(data: bytes | memoryview, dtype: np.dtype[Any], shape: tuple[int, ...], start: int) -> np.ndarray[Any, Any]:
    if type(data) is bytes:
        array: np.ndarray[Any, Any] = np.ndarray(shape, dtype, data, start)
        return array
    # a constructed array would not keep other memory than that of bytes from being given back
    return np.frombuffer(data, dtype, offset=start, count=prod(shape)).reshape(shape)


def _head(code: str, shape: tuple[int, ...], offset: int) -> bytes:
    bare = _FIXED.size + len(code) + 8 * len(shape)
    padding = -(offset + bare) % ALIGNMENT
    sizes = struct.pack(f"<{len(shape)}Q", *shape)
    return b"".join((_FIXED.pack(len(shape), len(code), padding), code.encode("ascii"), sizes, bytes(padding)))


@lru_cache(_KEPT_HEADS)
def _kept_head(code: str, shape: tuple[int, ...]) -> bytes:
    """A head at offset 0: one node's arrays look alike from message to message."""
    return _head(code, shape, 0)


@lru_cache(_KEPT_HEADS)
def _layout(head: bytes) -> tuple[np.dtype[Any] | None, tuple[int, ...], int]:
    """Dtype (None if unknown), shape and bytes of the elements, from a head without its padding."""
    ndim, name_length, _ = _FIXED.unpack_from(head)
    shape_at = _FIXED.size + name_length
    dtype = _DTYPES.get(head[_FIXED.size : shape_at].decode("ascii", "replace"))
    shape = struct.unpack_from(f"<{ndim}Q", head, shape_at)
    return dtype, shape, 0 if dtype is None else prod(shape) * dtype.itemsize


def _code(array: np.ndarray[Any, Any]) -> str:
    code: str = array.dtype.newbyteorder("<").str
    return code


def _is_bad_bool(array: np.ndarray[Any, Any]) -> bool:
    return bool(array.size) and int(array.view(np.uint8).max()) > 1
