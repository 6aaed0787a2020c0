"""Both transports pass the kit that is shipped for them."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from secrets import token_hex

import numpy as np
import pytest
import zenoh
from support.live import until
from support.sockets import break_link
from support.zenoh_ports import open_zenoh

from hierax.runtime.testing.transport import check_transport, receive
from hierax.runtime.transport import inbox, shared_process
from hierax.runtime.transport.port import MemoryNetwork, MemoryPort, Port, TransportError
from hierax.runtime.transport.zenoh_port import ZenohPort
from hierax.runtime.transport.zenoh_session import LOW_LATENCY_BYTES
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, Header, Message, encode_message


def open_memory(edges: Sequence[tuple[str, str]]) -> Mapping[str, Port]:
    network = MemoryNetwork(seed=1)
    return {name: network.open_port(name) for name in sorted({name for edge in edges for name in edge})}


def break_in_memory(ports: Mapping[str, Port], one: str, other: str) -> None:
    port = ports[one]
    assert isinstance(port, MemoryPort)
    port._network.break_link(one, other)


def break_over_zenoh(ports: Mapping[str, Port], one: str, other: str) -> None:
    """Break all links of one of them; that to the first session is made again by itself, and the others then are."""
    zenoh_ports = {name: port for name, port in ports.items() if isinstance(port, ZenohPort)}
    for name in zenoh_ports.keys() - {one}:
        break_link(zenoh_ports[one]._session, zenoh_ports[name]._session)
    threading.Thread(target=greet_for_a_while, args=[list(zenoh_ports.values())], daemon=True).start()


def greet_for_a_while(ports: Sequence[ZenohPort]) -> None:
    for _ in range(100):
        time.sleep(0.05)
        try:
            for port in ports:
                port.greet()
        except TransportError:
            return  # closed


def test_memory() -> None:
    check_transport(open_memory, break_link=break_in_memory)


def test_zenoh() -> None:
    check_transport(open_zenoh, break_link=break_over_zenoh)


def test_zenoh_with_shared_memory() -> None:
    check_transport(lambda edges: open_zenoh(edges, shared=True), break_link=break_over_zenoh)


def test_nodes_in_one_process() -> None:
    check_transport(lambda edges: open_zenoh(edges, together=True))


def test_low_latency_zenoh() -> None:
    check_transport(lambda edges: open_zenoh(edges, low_latency=True), LOW_LATENCY_BYTES)


def test_memory_is_bounded() -> None:
    network = MemoryNetwork(queue_size=3)
    port = network.open_port("a")
    network.open_port("b")
    for _ in range(3):
        port.send(Message(Header(OBSERVATIONS, "a", "b", 1), ()))
    with pytest.raises(TransportError, match="3 obs messages to b are not received yet"):
        port.send(Message(Header(OBSERVATIONS, "a", "b", 1), ()))


def test_memory_order_is_the_seed_s() -> None:
    def order(seed: int) -> list[str]:
        network = MemoryNetwork(seed)
        ports = {name: network.open_port(name) for name in "abcd"}
        for sender in "bcd":
            for epoch in range(5):
                ports[sender].send(Message(Header(OBSERVATIONS, sender, "a", epoch), ()))
        messages = [ports["a"].receive() for _ in range(15)]
        return [message.header.sender for message in messages if message is not None]

    assert order(1) == order(1)
    assert len({tuple(order(seed)) for seed in range(20)}) > 15


@pytest.fixture
def pair() -> dict[str, ZenohPort]:
    return open_zenoh([("low", "up")], Keys("conformance", "pair" + token_hex(4)))


def put(port: ZenohPort, kind: str, data: bytes) -> None:
    """What somebody who holds a publisher could put there."""
    port._publishers[kind, "up"].put(data)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\xc1\x00", "does not begin like a message"),
        (encode_message(Message(Header(OBSERVATIONS, "other", "up", 1), ())), "obs message from 'other' on key"),
        (encode_message(Message(Header(CONTEXT, "low", "up", 1), ())), "ctx message from 'low' on key"),
        (encode_message(Message(Header(HELLO, "low", "up", 0), ("hi",))), "expected one map"),
    ],
)
def test_zenoh_drops_what_is_no_message(pair: dict[str, ZenohPort], data: bytes, what: str) -> None:
    low, up = pair["low"], pair["up"]
    try:
        put(low, OBSERVATIONS, data)
        with pytest.raises(SchemaError, match=what):
            receive(up)
        low.send(Message(Header(OBSERVATIONS, "low", "up", 7), ()))
        message = receive(up)
        assert message is not None
        assert message.header.epoch == 7
    finally:
        low.close()
        up.close()


def test_zenoh_keeps_bytes_up_to_a_bound_for_a_node_that_is_elsewhere_and_has_the_rest_said_again(
    pair: dict[str, ZenohPort], monkeypatch: pytest.MonkeyPatch
) -> None:
    low, up = pair["low"], pair["up"]
    first, message = (Message(Header(OBSERVATIONS, "low", "up", epoch), ()) for epoch in (6, 7))
    low.send(first)
    assert receive(up) == first  # greetings that were under way when both had heard enough are out of the way now
    monkeypatch.setattr(inbox, "WAITING_BYTES", 1 << 20)
    low.on_mended(lambda neighbour: low.send(message))
    try:
        for _ in range(5):
            low._session.put(low._keys.edge(CONTEXT, "nobody", "up"), bytes(300_000))
            put(low, OBSERVATIONS, bytes(300_000))
        put(low, OBSERVATIONS, bytes((1 << 20) - 1))

        def is_over() -> bool:
            up.relieve()
            return not up.ready

        until(is_over, "some of it is dropped")
        assert [len(sample.payload) for sample in up._inbox._kept] == [300_000] * 3
        threading.Thread(target=low.receive, daemon=True).start()
        greet = threading.Thread(target=greet_for_a_while, args=[[low, up]], daemon=True)
        greet.start()
        came: list[Message | None] = []

        def comes() -> bool:
            with suppress(SchemaError):  # what was put there above
                came.append(receive(up))
            return message in came

        until(comes, "the message that is said again")
    finally:
        low.close()
        up.close()
    greet.join()


def test_what_another_thread_greets_by_just_now_is_let_go_of_all_the_same(pair: dict[str, ZenohPort]) -> None:
    low, up = pair["low"], pair["up"]
    lane = (OBSERVATIONS, "up")
    publisher, is_under_way = low._publishers[lane], threading.Event()

    def put_some() -> None:
        with suppress(zenoh.ZError):  # it may be that nobody puts at that moment
            for _ in range(8):
                is_under_way.set()
                publisher.put(bytes(4 << 20))

    putting = threading.Thread(target=put_some)
    putting.start()
    try:
        assert is_under_way.wait(60.0)
        low.unlink(1 << 20)
        assert not low._publishers
    finally:
        putting.join()
        low.close()
        up.close()


def test_what_nodes_of_one_process_hand_over_is_bounded_by_bytes_and_the_rest_said_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ports = open_zenoh([("low", "up")], Keys("conformance", "beside" + token_hex(4)), together=True)
    low, up = ports["low"], ports["up"]
    monkeypatch.setattr(shared_process, "WAITING_BYTES", 1 << 20)
    again = Message(Header(OBSERVATIONS, "low", "up", 9), ("again",))
    low.on_mended(lambda neighbour: low.send(again))
    try:
        for epoch in range(5):
            low.send(Message(Header(OBSERVATIONS, "low", "up", epoch), (np.zeros(300_000, np.uint8),)))
        up.relieve()
        assert not up.ready, "some of it is dropped"
        came = [message.header.epoch for message in iter(up.poll, None)]
        assert came == [0, 1, 2]
        threading.Thread(target=low.receive, daemon=True).start()
        greet = threading.Thread(target=greet_for_a_while, args=[[low, up]], daemon=True)
        greet.start()
        said_again = receive(up)
        assert said_again is not None
        assert said_again.header == again.header
    finally:
        low.close()
        up.close()
    greet.join()


def test_zenoh_wakes_a_node_whose_wake_up_was_looked_through(pair: dict[str, ZenohPort]) -> None:
    up = pair["up"]
    take = up._inbox.take

    def late(waits: bool) -> zenoh.Sample | None:
        """Another thread comes between a look whether there was an interruption, and one for what came."""
        up._inbox.take = take  # type: ignore[method-assign]
        up.interrupt()
        up.relieve()
        return take(waits)

    up._inbox.take = late  # type: ignore[method-assign]
    try:
        waiting = threading.Thread(target=up.receive, daemon=True)
        waiting.start()
        waiting.join(60.0)
        assert not waiting.is_alive()
    finally:
        for port in pair.values():
            port.close()


def test_zenoh_does_not_hold_up_who_interrupts_a_node_that_takes_nothing_any_more(pair: dict[str, ZenohPort]) -> None:
    low, up = pair["low"], pair["up"]

    def is_full() -> bool:
        """Whether a put to the port waits."""
        putting = threading.Thread(target=lambda: up._session.put(up._own_key, b""), daemon=True)
        putting.start()
        putting.join(0.5)
        return putting.is_alive()

    def flood() -> None:
        for _ in range(4 * inbox.QUEUE_SIZE):
            low._session.put(low._keys.edge(CONTEXT, "nobody", "up"), b"")

    flooding = threading.Thread(target=flood, daemon=True)
    flooding.start()
    try:
        until(is_full, "a full queue")
        interrupting = threading.Thread(target=lambda: [up.interrupt() for _ in range(10)], daemon=True)
        interrupting.start()
        interrupting.join(60.0)
        assert not interrupting.is_alive()
        assert up.receive() is None, "an interruption comes before messages"
        until(lambda: up.poll() is None and not flooding.is_alive(), "room for all")
    finally:
        for port in pair.values():
            port.close()


def test_zenoh_polls_messages_however_often_a_node_is_interrupted(pair: dict[str, ZenohPort]) -> None:
    low, up = pair["low"], pair["up"]
    try:
        low.send(Message(Header(OBSERVATIONS, "low", "up", 7), ()))

        def comes() -> Message | None:
            up.interrupt()
            return up.poll()

        until(comes, "a message")
        assert up.receive() is None, "the interruption is not forgotten"
    finally:
        for port in pair.values():
            port.close()


def test_zenoh_connects_whatever_comes_before_a_greeting() -> None:
    hello = encode_message(Message(Header(HELLO, "low", "up", 0), ("hi",)))
    ports = open_zenoh([("low", "up")], early=[b"", b"\xc1\x00", hello]).values()
    assert all(port.ready for port in ports)
    for port in ports:
        port.close()
