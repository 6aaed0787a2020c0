"""What an epoch costs a node as hierarchies grow: `run`, from 9 to 10 000 nodes.

    python benchmarks/growth.py
    python benchmarks/growth.py --sizes 9 1000 --rounds 3 --format json

Chains, stars, trees and random graphs of nodes that do next to nothing. Each hierarchy has a process of its own, which
reads it as a deployment file is read, builds it, and does some epochs whenever it is told to. They take turns, so that
a machine that changes its pace changes it for all; ratios are against the chain of 9 nodes in the same round, and of
those the median is told. The start is told per node, too: checks, hashes, nodes and wiring, up to the first epoch.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection
from random import Random
from typing import Any, NamedTuple

from commands import at_least

from hierax.nodes.chain import Counter, Relay, count, level
from hierax.runtime.execution.single import SingleRun
from hierax.runtime.scripting.hierarchy import Hierarchy

SIZES = (9, 30, 100, 1000, 10_000)
BASE = ("chain", 9)  # what others are compared with
NODE_EPOCHS = 5000  # of how many nodes an epoch is timed in a turn, about
FANOUT = 3  # of a tree
SECOND = 0.25  # the share of nodes of a random graph that sense two others


def chain(size: int) -> Iterator[tuple[int, int]]:
    """Each node senses the one before."""
    return ((index - 1, index) for index in range(1, size))


def star(size: int) -> Iterator[tuple[int, int]]:
    """All sense the world."""
    return ((0, index) for index in range(1, size))


def tree(size: int) -> Iterator[tuple[int, int]]:
    """Each is sensed by `FANOUT` others."""
    return (((index - 1) // FANOUT, index) for index in range(1, size))


def graph(size: int) -> Iterator[tuple[int, int]]:
    """Each senses one that is drawn, and some another one, too."""
    random = Random(size)
    for index in range(1, size):
        count = 2 if index > 1 and random.random() < SECOND else 1
        yield from ((lower, index) for lower in sorted(random.sample(range(index), count)))


SHAPES: Mapping[str, Callable[[int], Iterator[tuple[int, int]]]] = {
    "chain": chain,
    "star": star,
    "tree": tree,
    "graph": graph,
}


class Turn(NamedTuple):
    """What one hierarchy took in one turn, in µs a node."""

    start_us: float
    epoch_us: float


def hierarchy(shape: str, size: int, **fields: Any) -> Hierarchy:
    """A hierarchy of this shape; its world is n0, and the fields are those at the top of a deployment file."""
    made = Hierarchy(shape, **fields).add("n0", Counter)
    for index in range(1, size):
        made.add(f"n{index}", Relay)
    for lower, upper in SHAPES[shape](size):
        made.join(f"n{lower}", f"n{upper}", sense=level if lower else count, context=level)
    return made


def serve(shape: str, size: int, asked: Connection) -> None:
    """Do some epochs whenever asked, and tell what a node and epoch took."""
    described = hierarchy(shape, size)
    begun_s = time.process_time()
    run = SingleRun(described.deployment(), epochs=None, seed=0)
    epochs = run.epochs()
    next(epochs)
    start_us = 1e6 * (time.process_time() - begun_s) / size
    number = max(NODE_EPOCHS // size, 2)
    while asked.recv():
        begun_s = time.process_time()
        for _ in range(number):
            next(epochs)
        asked.send(Turn(start_us, 1e6 * (time.process_time() - begun_s) / (number * size)))


def measure(shapes: Sequence[str], sizes: Sequence[int], rounds: int) -> dict[tuple[str, int], list[Turn]]:
    """All hierarchies in turn, that many times; a further time before, which does not count."""
    context = get_context("spawn")
    cases = dict.fromkeys([BASE, *((shape, size) for size in sizes for shape in shapes)])
    ends: dict[tuple[str, int], Connection] = {}
    for case in cases:
        ends[case], other = context.Pipe()
        context.Process(target=serve, args=(*case, other), daemon=True).start()
        other.close()  # where the process fails, nobody waits for it
    found: dict[tuple[str, int], list[Turn]] = {case: [] for case in cases}
    for number in range(rounds + 1):
        for case, end in ends.items():
            print(f"round {number} of {rounds}: {case[0]} of {case[1]}", file=sys.stderr)
            end.send(True)
            turn = end.recv()
            if number:
                found[case].append(turn)
    for end in ends.values():
        end.send(False)  # it is over
    return found


def rows(found: Mapping[tuple[str, int], Sequence[Turn]]) -> list[dict[str, Any]]:
    """A row for each hierarchy."""
    base = found[BASE]
    told = []
    for (shape, size), turns in found.items():
        ratios = [each.epoch_us / other.epoch_us for each, other in zip(turns, base, strict=True)]
        told.append(
            {
                "shape": shape,
                "nodes": size,
                "edges": sum(1 for _ in SHAPES[shape](size)),
                "epoch_us_a_node": round(statistics.median(each.epoch_us for each in turns), 1),
                "ratio": round(statistics.median(ratios), 2),
                "ratio_range": [round(min(ratios), 2), round(max(ratios), 2)],
                "start_us_a_node": round(turns[0].start_us),
            }
        )
    return told


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, default=list(SHAPES))
    parser.add_argument("--sizes", nargs="+", type=at_least(2), default=SIZES)
    parser.add_argument("--rounds", type=at_least(1), default=5)
    parser.add_argument("--format", choices=("text", "json"), default="text")
    options = parser.parse_args()
    told = rows(measure(options.shapes, options.sizes, options.rounds))
    if options.format == "json":
        print(json.dumps(told, indent=2))
        return 0
    print("shape   nodes  edges  µs a node and epoch   times chain of 9   start, µs a node")
    for row in told:
        low, high = row["ratio_range"]
        ratio = f"{row['ratio']:.2f} ({low:.2f} to {high:.2f})"
        print(
            f"{row['shape']:6} {row['nodes']:6} {row['edges']:6} {row['epoch_us_a_node']:21}   {ratio:19}"
            f"{row['start_us_a_node']:16}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
