"""A tower that grows while its nodes are killed, and while another builder takes over: digests, and whether it is done.

    python benchmarks/tower_changes.py                     # scenes 0 to 2; some ten minutes
    python benchmarks/tower_changes.py --scenes 3:4 --person knock

Each scene is run once in one process, and launched twice. In one launch every node's process is killed (SIGKILL), one
after the other, spread over the whole run; its digest has to be that of the run. In the other one the planner takes
the place of the rules after a third of the epochs, which is repeated by `hierax run --at`, whose digest has to be
the same. In either the tower has to stand at the end. Exit code 1 where something was not so.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tower_scenes import DEFAULTS, scenes_of, settings, words

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.launched import HIERAX, Launched, environment, hierax  # noqa: E402

NODES = ("world", "arm", "spatial", "skills", "builder")
LONG_S = 1200.0
PLANNER = f"""nodes:
  builder:
    class: hierax.nodes.tower.builder:builder
    parameters: {{builder: planner, tower: {DEFAULTS["tower"]}, cubes: {DEFAULTS["cubes"]}}}
"""


def main() -> int:
    """Go through the scenes, print a row of each launch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:3", help="from one to below another one")
    parser.add_argument("--person", default="none", help="what somebody does")
    options = parser.parse_args()
    print(f"{'scene':>5} {'launch':9} {'epochs':>6} {'done':>5} {'digest':>7}", flush=True)
    right = True
    for scene in scenes_of(options.scenes, parser):
        arguments = words(settings({"person": options.person}, scene))
        alone = hierax("run", *arguments)
        right &= told(scene, "killed", killed(arguments, alone["epochs"]), alone)
        launched, again = replaced(arguments, alone["epochs"] // 3)
        right &= told(scene, "replaced", launched, again)
    return int(not right)


def told(scene: int, what: str, launched: dict[str, Any], run: dict[str, Any]) -> bool:
    """Print a row; whether all is as it has to be."""
    done = launched["nodes"]["world"]["metrics"]["towers_done"] == 1.0
    equal = launched["digest"] == run["digest"]
    row = f"{scene:5} {what:9} {launched['epochs']:6} {'yes' if done else 'NO':>5} {'equal' if equal else 'OTHER':>7}"
    print(row, flush=True)
    return bool(done and equal)


def killed(arguments: list[str], epochs: int) -> dict[str, Any]:
    """The report of a launch in which every node's process is killed once."""
    with tempfile.TemporaryDirectory() as folder, Launched(Path(folder), *arguments) as launch:
        for count, name in enumerate(NODES, start=1):
            launch.until_epoch(count * epochs // (len(NODES) + 1), LONG_S)
            os.kill(launch.until_pid(name), signal.SIGKILL)
        return launch.report(LONG_S)


def replaced(arguments: list[str], epoch: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """The reports of a launch in which the planner takes over, and of the run that repeats it."""
    with tempfile.TemporaryDirectory() as folder:
        planner = Path(folder) / "planner.yaml"
        planner.write_text(PLANNER)
        with Launched(Path(folder), *arguments) as launch:
            launch.until_epoch(epoch, LONG_S)
            command = [*HIERAX, "replace", "builder", str(planner), "--format", "json"]
            there = environment(Path(folder))
            done = subprocess.run(command, capture_output=True, text=True, env=there, check=True)
            launched = launch.report(LONG_S)
        at = f"{json.loads(done.stdout)['epoch']}:replace:builder:{planner}"
        return launched, hierax("run", *arguments, "--at", at)


if __name__ == "__main__":
    sys.exit(main())
