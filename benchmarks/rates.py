"""A world at 100 Hz for a minute, and a node that takes 30 ms in every fiftieth epoch: what is late, after whom, and
whether the last epoch begins where the rate has it.

    python benchmarks/rates.py [--seconds 60] [--late catch_up|skip]

Exits with 1 where late epochs are not put down to that node, or the last one begins 2 ms beside its time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

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


def main() -> int:
    """Launch it, and print what it tells."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--late", choices=["catch_up", "skip"], default="catch_up")
    options = parser.parse_args()
    epochs = int(options.seconds * RATE_HZ) + 21  # the last ones follow no slow one
    epochs += 25 - epochs % EVERY
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "paced.yaml"
        file.write_text(DEPLOYMENT, encoding="utf-8")
        command = [sys.executable, "-m", "hierax.runtime.commands.entry", "launch", str(file), "--format", "json"]
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


if __name__ == "__main__":
    sys.exit(main())
