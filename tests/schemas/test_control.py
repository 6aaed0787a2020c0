"""Control messages: what is none is refused before it takes memory, with the field that is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.schemas.control import (
    AskStatus,
    Control,
    Dismiss,
    Join,
    Prepare,
    Resend,
    State,
    Status,
    decode_control,
    encode_control,
)
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_NUMBER, MAX_STATE_BYTES, MAX_TEXT_CHARS, MAX_WORD_BYTES
from hierax.schemas.values import encode_value

JOIN = Join("arm", "00ff", "", 3, True, "", 1, 2)


@pytest.mark.parametrize(
    "word", [JOIN, Dismiss("why"), Resend(1, 0, ("a", "b")), Status("a", 1, 2, 3, (("b", "obs"),), "", 4)]
)
def test_what_is_sent_comes_out(word: Control) -> None:
    assert decode_control(encode_control(word)) == word


@pytest.mark.parametrize(
    ("word", "where"),
    [
        (JOIN._replace(name="a/**"), "control.Join.name"),
        (JOIN._replace(name=""), "control.Join.name"),
        (JOIN._replace(process="x" * 129), "control.Join.process"),
        (JOIN._replace(epoch=MAX_NUMBER + 1), "control.Join.epoch"),
        (JOIN._replace(attempt=-2), "control.Join.attempt"),
        (Resend(1, 0, ("a", "*")), "control.Resend.receivers"),
        (Resend(1, 0, ("a",) * 5000), "control.Resend.receivers"),
        (Status("a", 1, 2, 3, (("**", "obs"),), ""), "control.Status.waits_for"),
    ],
)
def test_names_numbers_and_lists_are_within_bounds(word: Any, where: str) -> None:
    with pytest.raises(SchemaError) as raised:
        decode_control(encode_value((type(word).__name__, *word)))
    assert raised.value.where == where


@pytest.mark.parametrize("value", [{}, (), ({},), (np.zeros(3),), ("Join",), ("Join", *[{}] * 8), ("AskStatus", True)])
def test_what_is_no_control_message_is_refused(value: Any) -> None:
    with pytest.raises(SchemaError):
        decode_control(encode_value(value))


def test_only_what_may_hold_a_roster_or_a_state_may_be_long() -> None:
    assert decode_control(encode_control(State("arm", 1, bytes(MAX_WORD_BYTES))))
    assert decode_control(encode_control(Prepare({"nodes": "x" * MAX_WORD_BYTES})))
    for data in (encode_value(("AskStatus", "x" * MAX_WORD_BYTES)), b"\xff" * (MAX_WORD_BYTES + 1)):
        with pytest.raises(SchemaError, match=f"at most {MAX_WORD_BYTES} are allowed"):
            decode_control(data)
    with pytest.raises(SchemaError, match=f"at most {MAX_STATE_BYTES} are allowed"):
        encode_control(State("arm", 1, bytes(MAX_STATE_BYTES)))
    assert decode_control(encode_control(AskStatus(1)))


def test_texts_that_are_too_long_are_cut_by_their_sender() -> None:
    word = decode_control(encode_control(Dismiss("x" * 10_000)))
    assert isinstance(word, Dismiss)
    assert word.why == "x" * (MAX_TEXT_CHARS - 1) + "…"
