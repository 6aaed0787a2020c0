"""Pose correction on drawn images with known poses."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, Box, cast, photograph

from hierax.nodes.tracking.edges import visible_edges
from hierax.nodes.tracking.geometry import exp_se3, exp_so3, invert, make_pose, pose_error, transform
from hierax.nodes.tracking.matching import control_points, match, shifted, smoothed

COVARIANCE = np.diag([0.01**2] * 3 + [0.06**2] * 3)
BOX = Box(1, (0.08, 0.07, 0.09), make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.02, -0.01, 0.5]))


def edges_of(box: Box, predicted: np.ndarray, others: tuple[Box, ...] = ()) -> np.ndarray:
    """The edges expected at a predicted pose, in the object's frame."""
    seen = cast([box._replace(pose=predicted), *others])
    return transform(invert(predicted), visible_edges(seen.depth, seen.labels, box.label, INTRINSICS).segments)


@pytest.mark.parametrize("seed", range(6))
def test_a_wrong_prediction_is_corrected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    twist = np.concatenate((rng.uniform(-0.005, 0.005, 3), rng.uniform(-0.05, 0.05, 3)))
    predicted = BOX.pose @ exp_se3(twist)
    image = smoothed(photograph([BOX], 2.0, rng))
    found = match(image, edges_of(BOX, predicted), predicted, COVARIANCE, INTRINSICS)
    assert found is not None
    distance, angle = pose_error(found.pose, BOX.pose)
    assert distance < 0.0008, f"seed {seed}"
    assert angle < np.radians(0.3), f"seed {seed}"
    assert found.score > 0.9
    assert found.residual_px < 0.3
    assert found.supported.mean() > 0.9
    assert np.linalg.eigvalsh(found.information).min() > 0


def test_colour_is_seen_where_gray_is_flat() -> None:
    rng = np.random.default_rng(3)
    seen = cast([BOX])
    # Three faces and the ground of one luminance and different hues.
    palette = np.array([[150, 90, 110], [90, 120, 110], [110, 100, 180], [120, 100, 105]])
    number = np.where(seen.labels > 0, np.unique(seen.faces, return_inverse=True)[1].reshape(seen.faces.shape) % 3, 3)
    image = smoothed(np.clip(palette[number] + rng.normal(size=(*number.shape, 3)), 0, 255).astype(np.uint8))
    predicted = BOX.pose @ exp_se3(np.array([0.003, -0.002, 0.002, 0.02, -0.03, 0.01]))
    found = match(image, edges_of(BOX, predicted), predicted, COVARIANCE, INTRINSICS)
    assert found is not None
    assert found.score > 0.9
    assert pose_error(found.pose, BOX.pose)[0] < 0.002


@pytest.mark.parametrize("shift_px", [(26, -16), (-38, 5), (0, 33)])
def test_a_start_far_away_is_shifted_to_the_object(shift_px: tuple[int, int]) -> None:
    image = smoothed(photograph([BOX], 2.0, np.random.default_rng(4)))
    away = np.array([*(0.5 * np.array(shift_px) / INTRINSICS[:2]), 0.0])
    start = make_pose(np.eye(3), away) @ BOX.pose
    edges = edges_of(BOX, start)
    near = shifted(image, edges, start, INTRINSICS)
    assert pose_error(near, BOX.pose)[0] < 0.004
    assert np.array_equal(near[:3, :3], start[:3, :3])
    found = match(image, edges, near, COVARIANCE, INTRINSICS)
    assert found is not None
    assert pose_error(found.pose, BOX.pose)[0] < 0.001
    assert np.array_equal(shifted(image, edges[:0], start, INTRINSICS), start)


def test_an_object_that_is_hidden_in_part_is_corrected_by_the_rest() -> None:
    hider = Box(2, (0.06, 0.06, 0.06), make_pose(exp_so3(np.array([0.1, 0.4, 0.3])), [0.05, 0.0, 0.38]))
    rng = np.random.default_rng(6)
    image = smoothed(photograph([BOX, hider], 2.0, rng))
    predicted = BOX.pose @ exp_se3(np.array([0.002, -0.003, 0.002, 0.02, 0.02, -0.02]))
    found = match(image, edges_of(BOX, predicted, (hider,)), predicted, COVARIANCE, INTRINSICS)
    assert found is not None
    distance, angle = pose_error(found.pose, BOX.pose)
    assert distance < 0.002
    assert angle < np.radians(0.7)


def test_images_without_the_object_score_low() -> None:
    edges = edges_of(BOX, BOX.pose)
    rng = np.random.default_rng(7)
    blank = np.full((480, 640), 120, dtype=np.uint8)
    noise = rng.integers(0, 256, (480, 640)).astype(np.uint8)
    for image in (blank, noise):
        found = match(smoothed(image), edges, BOX.pose, COVARIANCE, INTRINSICS)
        assert found is not None
        assert found.score < 0.3


def test_the_prior_holds_what_the_image_does_not_show() -> None:
    image = smoothed(np.full((480, 640), 120, dtype=np.uint8))
    found = match(image, edges_of(BOX, BOX.pose), BOX.pose, COVARIANCE, INTRINSICS)
    assert found is not None
    assert np.allclose(found.pose, BOX.pose, atol=1e-9)


def test_edges_outside_of_the_image_match_nothing() -> None:
    image = smoothed(photograph([BOX], 2.0, np.random.default_rng(8)))
    edges = edges_of(BOX, BOX.pose)
    for away in ([2.0, 0.0, 0.5], [0.0, 0.0, -0.5]):
        assert match(image, edges, make_pose(np.eye(3), away), COVARIANCE, INTRINSICS) is None
    assert match(image, np.zeros((0, 2, 3)), BOX.pose, COVARIANCE, INTRINSICS) is None


def test_control_points_are_spread_evenly_and_bounded() -> None:
    segments = np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.001, 0.0]]])
    controls = control_points(segments, make_pose(np.eye(3), [0.0, 0.0, 0.5]), INTRINSICS)
    # 105 pixels, less a margin of 3 at both ends, every 4; the other one is too short.
    assert set(controls.owners.tolist()) == {0}
    assert len(controls.owners) == 25
    steps = np.diff(controls.points[:, 0, 0])
    assert np.allclose(steps, steps[0])
    near = control_points(segments, make_pose(np.eye(3), [0.0, 0.0, 0.05]), INTRINSICS)
    assert len(near.owners) <= 400


def test_equal_to_the_bit_when_done_again() -> None:
    image = smoothed(photograph([BOX], 2.0, np.random.default_rng(9)))
    predicted = BOX.pose @ exp_se3(np.array([0.003, -0.002, 0.002, 0.02, -0.03, 0.01]))
    edges = edges_of(BOX, predicted)
    first, second = (match(image, edges, predicted, COVARIANCE, INTRINSICS) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.pose.tobytes() == second.pose.tobytes()
    assert first.information.tobytes() == second.information.tobytes()
