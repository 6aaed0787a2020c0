"""Calibration: what is said beside what is, counted by hand; and files that say nothing of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.datasets.truth import Likeness, TruePose
from hierax.nodes.tracking.estimation.certainty import right
from hierax.nodes.tracking.evaluation.calibration import calibration, judge, main
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose
from hierax.nodes.tracking.model.symmetry import NONE, symmetry_of

COVARIANCE = np.diag([0.001**2] * 3 + [0.01**2] * 3)


def written(path: Path, said: list[float], off_mm: list[float], status: str = "tracked") -> Path:
    count = len(said)
    np.savez(
        path,
        status=np.full(count, status),
        visible=np.ones(count),
        probability=np.array(said),
        distance_mm=np.array(off_mm),
        angle_deg=np.zeros(count),
        nees=(np.array(off_mm) / 1.0) ** 2 / 6.0,  # millimetres, as `COVARIANCE` has it
    )
    return path


def test_bins_error_and_errors_beside_covariances(tmp_path: Path) -> None:
    true = written(tmp_path / "a.npz", [0.95, 0.95, 0.95, 0.95], [1.0, 1.0, 2.0, 30.0])
    found = calibration(
        [true, written(tmp_path / "b.npz", [0.55], [1.0]), written(tmp_path / "c.npz", [0.9], [0], "lost")]
    )
    assert found is not None
    assert (found.poses, [each.poses for each in found.bins]) == (5, [1, 4])
    assert found.error == pytest.approx((4 * 0.2 + 1 * 0.45) / 5)
    assert (found.sure, found.astray) == (pytest.approx(0.75), pytest.approx(0.2))
    assert found.anees == pytest.approx((1 + 1 + 4 + 900) / 4 / 6)


def test_the_text_and_the_diagram_are_of_the_same_bins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, diagram = written(tmp_path / "a.npz", [0.95, 0.25], [1.0, 9.0]), tmp_path / "d.svg"
    assert main([str(file), "--diagram", str(diagram)]) == 0
    assert "said 0.25, right 0.00 (1 poses)" in capsys.readouterr().out
    assert diagram.read_text(encoding="utf-8").count("<circle") == 2


def test_files_that_say_nothing_of_certainty_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    junk, old = tmp_path / "junk.npz", tmp_path / "old.npz"
    junk.write_bytes(b"junk")
    np.savez(old, status=np.array(["tracked"]), visible=np.ones(1))
    for path in (tmp_path / "none.npz", junk, old):
        assert main([str(path)]) == 1
        said = capsys.readouterr().err
        assert said.startswith(f"error: {path}: ")
        assert said.endswith("\n")
        assert said.count("\n") == 1
        assert "expected beliefs" in said
    assert main([str(written(tmp_path / "lost.npz", [0.9], [1.0], "lost"))]) == 1
    assert "nothing was tracked" in capsys.readouterr().err


def test_certainty_falls_with_spread_and_with_what_speaks_for_clutter() -> None:
    wide = np.diag([0.005**2] * 3 + [0.01**2] * 3)
    covariances, nats = np.stack((COVARIANCE, wide, COVARIANCE)), np.array([20.0, 20.0, 0.0])
    sure, loose, clutter = right(covariances, nats, [NONE] * 3)
    assert sure == pytest.approx(1.0, abs=0.01)
    assert clutter == pytest.approx(0.5, abs=0.01)
    # the distance of three normal errors of 5 mm is below 5 mm in 19.9 % of all cases (chi distribution)
    assert loose == pytest.approx(0.199, abs=0.05)


def test_how_far_something_round_is_turned_takes_nothing_from_its_certainty() -> None:
    bottle = symmetry_of([], [(np.array([0.0, 0.0, 1.0]), np.zeros(3))])
    ball = symmetry_of([], [(np.eye(3)[axis], np.zeros(3)) for axis in (0, 2)])
    turned = COVARIANCE.copy()
    turned[5, 5] = 0.5**2
    anyhow = COVARIANCE + np.diag([0.0] * 3 + [0.5**2] * 3)
    said = right(np.stack((turned, turned, anyhow, anyhow)), np.full(4, 20.0), [NONE, bottle, bottle, ball])
    assert said[0] < 0.3
    assert said[1] > 0.95
    assert said[2] < 0.1, "a bottle that may lie or stand is not sure"
    assert said[3] > 0.95


def judged(path: Path, given: Floats, true: TruePose, covariance: Floats, status: str = "tracked") -> dict[str, Any]:
    """What is added to the belief of one object in one frame."""
    columns = {"status": status, "score": 1.0, "probability": 0.95, "pose": given, "covariance": covariance}
    np.savez(
        path,
        frame=np.zeros(1, int),
        obj_id=np.ones(1, int),
        **{name: np.array([each]) for name, each in columns.items()},
    )
    judge(path, {0: [true]})
    with np.load(path) as archive:
        return {name: archive[name][0] for name in archive.files}


def test_an_error_is_told_in_the_frame_of_what_was_given_also_if_that_looks_the_same_turned(tmp_path: Path) -> None:
    """A body that is taken for one turned by a quarter, and is off along the x axis of that."""
    quarter = symmetry_of([make_pose(exp_so3(np.array([0.0, 0.0, turn])), np.zeros(3)) for turn in (np.pi / 2,)], [])
    true = TruePose(1, np.eye(4), 1.0, Likeness(quarter, np.zeros((1, 3))))
    given = make_pose(exp_so3(np.array([0.0, 0.0, -np.pi / 2])), np.zeros(3)) @ make_pose(
        np.eye(3), np.array([0.003, 0.0, 0.0])
    )
    sure_across = np.diag([0.003**2, 0.0003**2, 0.0003**2, 0.01**2, 0.01**2, 0.01**2])
    found = judged(tmp_path / "one.npz", given, true, sure_across)
    assert found["twist"] == pytest.approx([-0.003, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-12)
    assert found["nees"] == pytest.approx(1.0 / 6.0)
    assert found["distance_mm"] == pytest.approx(3.0)


def test_how_far_something_round_is_turned_is_no_error(tmp_path: Path) -> None:
    bottle = symmetry_of([], [(np.array([0.0, 0.0, 1.0]), np.zeros(3))])
    true = TruePose(1, np.eye(4), 1.0, Likeness(bottle, np.zeros((1, 3))))
    given = make_pose(exp_so3(np.array([0.0, 0.0, 2.0])), np.array([0.0, 0.0, 0.002]))
    found = judged(tmp_path / "one.npz", given, true, COVARIANCE)
    assert found["nees"] == pytest.approx(4.0 / 5.0)
    assert found["angle_deg"] == pytest.approx(0.0, abs=1e-6)


def test_a_pose_of_what_is_not_there_any_more_is_astray(tmp_path: Path) -> None:
    gone = TruePose(1, make_pose(np.eye(3), np.array([1.0, 0.0, 0.0])), 0.0)
    judged(tmp_path / "gone.npz", np.eye(4), gone, COVARIANCE)
    judged(tmp_path / "lost.npz", np.eye(4), gone, COVARIANCE, "lost")
    there = written(tmp_path / "there.npz", [0.95], [1.0])
    told = [calibration([there, tmp_path / name]) for name in ("gone.npz", "lost.npz")]
    assert [each.astray for each in told if each is not None] == [0.5, 0.0]
    assert [each.poses for each in told if each is not None] == [1, 1]
