"""What an epoch of processes costs as hierarchies grow: `launch` beside the same hierarchy in plain Zenoh.

    python benchmarks/growth_launch.py
    python benchmarks/growth_launch.py --stars 2 8 --chains 4 --rounds 3 --epochs 300

A star is a world that so many nodes sense; a chain has so many nodes in all. Ours are the nodes of `chain`, with
checkpoints and digests; the rival's are callbacks that pack and unpack as much with msgpack, on the same kind of
publishers (`hierax.runtime.bench.bare_chain`), linked along edges alone, as ours are. Both take turns; ratios are of
the medians of a round.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import msgpack
import numpy as np
from commands import at_least
from growth import FANOUT, hierarchy

from hierax.runtime.bench.bare_chain import Chain
from hierax.runtime.bench.epoch import from_commit_to_commit
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.transport.zenoh_session import close_session, door_at, knocking_at

WARM_UP = 0.2  # share of the epochs, at the beginning of each run, that is not counted
TIMEOUT_S = 600.0
RETRY_S = 0.2
BELOW = {"star": lambda number: 0, "chain": lambda number: number - 1, "tree": lambda number: (number - 1) // FANOUT}
"""By shape, the number of the node below one."""


# --- the rival: a process for each node, by its number; the world is 0


def bare_node(number: int, above: Sequence[int], below: int | None, doors: Sequence[str], epochs: int) -> None:
    """One process: it passes what comes up on to all above, and, when all have answered, something down."""
    chain = Chain(door_at(doors[number]), "" if below is None else knocking_at(doors[below]))
    up = [chain.publisher(f"bare/up/{upper}") for upper in above]
    down = None if below is None else chain.publisher(f"bare/down/{number}")
    answered: set[int] = set()
    times_us: list[float] = []
    begun, done = threading.Event(), threading.Event()
    now = {"count": 0, "begun": 0.0}

    def send_up(count: int) -> None:
        now.update(count=count, begun=time.perf_counter())
        answered.clear()
        for send in up:
            send(msgpack.packb({"count": count, "level": 0.5 * count}))

    def finish(count: int) -> None:
        if down is not None:
            down(msgpack.packb({"count": count, "level": 0.5 * count}))
            return
        begun.set()
        times_us.append(1e6 * (time.perf_counter() - now["begun"]))
        if len(times_us) < epochs:
            send_up(count + 1)
        else:
            done.set()

    def on_up(data: bytes) -> None:
        count = msgpack.unpackb(data)["count"]
        send_up(count)
        if not up:
            finish(count)

    def on_down(upper: int, data: bytes) -> None:
        count = msgpack.unpackb(data)["count"]
        if count != now["count"] or upper in answered:
            return  # the answer to a repeated beginning
        answered.add(upper)
        if len(answered) == len(up):
            finish(count)

    for upper in above:
        chain.on(f"bare/down/{upper}", lambda data, upper=upper: on_down(upper, data))
    if below is not None:
        chain.on(f"bare/up/{number}", on_up)
        sys.stdin.read()  # until whoever has started it is gone
        close_session(chain.session)
        return
    while not begun.is_set():
        send_up(0)
        begun.wait(RETRY_S)
    started_by = os.getppid()
    while not done.wait(1.0):
        if os.getppid() != started_by:
            return  # whoever has started it was killed
    print(json.dumps(times_us), flush=True)
    close_session(chain.session)


def bare(shape: str, size: int, epochs: int) -> list[float]:
    """How long epochs of the rival took, in µs."""
    below = [None, *(BELOW[shape](number) for number in range(1, size))]
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        doors = [f"{folder}/{number}" for number in range(size)]
        processes = []
        for number in range(size - 1, -1, -1):
            above = [upper for upper in range(size) if below[upper] == number]
            order = json.dumps([number, above, below[number], doors, epochs])
            command = [sys.executable, __file__, "--bare", order]
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            stack.callback(process.wait)
            stack.callback(process.kill)
            processes.append(process)
        times: list[float] = json.loads(processes[-1].communicate(timeout=TIMEOUT_S)[0])
    return times


def ours(shape: str, size: int, epochs: int) -> list[float]:
    """How long epochs of ours took, in µs."""
    deployment = hierarchy(shape, size, start_timeout_s=TIMEOUT_S).deployment()
    return [1e6 * each for each in from_commit_to_commit(launch(deployment, epochs=epochs, seed=0))]


def measured(shape: str, size: int, epochs: int, rounds: int) -> dict[str, Any]:
    """A row: both in turn."""
    medians: dict[str, list[float]] = {"ours_us": [], "bare_us": []}
    for number in range(rounds):
        print(f"{shape} of {size}, round {number + 1} of {rounds}", file=sys.stderr)
        for name, run in (("bare_us", bare), ("ours_us", ours)):
            medians[name].append(float(np.median(run(shape, size, epochs)[int(WARM_UP * epochs) :])))
    ratios = [one / other for one, other in zip(medians["ours_us"], medians["bare_us"], strict=True)]
    told = {name: round(statistics.median(each)) for name, each in medians.items()}
    spread = [round(min(ratios), 2), round(max(ratios), 2)]
    return {"shape": shape, "nodes": size, **told, "ratio": round(statistics.median(ratios), 2), "ratio_range": spread}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--stars", nargs="*", type=at_least(1), default=[2, 8, 32, 64], help="nodes that sense the world"
    )
    parser.add_argument(
        "--chains", nargs="*", type=at_least(2), default=[4, 8, 16, 32], help="nodes, the world among them"
    )
    parser.add_argument("--epochs", type=at_least(10), default=500)
    parser.add_argument("--rounds", type=at_least(1), default=5)
    parser.add_argument("--bare", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.bare:
        bare_node(*json.loads(options.bare))
        return 0
    print(f"{'shape':6} {'nodes':>6} {'ours, µs':>9} {'bare, µs':>9}  times bare")
    for shape, sizes in (("star", [size + 1 for size in options.stars]), ("chain", options.chains)):
        for size in sizes:
            row = measured(shape, size, options.epochs, options.rounds)
            low, high = row["ratio_range"]
            figures = f"{row['ours_us']:9} {row['bare_us']:9}  {row['ratio']:.2f} ({low:.2f} to {high:.2f})"
            print(f"{shape:6} {row['nodes']:6} {figures}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
