"""Objects of which no first pose is told: found, alike in one process and in many, and said to be gone."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.benchmarks.first_poses import changes
from hierax.nodes.tracking.datasets.bop import BopScene, read_results
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.probes import POSES_FILE, TRUTH_FILE
from hierax.nodes.tracking.evaluation.scoring import object_errors
from hierax.nodes.tracking.generator import kinds
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.nodes.tracking.math.geometry import transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.simworld.world import SCENE
from hierax.nodes.tracking.world import arm, spatial
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run
from hierax.runtime.launch.supervisor import launch

EPOCHS = 12
CUBES = ["start=search", "cubes=2", f"frames={EPOCHS}"]


@pytest.mark.slow
def test_cubes_of_which_nothing_is_told_are_found_alike_in_one_process_and_in_many(tmp_path: Path) -> None:
    report = run(read_deployment("tracking", CUBES), epochs=EPOCHS, seed=0, output=tmp_path)
    true = {each.obj_id: each.pose for each in read_results(tmp_path / TRUTH_FILE) if each.im_id == EPOCHS - 1}
    found = {each.obj_id: each.pose for each in read_results(tmp_path / POSES_FILE) if each.im_id == EPOCHS - 1}
    assert set(found) == set(true) == {1, 2}
    for number, pose in found.items():
        corners = [transform(each, box_mesh([SCENE[number - 1].side_m] * 3).vertices) for each in (pose, true[number])]
        assert np.linalg.norm(corners[0][:, None] - corners[1][None], axis=-1).min(axis=1).max() < 0.005
    assert launch(read_deployment("tracking", CUBES), epochs=EPOCHS, seed=0).digest == report.digest


def test_in_a_folder_first_poses_are_not_read_and_one_that_is_null_is_looked_for(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, "scattered", 1, 1, False, 2)
    given = [item["status"] for item in arm(str(scene)).initial_belief()["objects"]]
    sought = [item["status"] for item in arm(str(scene), start="search").initial_belief()["objects"]]
    assert (given, sought) == (["expected", "expected"], ["lost", "lost"])
    path = scene / "scene_gt.json"
    entries = json.loads(path.read_text())
    entries["0"][1] = {"obj_id": 2, "pose": None}
    path.write_text(json.dumps(entries))
    assert [item.pose is None for item in BopScene(scene).first_objects()] == [False, True]
    assert [item["status"] for item in arm(str(scene)).initial_belief()["objects"]] == ["expected", "lost"]
    assert [body["status"] for body in spatial(str(scene), table=True).initial_belief()["bodies"]] == [
        "expected",
        "lost",
    ]
    with pytest.raises(ValueError, match=re.escape("expected table=true")):
        spatial(str(scene))
    for body in entries["0"]:
        body.clear()
        body["obj_id"] = 1
    path.write_text(json.dumps(entries))
    assert [item.pose for item in BopScene(scene).first_objects(poses=False)] == [None, None]


@pytest.mark.parametrize("options", [{"start": "somewhere"}, {"start": "search", "method": "paper"}])
def test_what_start_cannot_be_is_told(options: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="start is"):
        arm(**options)


@pytest.mark.slow
def test_what_is_taken_out_is_said_to_be_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinds, "_TAKEN_FROM", 8)
    scene = write_scene(tmp_path, "taken", 0, 24, False, 1)
    poses = tmp_path / "poses.csv"
    settings = [f"scene={scene}", "table=true", "start=search", f"output={poses}"]
    run(read_deployment("tracking", settings), epochs=None, seed=0)
    (errors,) = object_errors(read_results(poses), read_truth(tmp_path / "truth" / "000001"))
    assert (errors.visible == 0.0).tolist() == [frame >= 8 for frame in range(24)]
    assert errors.within((5.0, 5.0))[7]
    assert np.isnan(errors.distance_mm[8 + 15 :]).all()
    assert changes(errors, False) == [pytest.approx(3, abs=2)]
    assert changes(errors, True) == []
