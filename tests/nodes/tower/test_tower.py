"""The deployment: a tower is built by what the camera sees, and `launch` does what `run` does, also amid kills."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from support.launched import Launched, hierax, run_here

from hierax.nodes.tower.world import TowerWorld
from hierax.runtime.core.errors import HieraxError

SMALL = ["tower", "--set", "cubes=2", "--set", "tower=[1, 2]"]
EPOCHS = 60
NODES = ("world", "arm", "spatial", "skills", "builder")


def test_a_tower_is_built() -> None:
    report = run_here(*SMALL, "--set", "frames=600")
    metrics = report["nodes"]["world"]["metrics"]
    assert metrics["towers_done"] == 1.0, report
    assert 0.0 <= metrics["placed_mm_max"] < 8.0
    assert metrics["actions"] == 1.0
    assert report["nodes"]["builder"]["metrics"]["done"] == 1.0


def test_what_stands_already_is_done_without_a_move() -> None:
    """In odd scenes the second cube stands on the first."""
    report = run_here(*SMALL, "--set", "scene=1", "--set", "frames=60")
    assert report["nodes"]["world"]["metrics"]["towers_done"] == 1.0
    assert report["epochs"] < 60
    assert report["nodes"]["skills"]["metrics"]["moves"] == 0.0


def test_launch_with_a_kill_of_each_node_gives_the_digest_of_run(tmp_path: Path) -> None:
    wanted = run_here(*SMALL, "--epochs", str(EPOCHS))["digest"]
    with Launched(tmp_path, *SMALL, "--epochs", str(EPOCHS)) as launch:
        for count, name in enumerate(NODES, start=1):
            launch.until_epoch(8 * count)
            os.kill(launch.until_pid(name), signal.SIGKILL)
        assert launch.report()["digest"] == wanted


@pytest.mark.parametrize(("tower", "why"), [("[1, 9]", "there is no cube 9"), ("[1, 1]", "asked for twice")])
def test_a_tower_that_cannot_be_built_is_refused_before_it_begins(tower: str, why: str) -> None:
    with pytest.raises(RuntimeError, match=why):
        hierax("validate", "tower", "--set", f"tower={tower}")


def test_the_world_counts_what_the_hand_has_raised() -> None:
    world = TowerWorld([2, 1], cubes=2)
    belief = world.initial_belief()
    nothing = {"towers_done": 0.0, "placed_mm_max": -1.0, "actions": 0.0, "interferences": 0.0}
    assert world.metrics(belief) == nothing
    assert not world.finished(belief)
    with pytest.raises((ValueError, HieraxError)):
        TowerWorld([3], cubes=2)
