"""Processes that are missed, and the hub that has them link again."""

from __future__ import annotations

import threading
from secrets import token_hex
from types import SimpleNamespace
from typing import cast

import pytest
import zenoh
from support.launched import until
from support.sockets import break_link

from hierax.runtime.transport.hub import Hub
from hierax.runtime.transport.rendezvous import FIRST_TRY, TRIES_S, AbsentProcesses
from hierax.runtime.transport.shared_process import Neighbours
from hierax.runtime.transport.zenoh_port import ZenohPort
from hierax.runtime.transport.zenoh_session import open_session
from hierax.schemas.keys import Keys
from hierax.schemas.messages import OBSERVATIONS, Header, Message


def test_who_is_gone_is_asked_for_a_few_times() -> None:
    now = 0.0
    absent = AbsentProcesses(lambda: now)
    absent.gone("a")
    absent.gone("b")
    absent.came("b")
    asked = []
    for tenth in range(400):
        now = tenth / 10
        asked += [(process, now) for process in absent.due()]
    assert [process for process, _ in asked] == ["a"] * len(TRIES_S)
    assert [when for _, when in asked] == pytest.approx(TRIES_S, abs=0.11)


def test_who_waits_for_its_first_links_asks_for_itself_until_it_is_answered() -> None:
    now = 0.0
    absent = AbsentProcesses(lambda: now)
    absent.waits("newcomer")
    now = 1.0
    absent.waits("newcomer")  # still
    asked = []
    for tenth in range(10, 600):
        now = tenth / 10
        asked += [(process, now) for process in absent.due()]
    assert [when for _, when in asked] == pytest.approx([3, 10, 20, 30, 40, 50], abs=0.11)
    absent.came("newcomer")
    now += 100.0
    assert not absent.due()


def test_a_port_that_sees_its_own_sign_of_life_late_waits_on() -> None:
    keys, now = Keys("absent", token_hex(4)), 0.0
    hub = Hub(keys, None, None)
    port = ZenohPort(open_session(connect=[hub.endpoint]), keys, "low", "low~1")
    try:
        port.absent = AbsentProcesses(lambda: now)
        port.absent.waits("low~1")
        own = SimpleNamespace(key_expr=keys.alive("low", "low~1"), kind=zenoh.SampleKind.PUT)
        port._on_alive(port._session, cast(zenoh.Sample, own))
        now = TRIES_S[FIRST_TRY]
        assert port.absent.due() == ["low~1"]
    finally:
        port.close()
        hub.close()


def test_a_port_waits_for_its_neighbours_until_all_are_linked_and_hears_nobody_before() -> None:
    keys, now = Keys("absent", token_hex(4)), 0.0
    hub = Hub(keys, None, None)
    ports = {name: ZenohPort(open_session(connect=[hub.endpoint]), keys, name, f"{name}~1") for name in ("low", "up")}
    for port in ports.values():
        port.absent = AbsentProcesses(lambda: now)
    try:
        ports["low"].link([], ["up"], 0, {}, lambda _: None)
        ports["low"].answered()  # by the owner, say, but not by its neighbour
        now = TRIES_S[FIRST_TRY]
        assert ports["low"].absent.due() == ["low~1"]
        ports["up"].link(["low"], [], 0, {}, lambda _: None)
        _shake_hands(ports)
        now += 100.0
        assert not any(port.absent.due() for port in ports.values())
    finally:
        for port in ports.values():
            port.close()
        hub.close()


def test_a_port_that_goes_on_in_another_session_misses_nobody_when_the_one_before_ends() -> None:
    keys, now = Keys("absent", token_hex(4)), 0.0
    hub = Hub(keys, None, None)
    before, after, other = (open_session(connect=[hub.endpoint]) for _ in range(3))
    beside = Neighbours()
    mate, low = (ZenohPort(before, keys, name, f"{name}~1", beside=beside) for name in ("mate", "low"))
    ports = {"low": low, "up": ZenohPort(other, keys, "up", "up~1")}
    try:
        for port in ports.values():
            port.absent = AbsentProcesses(lambda: now)
        ports["low"].link([], ["up"], 0, {}, lambda _: None)
        ports["up"].link(["low"], [], 0, {}, lambda _: None)
        _shake_hands(ports)
        for port in (low, mate):
            port.move(after)
        now = TRIES_S[FIRST_TRY]
        assert low.absent.due() == ["low~1"]  # in this session it may have no link to some of them
        _shake_hands(ports)
        left = before.zid()
        before.close()
        until(lambda: left not in after.info.peers_zid(), "the end of the session before")
        now += 100.0
        assert not low.absent.due()
    finally:
        for port in (mate, *ports.values()):
            port.close()
        after.close()
        hub.close()


def _shake_hands(ports: dict[str, ZenohPort]) -> None:
    """Have neighbours greet one another until all are linked."""
    linked = threading.Event()

    def answer(port: ZenohPort) -> None:  # also when it is done itself: its neighbour may not be
        port.connect()
        while not linked.is_set():
            port.receive()

    def greet() -> bool:
        for port in ports.values():
            port.greet()
        return all(port.ready for port in ports.values())

    threads = [threading.Thread(target=answer, args=[port], daemon=True) for port in ports.values()]
    for thread in threads:
        thread.start()
    until(greet, "the handshakes")
    linked.set()
    for thread, port in zip(threads, ports.values(), strict=True):
        until(lambda port=port, thread=thread: port.interrupt() or not thread.is_alive(), "the thread's end")  # type: ignore[misc]


def test_a_link_that_breaks_alone_is_made_again_and_both_ends_are_told() -> None:
    keys = Keys("absent", token_hex(4))
    hub = Hub(keys, None, None)
    hub.watch(lambda name, token: None)
    sessions = {name: open_session(connect=[hub.endpoint]) for name in ("low", "up")}
    ports = {name: ZenohPort(session, keys, name, f"{name}~1") for name, session in sessions.items()}
    ports["low"].link([], ["up"], 0, {}, lambda _: None)
    ports["up"].link(["low"], [], 0, {}, lambda _: None)
    mended: list[tuple[str, str]] = []
    came: list[int] = []
    ending = threading.Event()

    def receive(name: str) -> None:
        ports[name].on_mended(lambda neighbour: mended.append((name, neighbour)))
        while not ending.is_set():
            message = ports[name].receive()
            if message is not None:
                came.append(message.header.epoch)

    def greet() -> bool:
        for port in ports.values():
            port.greet()
        return all(port.ready for port in ports.values())

    threads = [threading.Thread(target=receive, args=[name], daemon=True) for name in ports]
    for thread in threads:
        thread.start()
    try:
        until(greet, "the handshake")
        until(lambda: all(hub.hears_of(f"{name}~1") for name in ports), "the tokens at the hub")
        assert not mended
        assert break_link(sessions["low"], sessions["up"]) == 1
        until(lambda: not any(port.ready for port in ports.values()), "both ends to notice")
        ports["low"].send(Message(Header(OBSERVATIONS, "low", "up", 1), ()))  # lost in silence
        missed: list[str] = []
        until(lambda: bool(missed.extend(ports["low"].absent.due()) or missed), "the process to be missed")
        assert missed == ["up~1"]
        hub.introduce("nobody that is known")
        assert not greet()
        hub.introduce(missed[0])
        until(greet, "the handshake anew")
        until(lambda: sorted(mended) == [("low", "up"), ("up", "low")], "both ends to be told")
        ports["low"].send(Message(Header(OBSERVATIONS, "low", "up", 2), ()))
        until(lambda: came == [2], "what is sent then")
    finally:
        ending.set()
        for port in ports.values():
            port.close()
        hub.close()
