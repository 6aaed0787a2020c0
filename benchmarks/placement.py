"""What an epoch costs by how a hierarchy is cut into processes, beside `run` and plain Zenoh.

    python benchmarks/placement.py
    python benchmarks/placement.py --shapes chain:8 --rounds 5 --epochs 300

A chain of 8, a star of 32 around the world, and a tree of 63, of nodes that do next to nothing, each launched in one
process, two, four, and one for each node (`--processes`); beside them `run`, and the rival of `growth_launch.py`, a
process for each node in plain Zenoh. All take turns, so that a machine that changes its pace changes it for all.
Launches are closed, as they are by themselves; those of a process for each node also open, and encrypted. Figures are
medians of rounds, of the epochs' p50 and p99 after a warm-up; ratios are of a round. Some sixty processes on few cores
that others use may not come to their epochs at all: `--most 33` leaves out what has more. Exit code 1 where a closed
launch takes more than 1.1 times what an open one takes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from closed import CLOSED_COSTS
from growth import hierarchy
from growth_launch import TIMEOUT_S, WARM_UP, bare

from hierax.runtime.deployment.partition import cut
from hierax.runtime.execution.single import run
from hierax.runtime.launch.supervisor import launch

SHAPES = ("chain:8", "star:33", "tree:63")
CUTS = (1, 2, 4)
SINGLE, BARE = "`run`", "plain Zenoh"
OWN, OPEN, ENCRYPTED = "each its own process", "likewise, open", "likewise, encrypted"

Times = Sequence[float]
Ways = dict[str, Callable[[], Times]]


def ways(shape: str, size: int, epochs: int, most: int) -> Ways:
    """How the epochs of a hierarchy can be had, by name, with so many processes; each gives their times in µs."""
    deployment = hierarchy(shape, size, start_timeout_s=TIMEOUT_S).deployment()

    def launched(processes: int, host: str | None = None, **more: bool) -> Times:
        placed = replace(deployment, processes=cut(deployment.roster, processes), **more)
        report = launch(placed, epochs=epochs, seed=0, host=host, broken=threading.Event())
        return [1e6 * each for each in report.epochs_s]

    def single() -> Times:
        return [1e6 * each for each in run(deployment, epochs=epochs, seed=0).epochs_s]

    counts = [count for count in (*(each for each in CUTS if each < size), size) if count <= most]
    found: Ways = {SINGLE: single}
    found |= {_name(count, size): lambda count=count: launched(count) for count in counts}  # type: ignore[misc]
    if size > most:
        return found
    found |= {OPEN: lambda: launched(size, open=True), ENCRYPTED: lambda: launched(size, "127.0.0.1")}
    return found | {BARE: lambda: bare(shape, size, epochs)}


def _name(count: int, size: int) -> str:
    return OWN if count == size else "one process" if count == 1 else f"{count} processes"


def rows(taken: dict[str, list[Times]]) -> list[dict[str, Any]]:
    """What the rounds of each way come to, with ratios to the launch of a process for each node, and to the rival."""
    others = [name for name in taken if name in (OWN, OPEN, BARE, SINGLE)]
    medians = {name: [float(np.median(times)) for times in rounds] for name, rounds in taken.items()}
    found = []
    for name, rounds in taken.items():
        row: dict[str, Any] = {
            "way": name,
            "p50_us": statistics.median(medians[name]),
            "p99_us": statistics.median(float(np.percentile(times, 99)) for times in rounds),
        }
        for other in others:
            ratios = [one / two for one, two in zip(medians[name], medians[other], strict=True)]
            row[other] = (statistics.median(ratios), min(ratios), max(ratios))
        found.append(row)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", default=SHAPES, help="chain, star or tree, and how many nodes")
    parser.add_argument("--epochs", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--most", type=int, default=1000, help="processes of a launch, or of the rival")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    dear = False
    for each in options.shapes:
        shape, _, size = each.partition(":")
        taken: dict[str, list[Times]] = {}
        for number in range(options.rounds):
            for name, way in ways(shape, int(size), options.epochs, options.most).items():
                print(f"{shape} of {size}, round {number + 1} of {options.rounds}: {name}", file=sys.stderr, flush=True)
                taken.setdefault(name, []).append(way()[int(WARM_UP * options.epochs) :])
        table = rows(taken)
        dear |= any(row[OPEN][0] > CLOSED_COSTS for row in table if row["way"] == OWN and OPEN in row)
        if options.json:
            print(json.dumps({"shape": shape, "nodes": int(size), "rows": table}), flush=True)
            continue
        print(f"\n{shape} of {size}: p50, p99 in µs; times {', '.join(list(table[0])[3:])} (least, most)")
        for row in table:
            ratios = [f"{ratio:6.2f} ({low:.2f}, {high:.2f})" for ratio, low, high in list(row.values())[3:]]
            print(f"  {row['way']:22} {row['p50_us']:8.0f} {row['p99_us']:8.0f}  {'  '.join(ratios)}", flush=True)
    return int(dear)


if __name__ == "__main__":
    sys.exit(main())
