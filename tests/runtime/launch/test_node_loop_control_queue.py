"""What others say to a process waits, within bounds."""

from __future__ import annotations

from hierax.runtime.launch.node_loop import MAX_BYTES, MAX_WORDS, ControlQueue
from hierax.schemas.control import AskStatus


def test_words_come_out_in_their_order_and_not_too_many_wait() -> None:
    queue = ControlQueue()
    assert [queue.put(AskStatus(number), 10) for number in range(MAX_WORDS + 1)] == [True] * MAX_WORDS + [False]
    assert len(queue) == MAX_WORDS
    assert queue.take() == AskStatus(0)
    assert queue.put(AskStatus(-1), 10)
    assert queue.take() == AskStatus(1)


def test_nor_too_many_bytes() -> None:
    queue = ControlQueue()
    assert queue.put(AskStatus(0), MAX_BYTES)
    assert not queue.put(AskStatus(1), 1)
    assert (queue.take(), queue.take()) == (AskStatus(0), None)
    assert queue.put(AskStatus(1), 1)
