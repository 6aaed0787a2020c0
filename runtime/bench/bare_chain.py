"""The rival of `hierax bench epoch`: the same chain in bare Zenoh callbacks and msgpack.

Run as a process for each role: world, arm, spatial, or echo (which answers the world at once, for the time of a bare
round trip). The world prints how long each epoch took, in microseconds, as JSON."""

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

from hierax.runtime.host.streams import own_streams
from hierax.runtime.transport.zenoh_session import LOOPBACK, close_session, open_session

RETRY_S = 0.05


class Chain:
    """One process of the chain: its session, and puts and callbacks on it."""

    def __init__(self, listen: str, connect: str) -> None:
        self.session = open_session([listen or LOOPBACK], [connect] if connect else [])
        self._kept: list[Any] = []

    def publisher(self, key: str) -> Callable[[bytes], None]:
        """What puts bytes on a key, as our own ports do."""
        publisher = self.session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            reliability=zenoh.Reliability.RELIABLE,
            express=True,
        )
        self._kept.append(publisher)
        put: Callable[[bytes], None] = publisher.put
        return put

    def on(self, key: str, callback: Callable[[bytes], None]) -> None:
        """Call back with the bytes put on a key."""
        self._kept.append(self.session.declare_subscriber(key, lambda sample: callback(sample.payload.to_bytes())))


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

    def on_down(data: bytes) -> None:
        message = msgpack.unpackb(data)
        if "picture" in message:
            np.frombuffer(message["picture"], np.uint8)
        down(msgpack.packb({"count": message["count"], "level": message["level"]}))

    chain.on("bare/up/1", on_up)
    chain.on("bare/down/2", on_down)


def run_spatial(chain: Chain, picture: int, key: str = "2") -> None:
    """Answer an observation, with a picture where one is wanted."""
    down = chain.publisher(f"bare/down/{key}")
    pixels = np.zeros(picture, np.uint8)

    def on_up(data: bytes) -> None:
        message = msgpack.unpackb(data)
        answer = {"count": message["count"], "level": message["level"]}
        if picture:
            answer["picture"] = pixels.data
        down(msgpack.packb(answer))

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
    options = parser.parse_args()
    own_streams()
    chain = Chain(options.listen, options.connect)
    if options.role == "world":
        threading.Thread(target=leave, args=[chain], daemon=True).start()
        print(json.dumps(run_world(chain, options.epochs)), flush=True)
    elif options.role == "arm":
        run_arm(chain)
    else:
        run_spatial(chain, options.picture, "1" if options.role == "echo" else "2")
    if options.role != "world":
        leave(chain)
    close_session(chain.session)


if __name__ == "__main__":
    main()
