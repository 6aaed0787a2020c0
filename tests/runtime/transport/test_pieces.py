"""Messages in pieces."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hierax.runtime.transport.pieces import Joiner, in_pieces
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_MESSAGE_BYTES

MOST = 40


@given(st.lists(st.binary(max_size=300).filter(lambda data: data[:1] != b"\xc1"), max_size=5), st.randoms())
def test_messages_come_out_whole_however_their_pieces_mix(messages: list[bytes], rng: object) -> None:
    lanes = [list(in_pieces(data, MOST)) for data in messages]
    assert all(len(piece) <= MOST for lane in lanes for piece in lane)
    joiner, came = Joiner(), []
    while any(lanes):
        lane = rng.choice([lane for lane in lanes if lane])  # type: ignore[attr-defined]
        whole = joiner.join(lane.pop(0))
        came += [] if whole is None else [whole]
    assert sorted(came) == sorted(messages)


def test_what_is_short_or_goes_over_links_that_carry_all_goes_as_it_is() -> None:
    assert list(in_pieces(b"x" * MOST, MOST)) == [b"x" * MOST]
    assert list(in_pieces(b"x" * 1000, None)) == [b"x" * 1000]


@pytest.mark.parametrize("lost", range(4))
def test_of_a_message_that_lost_a_piece_nothing_comes_and_it_may_come_again(lost: int) -> None:
    pieces = list(in_pieces(b"x" * 50, MOST))
    assert len(pieces) == 4
    joiner = Joiner()
    assert [joiner.join(piece) for number, piece in enumerate(pieces) if number != lost] == [None] * 3
    again = list(in_pieces(b"x" * 50, MOST))
    assert [joiner.join(piece) for piece in again] == [None, None, None, b"x" * 50]


def test_what_lacks_pieces_does_not_pile_up() -> None:
    joiner = Joiner()
    first = list(in_pieces(b"x" * 30, MOST - 20 + 10))
    for data in range(100):
        begun = next(in_pieces(bytes([data]) * 100, MOST))
        assert joiner.join(begun) is None
    assert len(joiner._unfinished) <= 16
    assert [joiner.join(piece) for piece in first][-1] == b"x" * 30


def test_a_message_that_is_too_long_is_refused() -> None:
    pieces = list(in_pieces(bytes(MAX_MESSAGE_BYTES + 1), MAX_MESSAGE_BYTES // 2))
    joiner = Joiner()
    assert len(pieces) == 3
    assert [joiner.join(piece) for piece in pieces[:2]] == [None, None]
    with pytest.raises(SchemaError, match="is longer than the"):
        joiner.join(pieces[2])


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\xc1", "1 bytes are too short"),
        (b"\xc1" + bytes(24), "25 bytes are too short"),
        (b"\xc1" + bytes(25), "is number 0 of 0"),
        (b"\xc1" + bytes(16) + b"\0\0\0\2\0\0\0\2" + b"x", "is number 2 of 2"),
    ],
)
def test_what_begins_like_a_piece_and_is_none_is_refused(data: bytes, what: str) -> None:
    with pytest.raises(SchemaError, match=what):
        Joiner().join(data)
