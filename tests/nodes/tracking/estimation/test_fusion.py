"""Prediction and image together: averaged at rest, believed at once where something moves."""

from __future__ import annotations

import numpy as np
from support.boxes import INTRINSICS, photograph
from support.drawn import BOXES, FIRST, all_expected, expected

from hierax.nodes.tracking.constants import LEAST_MOTION_SCALE
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.appearance import NOTHING, recalled
from hierax.nodes.tracking.estimation.drift import joint_of
from hierax.nodes.tracking.estimation.fusion import Prior, fuse
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.math.batched import inverse
from hierax.nodes.tracking.math.geometry import exp_se3
from hierax.nodes.tracking.model.controls import gathered

MOTION = np.diag([0.01**2] * 3 + [0.06**2] * 3)
KNOWN = 1e-3**2 * np.diag([1.0] * 3 + [50.0] * 3)


def aligned(twist: np.ndarray) -> tuple[Aligned, Prior]:
    items = all_expected(BOXES, [box.pose @ exp_se3(-twist) for box in BOXES])
    covariance = np.stack([KNOWN] * 2)
    controls = gathered([item["controls"] for item in items])
    start = Start(np.stack([item["pose"] for item in items]), inverse(covariance + MOTION))
    image = smoothed(photograph(BOXES, 2.0, np.random.default_rng(3)))
    found = align(image, controls, start, INTRINSICS, recalled([NOTHING] * 2, controls, 1), Search())
    assert found is not None
    return found, Prior(covariance, MOTION, np.full(2, 0.02), np.zeros((2, 6)), None)


def test_what_moved_is_believed_at_once() -> None:
    twist = np.array([0.006, 0.0, 0.0, 0.0, 0.02, 0.0])
    found, prior = aligned(twist)
    fused = fuse(found, prior)
    assert np.array_equal(fused.motion_scale, [1.0, 1.0])
    np.testing.assert_allclose(fused.own, [twist, twist], atol=0.002)
    assert np.array_equal(fused.shift, np.zeros(6))


def test_what_is_known_to_rest_is_not_believed_to_have_moved() -> None:
    twist = np.array([0.006, 0.0, 0.0, 0.0, 0.02, 0.0])
    found, prior = aligned(twist)
    fused = fuse(found, prior, np.array([True, False]))
    assert fused.motion_scale[0] < 1.0 == fused.motion_scale[1]
    assert np.linalg.norm(fused.own[0]) < 0.9 * np.linalg.norm(fused.own[1])


def test_what_rests_calms_down_and_grows_certain() -> None:
    found, prior = aligned(np.zeros(6))
    restless = prior._replace(motion_scale=np.full(2, 0.5))
    fused = fuse(found, restless)
    assert (fused.motion_scale < 0.5).all()
    assert (fuse(found, prior).motion_scale >= LEAST_MOTION_SCALE).all()
    for after, before in zip(fused.covariance, restless.spread(), strict=True):
        assert np.linalg.eigvalsh(before - after).min() > 0


def test_small_deviations_the_same_way_surprise_in_the_end() -> None:
    found, prior = aligned(np.array([0.0022, 0.0, 0.0, 0.0, 0.0, 0.0]))
    surprised = []
    for _ in range(12):
        fused = fuse(found, prior)
        surprised.append(bool((fused.motion_scale == 1.0).any()))
        if surprised[-1]:
            break
        prior = prior._replace(trend=fused.trend, motion_scale=np.full(2, 0.02))
    assert not surprised[0]
    assert surprised[-1]


def test_a_common_error_goes_to_the_camera_where_it_may_have_one() -> None:
    reports = np.diag([0.0015**2] * 3 + [0.0025**2] * 3)
    error = np.array([0.001, 0.0008, 0.0, 0.0, 0.0, 0.002])
    items = all_expected(BOXES, [exp_se3(-error) @ box.pose for box in BOXES])
    covariance = np.stack([0.04 * KNOWN] * 2)
    joint = joint_of([{**item, "covariance": 0.04 * KNOWN} for item in items], None, reports)
    prior = Prior(covariance, MOTION, np.full(2, 0.02), np.zeros((2, 6)), joint)
    controls = gathered([item["controls"] for item in items])
    start = Start(np.stack([item["pose"] for item in items]), inverse(covariance + 0.1 * MOTION), prior.camera)
    image = smoothed(photograph(BOXES, 2.0, np.random.default_rng(5)))
    found = align(image, controls, start, INTRINSICS, recalled([NOTHING] * 2, controls, 1), Search())
    assert found is not None
    fused = fuse(found, prior)
    assert np.linalg.norm(fused.shift[:3] - error[:3]) < 0.5 * np.linalg.norm(error[:3])
    assert np.abs(fused.own[:, :3]).max() < 0.0006


def test_the_expected_box_is_where_it_is_drawn() -> None:
    """What the other tests rest on: the controls lie on edges of the drawn image."""
    item = expected(FIRST, FIRST.pose)
    assert len(item["controls"]["points"]) > 80
