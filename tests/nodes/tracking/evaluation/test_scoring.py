"""Scores of poses against the truth, on made-up errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.datasets.bop import Result, ResultsFile
from hierax.nodes.tracking.datasets.truth import Likeness, TruePose
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors, main, object_errors, score, table
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose
from hierax.nodes.tracking.model.symmetry import NONE, about, symmetry_of


def course(
    distance_mm: list[float], angle_deg: float | list[float] = 0.0, visible: float | list[float] = 1.0, obj_id: int = 1
) -> ObjectErrors:
    distances = np.array(distance_mm, dtype=float)
    angles = np.where(np.isnan(distances), np.nan, np.broadcast_to(angle_deg, distances.shape))
    return ObjectErrors(
        obj_id, np.arange(len(distances)), distances, angles, np.array(np.broadcast_to(visible, distances.shape))
    )


def test_shares_need_both_distance_and_angle() -> None:
    found = score([course([1.0, 1.0, 4.0, 8.0, 30.0, np.nan], [1.0, 3.0, 1.0, 1.0, 1.0, 0.0])])
    assert found.shares == pytest.approx((1 / 6, 3 / 6, 4 / 6))
    assert (found.objects, found.frames) == (1, 6)
    assert (found.mean_mm, found.worst_mm) == pytest.approx((44.0 / 5, 30.0))
    assert (found.mean_deg, found.worst_deg) == pytest.approx((7.0 / 5, 3.0))
    assert found.missing == pytest.approx(1 / 6)
    assert found.astray == pytest.approx(1 / 6)


def test_a_displaced_model_is_judged_beside_its_displacement() -> None:
    rng = np.random.default_rng(5)
    true = [make_pose(exp_so3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(9)]
    off = make_pose(exp_so3(np.array([0.0, 0.05, 0.02])), np.array([0.004, -0.003, 0.001]))
    given = [pose @ off for pose in true]
    given[4] = true[4] @ make_pose(np.eye(3), np.array([0.03, 0.0, 0.0]))
    results = [Result(1, at, 1, 1.0, pose, 0.0) for at, pose in enumerate(given)]
    truth = {at: [TruePose(1, pose, 1.0)] for at, pose in enumerate(true)}
    (beside,) = object_errors(results, truth, displaced=True)
    assert np.delete(beside.distance_mm, 4).max() < 1e-6
    assert beside.distance_mm[4] == pytest.approx(np.linalg.norm([26.0, 3.0, 1.0]), rel=0.01)
    (exact,) = object_errors(results, truth)
    assert exact.distance_mm[0] == pytest.approx(np.sqrt(26.0))


def test_what_is_always_as_wrong_is_not_taken_for_a_displaced_model() -> None:
    off = make_pose(exp_so3(np.array([0.0, 1.5, 0.0])), np.array([0.08, 0.0, 0.0]))
    truth = {at: [TruePose(1, np.eye(4), 1.0)] for at in range(9)}
    (found,) = object_errors([Result(1, at, 1, 1.0, off, 0.0) for at in truth], truth, displaced=True)
    assert found.distance_mm == pytest.approx(np.full(9, 80.0))


def test_what_is_nearly_hidden_is_not_counted_and_bands_are_apart() -> None:
    visible = [1.0, 0.95, 0.6, 0.4, 0.2, 0.05, 0.0]
    found = score([course([1.0, 9.0, 1.0, 9.0, 1.0, 90.0, 90.0], visible=visible)])
    assert found.frames == 5
    assert found.worst_mm == 9.0
    assert (found.band(0.9, 1.0).frames, found.band(0.9, 1.0).shares[1]) == (2, 0.5)
    assert (found.hidden.frames, found.hidden.shares[1]) == (2, 0.5)
    assert found.band(0.3, 0.5).shares[1] == 0.0
    assert np.isnan(found.band(0.7, 0.9).shares[1])


def test_frames_until_an_object_is_right_again() -> None:
    visible = [1, 1, 0, 0, 1, 1, 1, 0, 1, 1, 0, 1, 1]
    distance = [1, 1, 99, 99, 50, 50, 1, 1, 1, 1, 1, 50, np.nan]
    assert score([course(distance, visible=visible)]).again_frames == (2, 0, None)
    assert score([course([1.0, 1.0])]).again_frames == ()
    assert score([course([50.0, 1.0], visible=[0.0, 1.0])]).again_frames == (0,)


def test_an_object_is_lost_that_is_wrong_to_its_end() -> None:
    right, wrong = course([1.0] * 20), course([1.0] * 10 + [50.0] * 10)
    late = course([50.0] * 19 + [9.0])
    gone = course([1.0] * 15 + [50.0] * 5, visible=[1.0] * 15 + [0.0] * 5)
    assert [score([each]).lost for each in (right, wrong, late, gone, course([np.nan] * 3))] == [0, 1, 0, 0, 1]
    assert score([right, wrong, wrong]).lost == 2


def test_no_frames_give_no_figures() -> None:
    empty = score([course([1.0], visible=0.0)])
    assert empty.frames == 0
    assert np.isnan(empty.shares[0])
    plain = json.loads(json.dumps(empty.plain(), allow_nan=False))
    assert plain["shares"]["within_5mm_5deg"] is None
    assert plain["mean_mm"] is None
    assert "–" in table({"none": empty})


def pose(x_mm: float, turn_deg: float = 0.0) -> Any:
    return make_pose(exp_so3(np.array([0.0, 0.0, np.radians(turn_deg)])), np.array([x_mm / 1000.0, 0.0, 0.5]))


def test_errors_are_between_poses_of_one_frame_and_object() -> None:
    truth = {3: [TruePose(7, pose(0.0), 0.5), TruePose(9, pose(50.0), 1.0)], 4: [TruePose(7, pose(10.0), 1.0)]}
    results = [Result(1, 3, 7, 1.0, pose(3.0, 2.0), -1.0), Result(1, 4, 9, 1.0, pose(0.0), -1.0)]
    seven, nine = object_errors(results, truth)
    assert (seven.obj_id, nine.obj_id) == (7, 9)
    assert seven.frames.tolist() == [3, 4]
    assert seven.distance_mm[0] == pytest.approx(3.0)
    assert seven.angle_deg[0] == pytest.approx(2.0)
    assert np.isnan(seven.distance_mm[1])
    assert np.isnan(nine.distance_mm).all()
    assert seven.visible.tolist() == [0.5, 1.0]


def test_the_command_prints_all_and_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entry = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 500.0], "obj_id": 7}
    (tmp_path / "scene_gt.json").write_text(json.dumps({"0": [entry], "1": [entry]}))
    with ResultsFile(tmp_path / "poses.csv", 1) as results:
        for frame, x_mm in ((0, 1.0), (1, 4.0)):
            results.write(frame, [{"obj_id": 7, "pose": pose(x_mm), "score": 1.0, "status": "tracked"}])
    assert main([str(tmp_path / "poses.csv"), str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "object 7" in printed
    assert " 50.0  100.0  100.0" in printed
    assert main([str(tmp_path / "poses.csv"), str(tmp_path), "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["all"]["shares"]["within_2mm_2deg"] == 0.5
    assert main([str(tmp_path / "none.csv"), str(tmp_path)]) == 1
    assert "none.csv: cannot be read" in capsys.readouterr().err


def test_errors_are_those_of_the_nearest_pose_that_looks_alike() -> None:
    axis, centre = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.03, 0.0])
    ring = np.array([[0.05 * np.cos(turn), 0.03 + 0.05 * np.sin(turn), 0.0] for turn in np.linspace(0, 6.28, 100)])
    free = Likeness(symmetry_of([], [(axis, centre)]), ring)
    quarters = Likeness(symmetry_of([about(axis, centre, turn) for turn in (np.pi / 2, np.pi, -np.pi / 2)], []), ring)
    plain = Likeness(NONE, ring)
    for likeness, angle_deg, mssd_mm in (
        (free, 0.0, 2.0),
        (quarters, 10.0, 8.7),
        (plain, 80.0, 64.3),
        (None, 80.0, None),
    ):
        right = pose(0.0)
        given = right @ about(axis, centre, np.radians(80.0)) @ make_pose(np.eye(3), np.array([0.0, 0.0, 0.002]))
        (found,) = object_errors([Result(1, 1, 7, 1.0, given, 0.0)], {1: [TruePose(7, right, 1.0, likeness)]})
        assert found.angle_deg[0] == pytest.approx(angle_deg, abs=1e-6)
        assert (found.distance_mm[0] == pytest.approx(2.0)) == (likeness is free)
        assert found.mssd_mm is None or found.mssd_mm[0] == pytest.approx(mssd_mm, abs=0.3)
    assert np.isnan(score([found]).mssd_mm)
