"""`check_transport`: what every transport has to do, as one function to call from a test."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np

from hierax.runtime.transport.port import Port, TransportError
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message, encode_message
from hierax.schemas.values import Value

Edges = Sequence[tuple[str, str]]
OpenPorts = Callable[[Edges], Mapping[str, Port]]
BreakLink = Callable[[Mapping[str, Port], str, str], None]

EDGES: Edges = (("world", "left"), ("world", "right"), ("left", "top"), ("right", "top"))
TIMEOUT_S = 20.0
LANE_MESSAGES = 500
BURST = 50


def check_transport(open_ports: OpenPorts, most_bytes: int | None = None, break_link: BreakLink | None = None) -> None:
    """Check a transport.

    Args:
        open_ports: given edges (lower, upper), opens a port for each node and connects them; they are closed here.
        most_bytes: how long a message it carries; None: any that is a message. Of a longer one it has to say that it
            does not.
        break_link: breaks the link between two of the ports, and mends it, or lets it be mended; None: that a port
            tells of it is not checked.

    Raises:
        AssertionError: the transport does not do what `Port` promises; says what.
    """
    for check in (
        _carries_everything if most_bytes is None else _carries_up_to(most_bytes),
        _keeps_order,
        _refuses_strangers,
        _refuses_what_cannot_travel,
        _can_be_interrupted,
        *([] if break_link is None else [_tells_of(break_link)]),
        _closes,
    ):
        ports = open_ports(EDGES)
        try:
            check(ports)
        finally:
            for port in ports.values():
                port.close()


def receive(port: Port, timeout_s: float = TIMEOUT_S) -> Message | None:
    """The next message, or None where none came in time."""
    watchdog = threading.Timer(timeout_s, port.interrupt)
    watchdog.start()
    try:
        return port.receive()
    finally:
        watchdog.cancel()


def _carries_everything(ports: Mapping[str, Port]) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 8), np.uint8)
    _carries(ports, ((), ("small", 1.5, None), ({"picture": picture, "line": np.arange(3.0)}, picture[:100])))


def _carries_up_to(most_bytes: int) -> Callable[[Mapping[str, Port]], None]:
    def check(ports: Mapping[str, Port]) -> None:
        header = Header(OBSERVATIONS, "world", "right", 3, 2, 3, 0, 0.25, bytes(range(32)), {"trace": 3})
        # none of the others has longer names
        room = most_bytes - len(encode_message(Message(header, (bytes(most_bytes // 2),)))) + most_bytes // 2
        _carries(ports, ((), ("small", 1.5, None), (bytes(room),)))
        with _refused(TransportError, str(most_bytes), f"world: a message of {most_bytes + 1} bytes was sent, or lost"):
            ports["world"].send(Message(header, (bytes(room + 1),)))

    return check


@contextmanager
def _refused(kind: type[Exception], named: str, otherwise: str) -> Iterator[None]:
    """See that something is refused, by an error that names something."""
    try:
        yield
    except kind as error:
        assert named in str(error), f"the error does not name {named}: {error}"
    else:
        raise AssertionError(otherwise)


def _carries(ports: Mapping[str, Port], payloads: Sequence[tuple[Value, ...]]) -> None:
    sent: dict[str, list[bytes]] = {name: [] for name in ports}
    for number, payload in enumerate(payloads, start=1):
        for lower, upper in EDGES:
            lines = ((OBSERVATIONS, lower, upper), (TASKS, upper, lower), (CONTEXT, upper, lower))
            for kind, sender, receiver in lines:
                header = Header(kind, sender, receiver, number, 2, 3, 0, 0.25, bytes(range(32)), {"trace": number})
                ports[sender].send(Message(header, payload))
                sent[receiver].append(encode_message(Message(header, payload)))
    for name, port in ports.items():
        got = [receive(port) for _ in sent[name]]
        came = sorted(encode_message(message) for message in got if message is not None)
        assert came == sorted(sent[name]), f"{name}: {len(came)} of {len(sent[name])} messages came, or came changed"


def _keeps_order(ports: Mapping[str, Port]) -> None:
    came: dict[str, list[int]] = {"left": [], "right": []}
    for start in range(0, LANE_MESSAGES, BURST):
        for number in range(start, start + BURST):
            for sender in came:
                ports[sender].send(Message(Header(OBSERVATIONS, sender, "top", number), (number,)))
        for _ in range(BURST * len(came)):
            message = receive(ports["top"])
            assert message is not None, f"messages were lost: {[len(numbers) for numbers in came.values()]} came"
            came[message.header.sender].append(message.payload[0])
    for sender, numbers in came.items():
        assert numbers == list(range(LANE_MESSAGES)), f"{sender}: lost, doubled or out of order"


def _refuses_strangers(ports: Mapping[str, Port]) -> None:
    with _refused(TransportError, "nobody", "a message to nobody was taken"):
        ports["world"].send(Message(Header(OBSERVATIONS, "world", "nobody", 1), ()))


def _refuses_what_cannot_travel(ports: Mapping[str, Port]) -> None:
    with _refused(SchemaError, "bad", "a set was sent"):
        ports["left"].send(Message(Header(OBSERVATIONS, "left", "top", 1), ({"bad": {1, 2}},)))
    ports["left"].send(Message(Header(OBSERVATIONS, "left", "top", 2), ()))
    message = receive(ports["top"])
    assert message is not None, "the message after a refused one was lost"
    assert message.header.epoch == 2, "a refused message was delivered"


def _can_be_interrupted(ports: Mapping[str, Port]) -> None:
    port = ports["top"]
    threading.Timer(0.01, port.interrupt).start()
    assert receive(port) is None, "interrupted, but something came"


def _tells_of(break_link: BreakLink) -> Callable[[Mapping[str, Port]], None]:
    def check(ports: Mapping[str, Port]) -> None:
        mended: list[tuple[str, str]] = []
        for name, port in ports.items():
            port.on_mended(partial(lambda name, neighbour: mended.append((name, neighbour)), name))
        break_link(ports, "left", "top")
        patience = time.monotonic() + TIMEOUT_S
        while len(mended) < 2 and time.monotonic() < patience:
            for name in ("left", "top"):
                assert receive(ports[name], 0.05) is None, f"{name}: something came that nobody sent"
        assert sorted(mended) == [("left", "top"), ("top", "left")], f"a broken link was mended, and told was {mended}"
        ports["left"].send(Message(Header(OBSERVATIONS, "left", "top", 1), ()))
        assert receive(ports["top"]) is not None, "a message after a link was mended is lost"

    return check


def _closes(ports: Mapping[str, Port]) -> None:
    port = ports["left"]
    port.close()
    port.close()
    assert receive(port) is None, "closed, but something came"
    with _refused(TransportError, "", "a closed port took a message"):
        port.send(Message(Header(OBSERVATIONS, "left", "top", 1), ()))
