"""The array extension: layout, limits, what is refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.strategies import DTYPES, LAYOUTS, arrays, filled, laid_out
from support.tagged import text

from hierax.schemas.arrays import array_elements, array_head, check_array, decode_array, encode_array
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_ARRAY_BYTES


def data_of(shape: tuple[int, ...], code: bytes = b"<f8", padding: int = 0, elements: bytes = b"") -> bytes:
    head = struct.pack("<BBH", len(shape), len(code), padding) + code
    return head + struct.pack(f"<{len(shape)}Q", *shape) + bytes(padding) + elements


def test_layout_is_the_documented_one() -> None:
    expected = data_of((2, 1), b"<i2", padding=9, elements=struct.pack("<hh", 1, -2))
    assert encode_array(np.array([[1], [-2]], ">i2")) == expected


@pytest.mark.parametrize("code", DTYPES)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("shape", [(), (0,), (3, 0, 2), (1,), (4, 3), (2, 1, 3)])
def test_every_dtype_layout_and_shape_comes_back(code: str, layout: str, shape: tuple[int, ...]) -> None:
    array = laid_out(filled(shape, np.dtype(code), seed=3), layout)
    back = decode_array(encode_array(array))
    assert text(back) == text(array)
    assert back.dtype == np.dtype(code)


@given(arrays(), st.integers(0, 64))
def test_elements_begin_on_a_multiple_of_16(array: np.ndarray, offset: int) -> None:
    assert (offset + len(array_head(array, offset))) % 16 == 0


def test_decoding_takes_no_copy() -> None:
    data = encode_array(np.arange(1000.0))
    array = decode_array(data)
    assert np.shares_memory(array, np.frombuffer(data, np.uint8))
    assert array.flags.aligned
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        array.flags.writeable = True


def test_decoding_keeps_the_memory_that_it_reads() -> None:
    data = bytearray(encode_array(np.arange(100.0)))
    array = decode_array(memoryview(data))
    with pytest.raises(BufferError):
        data.clear()
    assert array.tolist() == list(range(100))
    assert not array.flags.writeable


def test_relatives_of_arrays_are_encoded_as_arrays_are() -> None:
    array = np.arange(6.0).reshape(2, 3)
    relatives = (array.view(np.recarray), np.ma.array(array).data, array.astype(">f8"))
    assert {encode_array(relative) for relative in relatives} == {encode_array(array)}


def test_elements_of_a_contiguous_array_are_no_copy() -> None:
    array = np.arange(1000.0)
    assert np.shares_memory(np.frombuffer(array_elements(array), np.uint8), array)


@pytest.mark.parametrize("shift", range(16))
def test_foreign_padding_gives_an_aligned_array_all_the_same(shift: int) -> None:
    data = data_of((3,), padding=shift, elements=struct.pack("<3d", 1, 2, 3))
    array = decode_array(data)
    assert array.flags.aligned
    assert not array.flags.writeable
    assert array.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (np.array([None]), "dtype object"),
        (np.array(["a"]), "dtype <U1"),
        (np.array([b"a"]), r"dtype \|S1"),
        (np.zeros(2, [("x", "<f8")]), "dtype"),
        (np.zeros(2, "M8[ns]"), "dtype datetime64"),
        (np.zeros(2, np.longdouble), "dtype"),
        (np.ma.array([1, 2], mask=[True, False]), "masked"),
        (np.zeros((1,) * 17), "17 dimensions"),
        (np.broadcast_to(1.0, (MAX_ARRAY_BYTES // 8 + 1,)), "bytes; at most"),
        (np.array([0, 255], np.uint8).view(bool), "other than 0 and 1"),
    ],
)
def test_what_cannot_travel_is_refused(array: np.ndarray, reason: str) -> None:
    with pytest.raises(SchemaError, match=reason):
        check_array(array)
    with pytest.raises(SchemaError, match=reason):
        encode_array(array)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "too short"),
        (b"\x01\x03\x00", "too short"),
        (data_of((1,) * 17), "17 dimensions"),
        (data_of((2,))[:-3], "cut off"),
        (data_of((0,), padding=16), "padding"),
        (data_of((0,), b"|O8"), "unknown dtype"),
        (data_of((0,), b">f8"), "unknown dtype"),
        (data_of((0,), b"\xff\xfe"), "unknown dtype"),
        (data_of((0,), b""), "unknown dtype"),
        (data_of((2,), elements=bytes(8)), "wants 16 bytes, 8 are there"),
        (data_of((2,), elements=bytes(17)), "wants 16 bytes, 17 are there"),
        (data_of(((1 << 64) - 1,) * 16), "wants"),
        (data_of((0, (1 << 64) - 1)), "is no array"),
        (data_of((0, 1 << 31, 1 << 40)), "is no array"),
        (data_of((1 << 32, 1 << 32, 0)), "is no array"),
        (data_of((3,), b"|b1", elements=b"\x00\x01\x02"), "other than 0 and 1"),
    ],
)
def test_bad_data_is_refused_with_the_reason(data: bytes, reason: str) -> None:
    with pytest.raises(SchemaError, match=reason) as raised:
        decode_array(data, "payload[2]")
    assert raised.value.where == "payload[2]"
