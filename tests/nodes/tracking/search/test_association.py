"""Poses of several objects from one image: together, with the camera's error, and where they are far off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import INTRINSICS, photograph
from support.drawn import BOXES, FIRST, all_expected, expected

from hierax.nodes.tracking.estimation.drift import joint_of
from hierax.nodes.tracking.estimation.fusion import Known
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.math.geometry import exp_se3, pose_error
from hierax.nodes.tracking.search import association
from hierax.nodes.tracking.search.association import Options, associate
from hierax.nodes.tracking.search.multistart import Found

OPTIONS = Options(np.diag([0.01**2] * 3 + [0.06**2] * 3), 0.75)
REPORTS = np.diag([0.0015**2] * 3 + [0.0025**2] * 3)


@pytest.mark.parametrize("seed", range(5))
def test_wrong_predictions_are_corrected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    twists = np.concatenate((rng.uniform(-0.004, 0.004, (2, 3)), rng.uniform(-0.04, 0.04, (2, 3))), axis=1)
    predicted = [box.pose @ exp_se3(twist) for box, twist in zip(BOXES, twists, strict=True)]
    image = smoothed(photograph(BOXES, 2.0, rng))
    found = associate(image, all_expected(BOXES, predicted), None, INTRINSICS, OPTIONS)
    assert found is not None
    for estimate, box in zip(found.estimates, BOXES, strict=True):
        distance, angle = pose_error(estimate.pose, box.pose)
        assert distance < 0.0015, f"seed {seed}"
        assert angle < np.radians(0.5), f"seed {seed}"
        assert estimate.score > 0.8
        assert np.linalg.eigvalsh(estimate.covariance).min() > 0
        assert np.trace(estimate.covariance) < np.trace(all_expected(BOXES, predicted)[0]["covariance"])


def test_what_all_objects_do_together_is_the_cameras_error() -> None:
    error = exp_se3(np.array([0.001, -0.0015, 0.0, 0.002, 0.001, -0.003]))
    known = [
        {**item, "covariance": 0.04 * item["covariance"]}
        for item in all_expected(BOXES, [error @ box.pose for box in BOXES])
    ]
    image = smoothed(photograph(BOXES, 2.0, np.random.default_rng(6)))
    found = associate(image, known, Known(joint_of(known, None, REPORTS)), INTRINSICS, OPTIONS)
    assert found is not None
    shift = found.shift
    for estimate, item, box in zip(found.estimates, known, BOXES, strict=True):
        assert pose_error(estimate.pose, box.pose)[0] < 0.001
        # By the camera's part alone each object is nearer to where it is than it was.
        assert pose_error(shift @ item["pose"], box.pose)[0] < 0.6 * pose_error(item["pose"], box.pose)[0]
    held = associate(image, known, None, INTRINSICS, OPTIONS)
    assert held is not None
    assert np.array_equal(held.shift, np.eye(4))


def test_an_object_that_was_pushed_far_is_found() -> None:
    away = FIRST.pose @ exp_se3(np.array([0.016, -0.012, 0.004, 0.02, 0.1, -0.05]))
    item = {**expected(FIRST, away), "motion_scale": 1.0}
    found = associate(smoothed(photograph([FIRST], 2.0, np.random.default_rng(7))), [item], None, INTRINSICS, OPTIONS)
    assert found is not None
    distance, angle = pose_error(found.estimates[0].pose, FIRST.pose)
    assert distance < 0.0015
    assert angle < np.radians(0.6)


def test_images_without_the_object_score_low() -> None:
    rng = np.random.default_rng(8)
    blank = np.full((480, 640), 120, dtype=np.uint8)
    noise = rng.integers(0, 256, (480, 640)).astype(np.uint8)
    for image in (blank, noise):
        found = associate(smoothed(image), [expected(FIRST, FIRST.pose)], None, INTRINSICS, OPTIONS)
        assert found is not None
        assert found.estimates[0].score < 0.35
    held = associate(smoothed(blank), [expected(FIRST, FIRST.pose)], None, INTRINSICS, OPTIONS)
    assert held is not None
    assert np.allclose(held.estimates[0].pose, FIRST.pose, atol=1e-9)


@pytest.mark.parametrize("away", [0.0, 0.002])
def test_where_its_edges_are_off_is_told_by_what_is_still(away: float) -> None:
    """Of what moves it is rather the prediction that is off."""
    item = expected(FIRST, FIRST.pose)
    item = {**item, "motion_scale": 0.02, "before": FIRST.pose @ exp_se3(np.array([away, 0.0, 0.0, 0.0, 0.0, 0.0]))}
    item = {**item, "covariance": 0.01 * item["covariance"]}
    image = smoothed(photograph([FIRST], 1.0, np.random.default_rng(12)))
    for _ in range(3):
        found = associate(image, [item], None, INTRINSICS, OPTIONS)
        assert found is not None
        item = {**item, "slots": found.estimates[0].slots}
    assert len(item["slots"]["keys"]) > 0
    assert (len(item["slots"]["edges"]) > 0) == (away == 0.0)


def test_nothing_is_said_where_nothing_is_expected_in_the_image() -> None:
    image = smoothed(np.full((480, 640), 120, dtype=np.uint8))
    behind = FIRST.pose.copy()
    behind[2, 3] = -0.5
    item = {**expected(FIRST, FIRST.pose), "pose": behind, "before": behind}
    assert associate(image, [item], None, INTRINSICS, OPTIONS) is None


def test_equal_to_the_bit_when_done_again() -> None:
    image = smoothed(photograph(BOXES, 2.0, np.random.default_rng(9)))
    known = all_expected(BOXES, [box.pose @ exp_se3(np.full(6, 0.003)) for box in BOXES])
    joint = Known(joint_of(known, None, REPORTS))
    first, second = (associate(image, known, joint, INTRINSICS, OPTIONS) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.shift.tobytes() == second.shift.tobytes()
    for one, other in zip(first.estimates, second.estimates, strict=True):
        assert one.pose.tobytes() == other.pose.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes()


@pytest.mark.parametrize(("away_m", "rests"), [(0.0005, True), (0.003, False)])
def test_what_is_found_elsewhere_no_farther_away_than_predictions_err_did_not_move(
    away_m: float, rests: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found_there(_looking: Any, found: Found, *_: Any) -> Found:
        there = found.poses @ exp_se3(np.array([away_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
        seen = np.diag([0.0003**2] * 3 + [0.003**2] * 3)[None]
        return found._replace(poses=there, covariance=seen, motion_scale=np.ones(1), elsewhere=np.ones(1, dtype=bool))

    monkeypatch.setattr(association, "look_elsewhere", found_there)
    known = np.diag([0.0004**2] * 3 + [0.004**2] * 3)
    item = {**expected(FIRST, FIRST.pose), "motion_scale": 0.02, "covariance": known, "probation": 1}
    blank = smoothed(np.full((480, 640), 120, dtype=np.uint8))
    found = associate(blank, [item], None, INTRINSICS, OPTIONS)
    assert found is not None
    estimate = found.estimates[0]
    assert estimate.elsewhere != rests
    assert (estimate.motion_scale == 1.0) != rests
    moved = pose_error(estimate.pose, FIRST.pose)[0]
    # Prediction and image are averaged, or the image alone is believed.
    assert 0.2 * away_m < moved < 0.8 * away_m if rests else moved == pytest.approx(away_m)
    assert np.trace(estimate.covariance) < np.trace(known)
