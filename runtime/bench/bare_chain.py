"""The rival of `hierax bench`: the same chain in bare Zenoh callbacks and msgpack, as quick as Zenoh knows.

Run as a process for each role: world, arm, spatial, or echo (which answers the world at once, for the time of a bare
round trip). The world prints how long each epoch took, in microseconds, as JSON. A picture is the payload itself, or a
buffer of shared memory, and what is small goes as its attachment."""

import argparse
import json
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import zenoh
import zenoh.shm

from hierax.runtime.bench.rivals.stopwatch import look
from hierax.runtime.host.streams import own_streams
from hierax.runtime.transport.zenoh_session import LOOPBACK, close_session, open_session

RETRY_S = 0.05
ORDINARY, LOW_LATENCY, SHARED = "ordinary", "low-latency", "shared-memory"  # kinds of links
BUFFERS = 4  # of shared memory

Put = Callable[..., None]


class Chain:
    """One process of the chain: its session, and puts and callbacks on it."""

    def __init__(self, listen: str, connect: str, links: str = ORDINARY) -> None:
        self.session = open_session(
            [listen or LOOPBACK],
            [connect] if connect else [],
            links="told",
            shared_memory=links == SHARED,
            low_latency=links == LOW_LATENCY,
        )
        self._kept: list[Any] = []

    def publisher(self, key: str) -> Put:
        """What puts a payload on a key, and an attachment, as our own ports do."""
        publisher = self.session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            reliability=zenoh.Reliability.RELIABLE,
            express=True,
        )
        self._kept.append(publisher)
        put: Put = publisher.put
        return put

    def on(self, key: str, callback: Callable[[bytes], None]) -> None:
        """Call back with the bytes put on a key."""
        self.on_sample(key, lambda sample: callback(sample.payload.to_bytes()))

    def on_sample(self, key: str, callback: Callable[[zenoh.Sample], None]) -> None:
        """Call back with what was put on a key."""
        self._kept.append(self.session.declare_subscriber(key, callback))


def run_world(chain: Chain, epochs: int) -> list[float]:
    """Send an observation up, wait for what comes down, again and again."""
    send = chain.publisher("bare/up/1")
    times_us: list[float] = []
    begun = threading.Event()
    done = threading.Event()
    started = [0.0]

    def start(count: int) -> None:
        started[0] = time.perf_counter()
        send(msgpack.packb({"count": count, "level": 0.5 * count}))

    def on_down(data: bytes) -> None:
        message = msgpack.unpackb(data)
        count = message["count"]
        if count != len(times_us):
            return  # the answer to a repeated beginning
        times_us.append(1e6 * (time.perf_counter() - started[0]))
        begun.set()
        if len(times_us) < epochs:
            start(len(times_us))
        else:
            done.set()

    chain.on("bare/down/1", on_down)
    while not begun.is_set():
        start(0)
        begun.wait(RETRY_S)
    done.wait()
    return times_us


def run_arm(chain: Chain) -> None:
    """Pass observations up and what comes down on."""
    up = chain.publisher("bare/up/2")
    down = chain.publisher("bare/down/1")

    def on_up(data: bytes) -> None:
        message = msgpack.unpackb(data)
        up(msgpack.packb({"count": message["count"], "level": message["level"]}))

    def on_down(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if sample.attachment is None:
            message = msgpack.unpackb(payload)
        else:
            message = msgpack.unpackb(sample.attachment.to_bytes())
            look(np.frombuffer(payload, np.uint8))
        down(msgpack.packb({"count": message["count"], "level": message["level"]}))

    chain.on("bare/up/1", on_up)
    chain.on_sample("bare/down/2", on_down)


def run_spatial(chain: Chain, picture: int, key: str = "2", links: str = ORDINARY) -> None:
    """Answer an observation, with a picture where one is wanted."""
    down = chain.publisher(f"bare/down/{key}")
    pixels = bytearray(picture)
    provider = zenoh.shm.ShmProvider.default_backend(BUFFERS * picture) if picture and links == SHARED else None
    policy = zenoh.shm.BlockOn(zenoh.shm.GarbageCollect())

    def on_up(data: bytes) -> None:
        message = msgpack.unpackb(data)
        answer = msgpack.packb({"count": message["count"], "level": message["level"]})
        if provider is not None:
            buffer = provider.alloc(picture, policy)
            buffer[:] = pixels
            down(buffer, attachment=answer)
        elif picture:
            down(pixels, attachment=answer)
        else:
            down(answer)

    chain.on(f"bare/up/{key}", on_up)


def leave(chain: Chain) -> None:
    """End the process with its standard input."""
    while os.read(0, 1):
        continue
    close_session(chain.session)
    os._exit(0)


def main() -> None:
    """One process of the chain, at most until standard input ends: until whoever has started it is gone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=("world", "arm", "spatial", "echo"))
    for name, default in (("--listen", ""), ("--connect", ""), ("--epochs", 1000), ("--picture", 0)):
        parser.add_argument(name, type=type(default), default=default)
    parser.add_argument("--links", choices=(ORDINARY, LOW_LATENCY, SHARED), default=ORDINARY)
    options = parser.parse_args()
    own_streams()
    chain = Chain(options.listen, options.connect, options.links)
    if options.role == "world":
        threading.Thread(target=leave, args=[chain], daemon=True).start()
        print(json.dumps(run_world(chain, options.epochs)), flush=True)
    elif options.role == "arm":
        run_arm(chain)
    else:
        run_spatial(chain, options.picture, "1" if options.role == "echo" else "2", options.links)
    if options.role != "world":
        leave(chain)
    close_session(chain.session)


if __name__ == "__main__":
    main()
