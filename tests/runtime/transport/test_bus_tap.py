"""A recorder's end goes on in another session, and loses nothing of what is said meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import zenoh
from support.live import until

from hierax.runtime.transport import bus_tap
from hierax.runtime.transport.bus_tap import BEGINNING_BYTES, BusTap
from hierax.runtime.transport.zenoh_session import close_session, free_endpoint, open_session
from hierax.schemas.access import Access
from hierax.schemas.keys import Keys, process_token

KEYS = Keys("tapped", "5f")
NAMES = ("low", "high")
RENEWALS = 3


class Speaker:
    """A session that counts on a key, as quickly as it can, and tells that it lives."""

    def __init__(self, endpoint: str, name: str) -> None:
        self.key, self.said = KEYS.steps(name), 0
        self.session = open_session(connect=(endpoint,))
        self._living = self.session.liveliness().declare_token(KEYS.alive(name, process_token(name, "1")))
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._say)
        self._thread.start()

    def _say(self) -> None:
        publisher = self.session.declare_publisher(self.key, congestion_control=zenoh.CongestionControl.BLOCK)
        while not self._ending.wait(0.0005):
            self.said += 1
            publisher.put(str(self.said).encode())

    def ends(self) -> None:
        self._ending.set()
        self._thread.join()

    def close(self) -> None:
        self.ends()
        close_session(self.session)


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def speakers(endpoint: str) -> Iterator[list[Speaker]]:
    hub = open_session((endpoint,))
    made = [Speaker(endpoint, name) for name in NAMES]
    yield made
    for each in made:
        each.close()
    close_session(hub)


def test_nothing_is_lost_or_heard_twice_as_the_session_is_another_one(endpoint: str, speakers: list[Speaker]) -> None:
    tap = BusTap(endpoint, KEYS, Access("low", {name: (name,) for name in NAMES}))
    heard: list[tuple[str, int]] = []
    tokens: list[str] = []

    def take() -> bool:
        for each in tap.wait(0.0):
            if each.data:
                heard.append((each.key, int(each.data)))
            else:
                assert each.is_up, each
                tokens.append(each.key)
        return all((each.key, each.said) in heard[-50 * len(speakers) :] for each in speakers)

    until(lambda: take() or {each.key for each in speakers} <= {key for key, _ in heard}, "both")
    for _ in range(RENEWALS):
        assert tap.renew("")
        take()
    for each in speakers:
        each.ends()
    until(take, "all that was said")
    tap.close()
    for each in speakers:
        numbers = [number for key, number in heard if key == each.key]
        assert numbers == list(range(numbers[0], each.said + 1)), each.key
        assert each.said > 1000
    assert len(tokens) == len(set(tokens)) == len(speakers)
    assert tap.dropped() == []


def test_one_that_is_closed_meanwhile_stays_closed(endpoint: str, speakers: list[Speaker]) -> None:
    tap = BusTap(endpoint, KEYS, Access("low", {name: (name,) for name in NAMES}))
    went_on: list[bool] = []
    renewal = threading.Thread(target=lambda: went_on.append(tap.renew("")))
    renewal.start()
    until(lambda: tap._next is not None, "the next session")
    tap.close()
    renewal.join()
    assert went_on == [False]
    tap.wait(0.0)
    before = [each.said for each in speakers]
    until(lambda: all(each.said > said + 20 for each, said in zip(speakers, before, strict=True)), "more")
    assert tap.wait(0.0) == []


def test_of_what_is_dropped_the_header_is_kept_and_of_too_much_the_key(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_tap, "QUEUE_BYTES", 1)
    monkeypatch.setattr(bus_tap, "BEGINNINGS", 2)
    hub = open_session((endpoint,))
    tap = BusTap(endpoint, KEYS, Access("low", {name: (name,) for name in NAMES}))
    key = KEYS.edge("obs", "low", "high")
    try:
        said = bytes(range(256)) * 32
        until(lambda: hub.put(key, said) or tap._queue, "a message, which takes all room")
        hub.put(KEYS.notes, said)
        until(lambda: KEYS.notes in {each for each, _ in tap._dropped}, "the last one before those that count")
        tap.dropped()
        for number in range(4):
            hub.put(key, bytes([number]) + said)
        kept = dict.fromkeys(range(4), b"")
        until(lambda: len(tap._dropped) == len(kept), "all dropped")
        kept |= {number: bytes([number]) + said[: BEGINNING_BYTES - 1] for number in range(2)}
        assert tap.dropped() == [(key, data) for data in kept.values()]
    finally:
        tap.close()
        close_session(hub)
