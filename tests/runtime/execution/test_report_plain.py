from __future__ import annotations

import json
from hashlib import blake2b

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from hierax.runtime.execution.report import SMALL_ARRAY, plain

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
leaves = scalars | arrays.arrays(
    st.sampled_from([np.bool_, np.int16, np.uint64, np.float32, np.float64, np.complex128]),
    arrays.array_shapes(min_dims=0, min_side=0, max_side=3),
)
values = st.recursive(
    leaves, lambda inner: st.lists(inner).map(tuple) | st.dictionaries(st.text(), inner), max_leaves=8
)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None),
        (True, True),
        (3, 3),
        (0.5, 0.5),
        ("text", "text"),
        (b"\x00\xff", "00ff"),
        ((1, [2]), [1, [2]]),
        ({"a": (1,)}, {"a": [1]}),
        (float("nan"), "NaN"),
        (float("inf"), "Infinity"),
        (-float("inf"), "-Infinity"),
        (np.float32(0.5), 0.5),
        (np.int8(-1), -1),
        (np.bool_(True), True),
        (np.array([[1, 2]], np.uint8), [[1, 2]]),
        (np.array([1.0, np.nan]), [1.0, "NaN"]),
        (np.array(2.5), 2.5),
        (np.array([1 + 2j]), [[1.0, 2.0]]),
        (np.array([], np.float64), []),
    ],
)
def test_values_become_plain_json(value: object, expected: object) -> None:
    result = plain(value)
    assert result == expected
    assert type(result) is type(expected)


@given(values)
def test_every_value_becomes_strict_json(value: object) -> None:
    text = json.dumps(plain(value), allow_nan=False)
    assert json.loads(text) == plain(value)


@pytest.mark.parametrize("order", ["<", ">"])
def test_large_arrays_are_given_by_shape_dtype_and_digest(order: str) -> None:
    image = np.arange(4 * 20, dtype=np.uint16).reshape(4, 20)
    value = ({"image": image.astype(f"{order}u2"), "pose": np.eye(3)},)
    (given,) = plain(value)
    digest = blake2b(image.astype("<u2").tobytes(), digest_size=32).hexdigest()
    about = given["image"]["array"]
    assert about.pop("dtype").endswith("16" if order == "<" else "u2")
    assert about == {"shape": [4, 20], "blake2b": digest, "min": 0, "max": 79, "mean": 39.5}
    assert given["pose"] == np.eye(3).tolist()
    assert plain(value, full=True)[0]["image"] == image.tolist()
    assert len(plain(np.zeros(SMALL_ARRAY))) == SMALL_ARRAY
    assert len(json.dumps(plain((np.zeros((480, 640, 3)),) * 3))) < 1000


def test_long_bytes_are_given_by_size_and_digest() -> None:
    digest = blake2b(bytes(100), digest_size=32).hexdigest()
    assert plain(bytes(100)) == {"bytes": {"size": 100, "head": "00" * 16, "blake2b": digest}}
    assert plain(bytes(100), full=True) == "00" * 100


@pytest.mark.parametrize(
    "array",
    [
        np.full(99, np.nan),
        np.array([1.0, np.inf, 3.0, np.nan] * 20),
        np.zeros((0, 5)),
        np.ones(99, bool),
        np.ones(99) * 1j,
    ],
)
def test_whatever_an_array_holds_becomes_json(array: np.ndarray) -> None:
    json.dumps(plain(array), allow_nan=False)


def test_what_is_not_finite_is_counted() -> None:
    about = plain(np.array([1.0, np.inf, 3.0, np.nan] * 20))["array"]
    assert (about["min"], about["max"], about["mean"], about["not_finite"]) == (1.0, 3.0, 2.0, 40)


def test_what_is_no_value_is_refused() -> None:
    with pytest.raises(TypeError, match="a set is no value"):
        plain({1, 2})
