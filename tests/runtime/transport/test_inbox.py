"""What waits is bounded by its bytes; who sends many small messages waits as if nobody looked in."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import pytest
import zenoh

from hierax.runtime.transport import inbox as inboxes
from hierax.runtime.transport.inbox import (
    LARGE_BYTES,
    LEAST_BLIND,
    LOOKS,
    MOST_BLIND,
    QUEUE_SIZE,
    SMALL_AT_ONCE,
    WAITING_BYTES,
    Inbox,
)

KEY = "to/me"


class Payload(NamedTuple):
    """Bytes that are only counted."""

    size: int

    def __len__(self) -> int:
        return self.size


class Sample(NamedTuple):
    """A message, as far as an inbox looks at it."""

    payload: Payload
    key_expr: str = KEY


class Queue(deque[Sample]):
    """Zenoh's, as far as an inbox asks it."""

    def try_recv(self) -> Sample | None:
        return self.popleft() if self else None


def inbox_of(queue: Queue) -> Inbox:
    return Inbox(cast("zenoh.Subscriber[Any]", queue), lambda: None)


def test_small_messages_stay_in_the_queue_that_holds_their_senders_up() -> None:
    queue = Queue([Sample(Payload(100))] * 10_000)
    inbox, looks = inbox_of(queue), 10
    for _ in range(looks):
        assert inbox.take(waits=False) is not None
        assert not inbox.relieve({KEY})
    assert len(queue) >= 10_000 - looks * (SMALL_AT_ONCE + 1)
    for _ in range(looks):  # nobody takes any
        assert not inbox.relieve({KEY})
    assert len(queue) >= 10_000 - QUEUE_SIZE - 2 * looks * (SMALL_AT_ONCE + 1)


def test_large_messages_behind_small_ones_are_kept_up_to_a_bound_in_their_order() -> None:
    small, large = [Sample(Payload(size)) for size in range(QUEUE_SIZE // 2)], Sample(Payload(16 * LARGE_BYTES))
    queue = Queue([*small, Sample(Payload(1), "to/nobody"), *[large] * 100])
    inbox = inbox_of(queue)
    assert inbox.relieve({KEY}) == {KEY}
    assert not queue
    came = []
    while (sample := inbox.take(waits=False)) is not None:
        came.append(cast("Sample", sample))
    assert came[: len(small)] == small
    assert came[len(small) :] == [large] * len(came[len(small) :])
    assert WAITING_BYTES - 2 * len(large.payload) < sum(len(each.payload) for each in came) <= WAITING_BYTES


def test_nothing_is_looked_through_while_the_node_waits() -> None:
    queue = Queue([Sample(Payload(LARGE_BYTES))])
    inbox = inbox_of(queue)
    with inbox._taking:
        assert not inbox.relieve({KEY})
    assert len(queue) == 1


class Full(queue.Queue[Sample]):
    """Zenoh's, as one who puts into it meets it: others are always quicker, and the next one waits."""

    def __init__(self) -> None:
        super().__init__(QUEUE_SIZE)
        self.put_first: Callable[[], None] = lambda: None

    def try_recv(self) -> Sample | None:
        return None if self.empty() else self.get()

    def recv(self) -> Sample:
        self.put_first()
        return self.get()


def test_who_interrupts_a_node_is_not_held_up_by_a_queue_that_filled_up_meanwhile() -> None:
    full, woken = Full(), Sample(Payload(0), "wake")
    others = [Sample(Payload(size)) for size in range(QUEUE_SIZE)]
    waking = threading.Event()

    def wake() -> None:
        for each in others:
            full.put(each)
        waking.set()
        full.put(woken)

    inbox = Inbox(cast("zenoh.Subscriber[Any]", full), wake)
    interrupting = threading.Thread(target=inbox.interrupt, daemon=True)

    def put_first() -> None:  # the node's thread sleeps, and has what it sleeps for as the other one begins to wake it
        interrupting.start()
        assert waking.wait(60.0)

    full.put_first = put_first
    came = [inbox.take(waits=True)]
    interrupting.join(60.0)  # nobody takes anything any more
    assert not interrupting.is_alive()
    inbox.interrupt()
    while (sample := inbox.take(waits=False)) is not None:
        came.append(sample)
    assert came == [*others, woken]
    assert inbox.take(waits=True) is None
    assert inbox.interrupted


class Late(Queue):
    """Zenoh's, in which something comes only when nobody looks for it any more."""

    def recv(self) -> Sample:
        return Sample(Payload(1))


@pytest.mark.parametrize("others", [False, True])
def test_nothing_is_looked_for_where_others_want_the_processor(others: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, looks = 0.0, 0

    def give_away() -> None:
        nonlocal now_s, looks
        now_s, looks = now_s + (3e-3 if others else 5e-7), looks + 1

    monkeypatch.setattr(inboxes, "perf_counter", lambda: now_s)
    monkeypatch.setattr("os.sched_yield", give_away)
    inbox, waits = inbox_of(Late()), 20 * MOST_BLIND
    for _ in range(waits):
        assert inbox.take(waits=True) is not None
    assert looks < 30 if others else looks == waits * LOOKS
    others, looks = False, 0  # who wanted it is gone
    inbox._blind = 0
    arriving = [None, Sample(Payload(1))]

    def arrives() -> Sample | None:
        return arriving[looks % 2]

    monkeypatch.setattr(inbox, "_subscriber", type("Prompt", (), {"try_recv": staticmethod(arrives)}))
    for _ in range(60):
        looks = 0
        assert inbox.take(waits=True) is not None
    assert inbox._blinded < 2 * LEAST_BLIND
