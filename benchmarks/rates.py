"""What rates, budgets and delays come to.

    python benchmarks/rates.py                    # all parts
    python benchmarks/rates.py servo --seeds 20
    python benchmarks/rates.py tracking --rounds 5
    python benchmarks/rates.py late --seconds 60 --late skip

servo     the error of `servo-rates` over the ratio of rates and the delay: where the node above says a course, or one
          position, or nothing.
tracking  epochs per second and errors of `tracking` over Zenoh with a spatial node that takes part in some epochs, or
          whose predictions count later, beside the barrier and a staleness (`staleness.py` has more of those).
late      a world at 100 Hz for a minute, and a node that takes 30 ms in every fiftieth epoch: what is late, after whom,
          and whether the last epoch begins where the rate has it.

Exits with 1 where late epochs are not put down to that node, the last one begins 2 ms beside its time, or the digests
of launches that have to be alike are not.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import staleness
from commands import HIERAX

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run

TESTS = Path(__file__).parents[1] / "tests"
RATE_HZ, EVERY, TOOK_MS, NEAR_MS = 100, 50, 30.0, 2.0
DEPLOYMENT = f"""
hierarchy: paced
world: world
nodes:
  world: {{class: "support.rate_nodes:Ticks", rate_hz: {RATE_HZ}}}
  slow: {{class: "support.rate_nodes:Sometimes", parameters: {{every: {EVERY}, took_ms: {TOOK_MS}}}}}
  quick: {{class: "support.rate_nodes:Counts"}}
edges:
  world -> slow: {{sense: "support.rate_nodes:seen"}}
  world -> quick: {{sense: "support.rate_nodes:seen"}}
"""
STEP_S = 0.005
RATIOS = (1, 2, 5, 10, 20, 40)


def late(options: argparse.Namespace) -> int:
    """Launch it, and print what it tells."""
    epochs = int(options.seconds * RATE_HZ) + 21  # the last ones follow no slow one
    epochs += 25 - epochs % EVERY
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "paced.yaml"
        file.write_text(DEPLOYMENT, encoding="utf-8")
        command = [*HIERAX, "launch", str(file), "--format", "json"]
        command += ["--epochs", str(epochs), "--set", f"late={options.late}"]
        environment = {**os.environ, "PYTHONPATH": str(TESTS)}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    report = json.loads(done.stdout)
    rate, slow = report["timing"]["rate"], report["timing"]["budgets"]["slow"]
    last_ms = rate["last_ms"]
    print(f"{epochs} epochs in {report['wall_s']:.3f} s; the last one began {last_ms:+.2f} ms beside its time")
    print(f"lateness p50 {rate['p50_ms']:.2f} ms, p99 {rate['p99_ms']:.2f} ms, max {rate['max_ms']:.2f} ms")
    print(f"{rate['late']} begun late, after {rate['after']}; {rate['skipped']} times skipped")
    print(f"slow took longer than {slow['budget_ms']:g} ms in {slow['over']} epochs, at most {slow['max_ms']:.1f} ms")
    named = rate["after"].get("slow", 0) >= slow["over"] > 0
    return 0 if named and abs(last_ms) <= NEAR_MS else 1


def servo(options: argparse.Namespace) -> int:
    """The camera at 200 Hz, the node above at 200 / `every`; the median of the seeds' mean errors."""
    print(f"{'every':>5} {'Hz':>6} {'delay':>5} {'late by, ms':>11}   {'course, m':>9} {'position, m':>11}")
    for every in RATIOS:
        for delay in sorted({0, every // 2, every}):
            course, position = (
                error_m(options.seeds, every, delay, horizon) for horizon in ((every + delay) * STEP_S, STEP_S)
            )
            row = f"{every:5} {1 / (every * STEP_S):6g} {delay:5} {1000 * delay * STEP_S:11g}"
            print(f"{row}   {course:9.3f} {position:11.3f}")
    print(f"without context {error_m(options.seeds, 1, 0, STEP_S, 'context=false'):.3f}")
    return 0


def error_m(seeds: int, every: int, delay: int, horizon_s: float, *further: str) -> float:
    """The median of the mean tracking errors."""
    changes = [f"every={every}", f"offset={int(every > 1)}", f"turn={every * STEP_S}", f"delay={delay}"]
    deployment = read_deployment("servo-rates", [*changes, f"horizon={horizon_s}", *further])
    reports = [run(deployment, epochs=None, seed=seed) for seed in range(seeds)]
    return statistics.median(report.nodes["world"].metrics["tracking_error_mean"] for report in reports)


def tracking(options: argparse.Namespace) -> int:
    """Launches in turn."""
    ways = [staleness.BARRIER, "1", *staleness.RATED]
    return staleness.main([*ways, "--rounds", str(options.rounds)])


PARTS: Mapping[str, Callable[[argparse.Namespace], int]] = {"servo": servo, "tracking": tracking, "late": late}


def main() -> int:
    """Do the parts one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; by default all")
    parser.add_argument("--seeds", type=int, default=20, help="of servo, in each row")
    parser.add_argument("--rounds", type=int, default=3, help="of tracking, how often each way is launched")
    parser.add_argument("--seconds", type=float, default=60.0, help="of late")
    parser.add_argument("--late", choices=["catch_up", "skip"], default="catch_up", help="likewise")
    options = parser.parse_args()
    unknown = sorted(set(options.parts) - PARTS.keys())
    if unknown:
        parser.error(f"there is no part {unknown[0]!r}; expected one of {', '.join(PARTS)}")
    return max([PARTS[part](options) for part in options.parts or PARTS])


if __name__ == "__main__":
    sys.exit(main())
