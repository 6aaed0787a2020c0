"""Hypothesis strategies for values, messages and hierarchies."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
from hypothesis import strategies as st

from hierax.runtime.core.hierarchy import Hierarchy
from hierax.schemas.messages import KINDS, Header, Message
from support.hierarchies import MAX_NODES, MIN_NODES, random_hierarchy

DTYPES = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8", "<c8", "<c16")
LAYOUTS = ("C", "Fortran", "big-endian", "strided", "reversed", "broadcast", "unaligned")
MAX_SIDE = 5
LARGE_SIDE = 20_000
"""A further dimension of so many elements makes an array large."""

names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True)
unsigned = st.integers(0, (1 << 64) - 1)
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(1 << 63), (1 << 64) - 1),
    st.floats(),
    st.text(max_size=20),
    st.binary(max_size=40),
)


@st.composite
def arrays(draw: st.DrawFn, large: bool = False) -> np.ndarray[Any, Any]:
    """Arrays of every dtype that can travel, 0 to 4 dimensions, sides of 0 included, in every memory layout."""
    dtype = np.dtype(draw(st.sampled_from(DTYPES)))
    shape = tuple(draw(st.lists(st.integers(0, MAX_SIDE), max_size=3)))
    if large:
        shape = (*(side + 1 for side in shape), LARGE_SIDE)
    return laid_out(filled(shape, dtype, draw(st.integers(0, 1 << 32))), draw(st.sampled_from(LAYOUTS)))


def filled(shape: tuple[int, ...], dtype: np.dtype[Any], seed: int) -> np.ndarray[Any, Any]:
    """An array of random bits (so NaN and infinity are among floats)."""
    count = int(np.prod(shape, dtype=np.int64))
    data = np.random.default_rng(seed).bytes(count * dtype.itemsize)
    if dtype == np.bool_:
        data = bytes(byte & 1 for byte in data)
    return np.frombuffer(data, dtype).reshape(shape)


def laid_out(array: np.ndarray[Any, Any], layout: str) -> np.ndarray[Any, Any]:
    """The same elements (broadcast: some of them) in another memory layout."""
    if layout == "Fortran":
        return np.asfortranarray(array)
    if layout == "big-endian":
        return array.astype(array.dtype.newbyteorder(">"))
    if layout == "strided":
        return np.repeat(np.atleast_1d(array), 2, axis=-1)[..., ::2]
    if layout == "reversed" and array.ndim:
        return array[(slice(None, None, -1),) * array.ndim]
    if layout == "broadcast" and array.size:
        return np.broadcast_to(array[..., :1] if array.ndim else array, array.shape)
    if layout == "unaligned":
        return np.frombuffer(b"\0" + array.tobytes(), array.dtype, offset=1, count=array.size).reshape(array.shape)
    return array


values = st.recursive(
    scalars | arrays(),
    lambda inner: (
        st.lists(inner, max_size=4).map(tuple)
        | st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Messages with every header field, and none, one or two large arrays."""
    payload = draw(st.lists(values, max_size=3)) + draw(st.lists(arrays(large=True), max_size=2))
    header = Header(
        kind=draw(st.sampled_from(KINDS)),
        sender=draw(names),
        receiver=draw(names),
        epoch=draw(unsigned),
        attempt=draw(unsigned),
        roster=draw(unsigned),
        instance=draw(unsigned),
        time_s=draw(st.floats()),
        digest=draw(st.just(b"") | st.binary(min_size=32, max_size=32)),
        extensions=draw(st.dictionaries(st.text(max_size=8), values, max_size=2)),
    )
    return Message(header, tuple(draw(st.permutations(payload))))


def hierarchies(max_nodes: int = MAX_NODES) -> st.SearchStrategy[Hierarchy]:
    """Random valid hierarchies of mixing nodes; shrinks to few nodes."""
    sizes = st.integers(MIN_NODES, max_nodes)
    return st.builds(random_hierarchy, seed=st.integers(0, 1 << 32), nodes=sizes)


randoms = st.integers(0, 1 << 32).map(random.Random)
"""Generators whose seed hypothesis chooses."""
