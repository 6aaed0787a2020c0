"""Ports over Zenoh that are linked, all in one process."""

import threading
from collections.abc import Mapping, Sequence
from secrets import token_hex

import pytest

from hierax.runtime.core.graph import neighbours
from hierax.runtime.transport.shared_arrays import SharedArrays
from hierax.runtime.transport.shared_process import Neighbours
from hierax.runtime.transport.zenoh_port import INTERRUPT, ZenohPort
from hierax.runtime.transport.zenoh_session import LOOPBACK, LOW_LATENCY_BYTES, free_endpoint, open_session
from hierax.schemas.keys import Keys
from hierax.schemas.messages import CONTEXT, OBSERVATIONS


def open_zenoh(
    edges: Sequence[tuple[str, str]],
    keys: Keys | None = None,
    early: Sequence[bytes] = (),
    low_latency: bool = False,
    shared: bool = False,
    together: bool = False,
) -> dict[str, ZenohPort]:
    """A session for each node; the first one is what the others find one another through.

    Args:
        edges: (lower, upper).
        keys: of the run.
        early: what somebody puts on keys of each port before it connects.
        low_latency: of the links.
        shared: whether large arrays may go through shared memory.
        together: one session for all, as nodes have it that share a process.
    """
    keys = keys or Keys("conformance", token_hex(4))
    hub = free_endpoint()
    ports: dict[str, ZenohPort] = {}
    beside = Neighbours() if together else None
    session = open_session([hub]) if together else None
    for number, name in enumerate(sorted({name for edge in edges for name in edge})):
        if not together:
            session = open_session([LOOPBACK if number else hub], [hub] if number else [], low_latency=low_latency)
        assert session is not None
        most_bytes, memory = LOW_LATENCY_BYTES if low_latency else None, SharedArrays() if shared else None
        ports[name] = ZenohPort(session, keys, name, name if together else "", most_bytes, memory, beside)
        below, above = (each.get(name, ()) for each in neighbours(edges))
        ports[name].link(below, above, 0, {}, lambda _: None)
        for data in early:
            for kind in (OBSERVATIONS, CONTEXT, INTERRUPT):
                session.put(keys.edge(kind, name, name), data)
    connect(ports)
    return ports


def connect(ports: Mapping[str, ZenohPort]) -> None:
    """As processes do it: each port answers its neighbours' greetings, also when it is done itself."""

    def answer(port: ZenohPort) -> None:
        port.connect()
        while port.receive() is not None:
            pytest.fail("a message before anybody sent one")

    threads = [threading.Thread(target=answer, args=[port], daemon=True) for port in ports.values()]
    for thread in threads:
        thread.start()
    while not all(port.ready for port in ports.values()):
        for port in ports.values():
            port.greet()
        threads[0].join(0.02)
    for port in ports.values():
        port.interrupt()
    for thread in threads:
        thread.join()
