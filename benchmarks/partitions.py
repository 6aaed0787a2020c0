"""Random hierarchies in random processes, of which one is killed: the digests of `run`, one loss, one restart.

    python benchmarks/partitions.py
    python benchmarks/partitions.py --count 50 --seed 7000
    python benchmarks/partitions.py --rates        # nodes take part now and then, edges have delays, some gather

Hierarchies have 2 to 12 nodes whose every result depends on every input, and are launched in one process, two, three,
or as many as nodes, drawn node by node. One process of each is killed (SIGKILL), with all its nodes: a fifth of them as
soon as it is there, before or while the run begins, a tenth with the last epoch, the others within 4 ms of an epoch.
Exit code 1 where a digest is another one than that of `run`, where more than one process was started again, a node did
not report, or twice as many launches have not come to so many kills.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.partitions import outcome_of  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500, help="of kills; a launch that is over before is another one")
    parser.add_argument("--seed", type=int, default=0, help="the first one; each launch has the next")
    parser.add_argument("--rates", action="store_true", help="of nodes, delays of edges")
    options = parser.parse_args()
    faults: list[str] = []
    counts: Counter[str] = Counter()
    begun = time.monotonic()
    for seed in itertools.count(options.seed):
        if counts["kills"] == options.count or counts["launches"] == 2 * options.count:
            break
        outcome = outcome_of(seed, rated=options.rates)
        counts["launches"] += 1
        counts["nodes"] += outcome.nodes
        counts["kills"] += bool(outcome.killed)
        counts["nodes killed"] += len(outcome.killed)
        counts["restarts"] += outcome.restarts
        counts["with the world's process"] += "world" in outcome.killed
        if outcome.fault:
            faults.append(f"seed {seed}: {outcome.fault}")
            print(faults[-1], flush=True)
        if counts["launches"] % 25 == 0:
            print(f"{counts['launches']} in {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    if counts["kills"] < options.count:
        faults.append(f"{counts['kills']} kills in {counts['launches']} launches")
    print(", ".join(f"{what} {number}" for what, number in counts.items()))
    print("all digests are those of `run`" if not faults else f"{len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
