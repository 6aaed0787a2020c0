"""Steps travel as they are; bytes that are none are refused, and it is said where."""

from __future__ import annotations

import msgpack
import pytest

from hierax.schemas.errors import SchemaError
from hierax.schemas.steps import FORMAT, NodeStep, Passage, decode_step, encode_step

STEP = NodeStep(
    "arm",
    "0a1b",
    3,
    1 << 40,
    2,
    4,
    5,
    0.25,
    bytes(32),
    b"state",
    b"sensed",
    b"start",
    (("world", "obs", 7, 0),),
    (Passage(False, "obs", "world", 7, 0), Passage(True, "ctx", "world", 7, 1)),
    b"chain",
)


def test_a_step_comes_back_as_it_was() -> None:
    assert decode_step(encode_step(STEP)) == STEP
    bare = NodeStep("arm", "0a1b", 1, 1, 0, 0, 0, 0.0, b"", b"")
    assert decode_step(encode_step(bare)) == bare


def test_any_msgpack_library_reads_it() -> None:
    fields = msgpack.unpackb(encode_step(STEP), use_list=False)
    assert fields == (FORMAT, *STEP)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: fields[:-1], "step: expected an array of 16 fields"),
        (lambda fields: (2, *fields[1:]), "step.format: format 2; this version reads format 1"),
        (lambda fields: (*fields[:4], 1.5, *fields[5:]), "step.epoch: expected a whole number, got 1.5"),
        (
            lambda fields: (*fields[:13], (("a", "obs", 1),), *fields[14:]),
            r"step.used\[0\]: expected \[str, str, int, int",
        ),
        (lambda fields: (*fields[:14], (1,), fields[15]), r"step.passages\[0\]: expected \[bool, str, str, int, int"),
    ],
)
def test_what_is_none_is_refused(change: object, said: str) -> None:
    data = msgpack.packb(change((FORMAT, *STEP)))  # type: ignore[operator]
    with pytest.raises(SchemaError, match=said):
        decode_step(data)


def test_bytes_that_are_no_value_are_refused() -> None:
    with pytest.raises(SchemaError, match="step: not one msgpack value"):
        decode_step(encode_step(STEP)[:-3])
