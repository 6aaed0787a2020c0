"""A part of `kills.py`: processes killed at random in launches whose nodes have rates and delays.

Whichever it is, also while another one is coming back: the digests are those of the undisturbed run, and so is what
every node believes at the end.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
from hashlib import sha256
from pathlib import Path

from links import OPTIONS, ROOT
from support.launched import Launched, hierax
from support.mixing_nodes import written

PER_LAUNCH = 10
CELLS = {
    "servo": (
        (ROOT / "deploy" / "servo.yaml", 1500),
        ("world", "camera", "motion"),
        ("nodes.world.rate_hz=200", "nodes.motion.every=5", "nodes.motion.offset=2", "edges.camera -> motion.delay=5"),
    ),
    "mixing": (
        (None, 1500),
        ("world", "quick", "middle", "slow", "side"),
        ("nodes.world.rate_hz=200",),
    ),
    "causal-tree": (
        (ROOT / "deploy" / "causal-tree.yaml", 1000),
        ("world", "trunk", "branch2", "branch4", "branch7"),
        (
            "nodes.world.rate_hz=100",
            "nodes.trunk.every=3",
            "edges.branch2 -> trunk.delay=4",
            "edges.world -> branch4.delay=1",
        ),
    ),
    "tracking": (
        (ROOT / "deploy" / "tracking.yaml", 60),
        ("world", "arm", "spatial"),
        ("nodes.spatial.every=2", "edges.arm -> spatial.delay=2"),
    ),
}


def kill_with_rates(options: argparse.Namespace) -> list[str]:
    """As many kills in each of the deployments."""
    rng = random.Random(options.seed)
    faults: list[str] = []
    for name, ((path, epochs), nodes, rates) in CELLS.items():
        kills, wanted_kills = 0, options.rated // len(CELLS)
        with tempfile.TemporaryDirectory() as place:
            words = [str(path or written(Path(place))), "--epochs", str(epochs)]
            words += [part for option in (*rates, *OPTIONS) for part in ("--set", option)]
            wanted = _said(hierax("run", *words))
            while kills < wanted_kills:
                with tempfile.TemporaryDirectory() as folder:
                    launch = Launched(Path(folder), *words)
                    launch.until_epoch(2)
                    kills += _kill(launch, nodes, rng, min(PER_LAUNCH, wanted_kills - kills), epochs)
                    said = _said(json.loads(launch.end(300.0) or "{}"))
                    if said != wanted:
                        what = f"exit code {launch.process.returncode}, {said}, not {wanted}"
                        faults.append(f"rates, {name}, seed {options.seed}: {what}\n{launch.err}")
        print(f"{name:12} {kills} kills at random in {', '.join(nodes)}", flush=True)
    return faults


def _said(report: dict[str, object]) -> str:
    """What has to be the same: the digest, and what every node believes at the end."""
    nodes = report.get("nodes", {})
    assert isinstance(nodes, dict)
    beliefs = json.dumps({name: each["belief"] for name, each in sorted(nodes.items())})
    return f"digest {report.get('digest')!s:.16}, beliefs {sha256(beliefs.encode()).hexdigest():.16}"


def _kill(launch: Launched, nodes: tuple[str, ...], rng: random.Random, most: int, epochs: int) -> int:
    """How many were killed."""
    kills = 0
    while kills < most and launch.running and launch.epoch < epochs * 0.9:
        launch.kill(rng.choice(nodes))
        kills += 1
        if rng.random() < 0.7:
            epoch = launch.epoch
            launch.until_epoch(epoch + 1)
            time.sleep(rng.random() * 0.3)
    return kills
