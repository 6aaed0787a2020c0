"""What others say to a process waits, within bounds."""

from __future__ import annotations

from hierax.runtime.launch.backlog import MAX_BYTES, MAX_WORDS, Backlog
from hierax.schemas.control import AskStatus


def test_words_come_out_in_their_order_and_not_too_many_wait() -> None:
    backlog = Backlog()
    assert [backlog.put(AskStatus(number), 10) for number in range(MAX_WORDS + 1)] == [True] * MAX_WORDS + [False]
    assert len(backlog) == MAX_WORDS
    assert backlog.take() == AskStatus(0)
    assert backlog.put(AskStatus(-1), 10)
    assert backlog.take() == AskStatus(1)


def test_nor_too_many_bytes() -> None:
    backlog = Backlog()
    assert backlog.put(AskStatus(0), MAX_BYTES)
    assert not backlog.put(AskStatus(1), 1)
    assert (backlog.take(), backlog.take()) == (AskStatus(0), None)
    assert backlog.put(AskStatus(1), 1)
