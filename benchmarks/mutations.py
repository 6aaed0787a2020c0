"""Looks for the first seed that notices each planted mistake, and writes it into docs/simulation.md.

    python benchmarks/mutations.py [--seeds N] [NAME …]

Without names, all. Exits with 1 where one is not noticed.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "simulation.md"
sys.path.append(str(PROJECT / "tests"))

from support.mutations import MUTATIONS, scenario_of  # noqa: E402

from hierax.runtime.sim.campaign import simulate_quietly  # noqa: E402


def first_seed(seeds: int, name: str) -> tuple[str, int | None, str]:
    """The first seed that notices a mistake, and what it says."""
    with MUTATIONS[name]():
        for seed in range(seeds):
            violation = simulate_quietly(scenario_of(name, seed)).violation
            if violation:
                return name, seed, violation
    return name, None, ""


def main() -> int:
    """Look for all that are asked for, over all cores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5000)
    parser.add_argument("names", nargs="*", default=list(MUTATIONS))
    arguments = parser.parse_args()
    missed = 0
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for name, seed, violation in pool.map(partial(first_seed, arguments.seeds), arguments.names):
            print(f"{'none' if seed is None else seed:>6}  {name}: {violation[:80]}", flush=True)
            missed += seed is None
            if seed is not None:
                lines = PAGE.read_text(encoding="utf-8").splitlines()
                told = [
                    f"{line.rpartition(f'{name} |')[0]}{name} | {seed} |" if f"| {name} |" in line else line
                    for line in lines
                ]
                PAGE.write_text("\n".join(told) + "\n", encoding="utf-8")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
