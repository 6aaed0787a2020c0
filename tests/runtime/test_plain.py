from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from hierax.runtime.plain import plain

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


def test_what_is_no_value_is_refused() -> None:
    with pytest.raises(TypeError, match="a set is no value"):
        plain({1, 2})
