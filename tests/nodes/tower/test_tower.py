"""The deployment: a tower is built by what the camera sees, and `launch` does what `run` does, also amid kills."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.launched import HIERAX, Launched, environment, run_here
from support.launched import hierax as called

import hierax
from hierax.nodes.picking.panda import HOME_GRIPPER
from hierax.nodes.tower.world import TowerWorld
from hierax.nodes.tracking.math.geometry import make_pose
from hierax.runtime.core.errors import HieraxError

SMALL = ["tower", "--set", "cubes=2", "--set", "tower=[1, 2]"]
EPOCHS, EACH = 150, 26  # the last two kills come while the cube is lifted, and carried
MOVED_SEED = 3  # somebody moves a cube while the hand is on its way to it, and is done within these epochs
NODES = ("world", "arm", "spatial", "skills", "builder")
PLANNER = """nodes:
  builder: {class: "hierax.nodes.tower.builder:builder", parameters: {builder: planner, tower: [1, 2], cubes: 2}}
"""


def test_a_tower_is_built() -> None:
    report = run_here(*SMALL, "--set", "frames=600")
    metrics = report["nodes"]["world"]["metrics"]
    assert metrics["towers_done"] == 1.0, report
    assert 0.0 <= metrics["placed_mm_max"] < 8.0
    assert metrics["actions"] == 1.0
    assert report["nodes"]["builder"]["metrics"]["done"] == 1.0


@pytest.mark.parametrize("builder", ["reactive", "planner", "open_loop"])
def test_what_stands_already_is_done_without_a_move(builder: str) -> None:
    """In odd scenes the second cube stands on the first."""
    if builder != "reactive":
        pytest.importorskip("clingo", reason="the extra [plan] is not installed")
    report = run_here(*SMALL, "--set", "scene=1", "--set", "frames=60", "--set", f"builder={builder}")
    assert report["nodes"]["world"]["metrics"]["towers_done"] == 1.0
    assert report["epochs"] < 60
    assert report["nodes"]["skills"]["metrics"]["moves"] == 0.0


def test_launch_with_a_kill_of_each_node_gives_the_digest_of_run(tmp_path: Path) -> None:
    wanted = run_here(*SMALL, "--epochs", str(EPOCHS))["digest"]
    with Launched(tmp_path, *SMALL, "--epochs", str(EPOCHS)) as launch:
        for count, name in enumerate(NODES, start=1):
            launch.until_epoch(EACH * count)
            os.kill(launch.until_pid(name), signal.SIGKILL)
        assert launch.report()["digest"] == wanted


def test_a_launch_has_the_digest_of_run_while_somebody_interferes(tmp_path: Path) -> None:
    """The arm's process is killed while somebody's hand comes, and the world's while that holds a cube."""
    settings = ["cubes=2", "tower=[1, 2]", "person=move"]
    with hierax.run("tower", seed=MOVED_SEED, settings=settings, epochs=EPOCHS) as run:
        held = [epoch.number for epoch in run if run.belief("world")["person"]["holds"] is not None]
        wanted = run.report()
    assert wanted.nodes["world"].metrics["interferences"] == 1.0
    words = [word for each in settings for word in ("--set", each)]
    with Launched(tmp_path, "tower", "--seed", str(MOVED_SEED), *words, "--epochs", str(EPOCHS)) as launch:
        for epoch, name in ((held[0] - 10, "arm"), (held[len(held) // 2], "world")):
            launch.until_epoch(epoch)
            os.kill(launch.until_pid(name), signal.SIGKILL)
        report = launch.report()
    assert report["digest"] == wanted.digest
    assert report["nodes"]["world"]["metrics"]["interferences"] == 1.0


@pytest.mark.parametrize(("tower", "why"), [("[1, 9]", "there is no cube 9"), ("[1, 1]", "asked for twice")])
def test_a_tower_that_cannot_be_built_is_refused_before_it_begins(tower: str, why: str) -> None:
    with pytest.raises(RuntimeError, match=why):
        called("validate", "tower", "--set", f"tower={tower}")


@pytest.mark.parametrize(
    ("setting", "why"),
    [
        ("noise=x", "nodes.world.parameters.noise: expected a number, got 'x'"),
        ("cubes=0", "nodes.world.parameters.cubes: cubes is 0; expected a number from 1 to 6"),
        ("nodes.world.parameters.foo=1", "has no such parameter"),
        ("nodes.skills.parameters.builder=foo", "builder is 'foo'; expected one of reactive, planner, open_loop"),
    ],
)
def test_what_is_set_wrongly_is_told(setting: str, why: str) -> None:
    with pytest.raises(RuntimeError, match=re.escape(why)):
        called("validate", "tower", "--set", setting)


def test_while_a_tower_grows_another_builder_takes_over(tmp_path: Path) -> None:
    pytest.importorskip("clingo", reason="the extra [plan] is not installed")
    planner = tmp_path / "planner.yaml"
    planner.write_text(PLANNER)
    with Launched(tmp_path, *SMALL, "--set", "frames=600") as launch:
        launch.until_epoch(40)
        words = [*HIERAX, "replace", "builder", str(planner), "--format", "json"]
        done = subprocess.run(words, capture_output=True, text=True, env=environment(tmp_path), check=True)
        launched = launch.report()
    assert launched["nodes"]["world"]["metrics"]["towers_done"] == 1.0
    at = f"{json.loads(done.stdout)['epoch']}:replace:builder:{planner}"
    assert called("run", *SMALL, "--set", "frames=600", "--at", at)["digest"] == launched["digest"]


def test_the_world_counts_what_the_hand_has_raised() -> None:
    """A cube that is in the air between the fingers has been raised, once; one that nobody holds there was not."""
    world = TowerWorld([2, 1], cubes=2)
    belief = world.initial_belief()
    assert world.metrics(belief) == {"towers_done": 0.0, "placed_mm_max": -1.0, "actions": 0.0, "interferences": 0.0}
    assert not world.finished(belief)
    for place, actions in ((HOME_GRIPPER[:3, 3], 1), (HOME_GRIPPER[:3, 3] + [0.2, 0.0, 0.0], 0)):
        bodies = tuple(
            {**body, "pose": make_pose(np.eye(3), place)} if body["id"] == 1 else body for body in belief["bodies"]
        )
        after = world.predict((), (), {**belief, "bodies": bodies})
        assert (after["actions"], after["raised"]) == (actions, (1,) * actions)
        again = world.predict((), (), {**after, "bodies": bodies})
        assert again["actions"] == actions


def test_a_cube_that_is_not_there_is_refused() -> None:
    with pytest.raises((ValueError, HieraxError), match="there is no cube 3"):
        TowerWorld([3], cubes=2)
