"""What nodes of one process hand to one another, and how they wait for it."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np
import pytest
import zenoh

from hierax.runtime.transport import shared_process
from hierax.runtime.transport.shared_process import Handed, SharedInbox, hand_over
from hierax.schemas.limits import LARGE_ARRAY_BYTES
from hierax.schemas.messages import OBSERVATIONS, Header, Message, decode_message, encode_message

WAIT_S = 20.0
LARGE = LARGE_ARRAY_BYTES // 8
MANY = shared_process.ROOM + 100


def message(*payload: Any) -> Message:
    return Message(Header(OBSERVATIONS, "low", "up", 1), payload)


def frozen(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


def inbox(*wanted: str) -> SharedInbox:
    return SharedInbox(lambda: wanted)


def test_a_large_array_that_nobody_can_write_into_is_handed_over_as_it_is() -> None:
    array = frozen(np.arange(LARGE, dtype=float))
    (given,) = hand_over("key", message(array)).message.payload
    assert np.shares_memory(given, array)
    assert not given.flags.writeable


def test_a_view_of_what_can_be_written_into_is_copied() -> None:
    array = np.arange(LARGE, dtype=float)
    (given,) = hand_over("key", message(frozen(array[:]))).message.payload
    array[0] = 7.0
    assert given[0] == 0.0
    assert not given.flags.writeable


@pytest.mark.parametrize(
    "array",
    [
        np.arange(2 * LARGE, dtype=float)[::2],
        np.asfortranarray(np.ones((LARGE // 8, 8))),
        np.arange(LARGE, dtype=">f8"),
        np.arange(3),
        np.ones((LARGE, 0)),
    ],
    ids=["every second", "by columns", "the other byte order", "small", "empty"],
)
def test_a_receiver_gets_what_another_process_would_give_it(array: np.ndarray) -> None:
    sent = message({"array": array, "list": [1, (2, 3)]}, np.float32(0.5))
    (here, number), (there, other) = (
        each.payload for each in (hand_over("key", sent).message, decode_message(encode_message(sent)))
    )
    assert (here["list"], number, type(number)) == (there["list"], other, type(other))
    for what in ("dtype", "shape", "strides"):
        assert getattr(here["array"], what) == getattr(there["array"], what)
    assert np.array_equal(here["array"], there["array"])
    assert not here["array"].flags.writeable


def test_who_waits_is_woken_by_a_message_and_by_an_interruption() -> None:
    box, found = inbox(), []
    waiting = threading.Thread(target=lambda: found.extend([box.take(True), box.take(True)]))
    waiting.start()
    box.put(handed := hand_over("key", message("one")), inbox())
    box.interrupt()
    waiting.join(WAIT_S)
    assert found == [handed, None]


def test_who_does_not_wait_finds_messages_behind_interruptions() -> None:
    box = inbox()
    box.interrupt()
    box.put(hand_over("key", message("one")), inbox())
    assert isinstance(box.take(False), Handed)
    assert box.take(False) is None


def test_who_sends_to_a_full_queue_waits_until_there_is_room_or_the_node_is_gone() -> None:
    box = inbox()
    for _ in range(shared_process.ROOM):
        box.put(Handed("key", b"", []), inbox())
    sending = threading.Thread(target=box.put, args=[Handed("last", b"", []), inbox()])
    sending.start()
    sending.join(0.05)
    assert sending.is_alive()
    box.take(False)
    sending.join(WAIT_S)
    assert not sending.is_alive()
    other = threading.Thread(target=box.put, args=[Handed("never", b"", []), inbox()])
    other.start()
    box.close()
    other.join(WAIT_S)
    assert not other.is_alive()


def test_two_that_send_to_one_another_s_full_queues_go_on() -> None:
    boxes, came = (inbox(), inbox()), ([], [])

    def send_then_take(number: int) -> None:
        own, other = boxes[number], boxes[1 - number]
        for each in range(MANY):
            other.put(Handed(str(each), b"", []), own)
        came[number].extend(own.take(True) for _ in range(MANY))

    threads = [threading.Thread(target=send_then_take, args=[number], daemon=True) for number in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(WAIT_S)
    assert [[each.key for each in taken] for taken in came] == [[str(each) for each in range(MANY)]] * 2


class Came:
    """A sample that came by the network, of so many bytes."""

    def __init__(self, key: str, size: int) -> None:
        self.key_expr, self.payload = key, bytes(size)


def test_what_came_by_the_network_is_bounded_by_its_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_process, "WAITING_BYTES", 200_000)
    monkeypatch.setattr(shared_process.zenoh, "Sample", Came)
    box = inbox("wanted")
    for key, size in (("wanted", 150_000), ("other", 100_000), ("wanted", 100_000)):
        box.arrive(cast(zenoh.Sample, Came(key, size)))
    assert box.relieve(("wanted",)) == {"wanted"}
    assert box.relieve(("wanted",)) == set()
    first = box.take(False)
    assert isinstance(first, Came)
    assert box.take(False) is None
    box.arrive(cast(zenoh.Sample, Came("wanted", 150_000)))
    assert isinstance(box.take(False), Came)


def test_what_is_handed_over_is_bounded_by_its_bytes_also_where_it_is_put_aside(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shared_process, "WAITING_BYTES", 200_000)
    box, picture = inbox("wanted"), np.zeros(120_000, np.uint8)
    for number, key in enumerate(("wanted", "wanted", "other")):
        box.put(hand_over(key, message(number, picture)), inbox())
        box.stash()
    assert box.relieve(("wanted",)) == {"wanted"}
    assert box.relieve(("wanted",)) == set()
    first = box.take(False)
    assert isinstance(first, Handed)
    assert first.message.payload[0] == 0
    assert box.take(False) is None
    box.put(hand_over("wanted", message(3, np.zeros(300_000, np.uint8))), inbox())
    assert isinstance(box.take(False), Handed), "any message has room where nothing else waits"


def test_who_hands_over_too_many_bytes_waits_a_moment_for_a_node_that_is_in_no_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shared_process, "WAITING_BYTES", 200_000)
    monkeypatch.setattr(shared_process, "PATIENCE_S", WAIT_S)
    box, sender = inbox("wanted"), inbox()
    box.put(hand_over("wanted", message(np.zeros(150_000, np.uint8))), sender)
    waiting = threading.Event()
    monkeypatch.setattr(sender, "stash", waiting.set)
    more = hand_over("wanted", message("more", np.zeros(150_000, np.uint8)))
    sending = threading.Thread(target=box.put, args=[more, sender], daemon=True)
    sending.start()
    assert waiting.wait(WAIT_S)
    assert box.take(False) is not None
    assert box.take(True) is more
    assert box.relieve(("wanted",)) == set()


def test_nobody_waits_a_second_time_for_a_node_that_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_process, "WAITING_BYTES", 200_000)
    monkeypatch.setattr(shared_process, "PATIENCE_S", 0.0)
    box = inbox("wanted")
    picture = hand_over("wanted", message(np.zeros(150_000, np.uint8)))
    box.put(picture, inbox())
    box.put(picture, inbox())
    monkeypatch.setattr(shared_process, "PATIENCE_S", 10 * WAIT_S)
    sending = threading.Thread(target=box.put, args=[picture, inbox()], daemon=True)
    sending.start()
    sending.join(WAIT_S)
    assert not sending.is_alive()
