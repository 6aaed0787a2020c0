"""Rigid poses and the pinhole camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hierax.nodes.tracking.math import geometry as g
from hierax.nodes.tracking.math.batched import adjoints

TWISTS = arrays(np.float64, 6, elements=st.floats(-1.5, 1.5))


@given(TWISTS)
def test_log_undoes_exp(twist: np.ndarray) -> None:
    pose = g.exp_se3(twist)
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.allclose(g.log_se3(pose), twist, atol=1e-7)


def test_exp_of_a_screw_is_known() -> None:
    # A quarter turn about z while moving along the circle of radius 1 around (0, 1).
    pose = g.exp_se3(np.array([np.pi / 2, 0, 0, 0, 0, np.pi / 2]))
    assert np.allclose(pose[:3, 3], [1.0, 1.0, 0.0])
    assert np.allclose(pose[:3, 0], [0.0, 1.0, 0.0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 1.0, np.pi - 1e-6, np.pi])
def test_rotation_vectors_up_to_half_a_turn(angle: float) -> None:
    vector = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    back = g.log_so3(g.exp_so3(vector))
    assert np.allclose(g.exp_so3(back), g.exp_so3(vector), atol=1e-12)
    assert np.linalg.norm(back) == pytest.approx(angle, abs=1e-7)


@given(TWISTS, TWISTS)
def test_adjoint_moves_a_twist_to_the_other_side(first: np.ndarray, second: np.ndarray) -> None:
    pose = g.exp_se3(first)
    assert np.allclose(pose @ g.exp_se3(second), g.exp_se3(adjoints(pose[None])[0] @ second) @ pose, atol=1e-9)


@given(TWISTS)
def test_quaternions_and_inverses(twist: np.ndarray) -> None:
    pose = g.exp_se3(2.0 * twist)
    quaternion = g.quaternion_of(pose[:3, :3])
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    assert quaternion[3] >= 0
    assert np.allclose(g.rotation_of(quaternion), pose[:3, :3], atol=1e-12)
    assert np.allclose(g.invert(pose) @ pose, np.eye(4), atol=1e-12)


def test_orthonormal_removes_drift() -> None:
    pose = g.exp_se3(np.array([1.0, 2.0, 3.0, 0.4, 0.5, -0.6]))
    bent = pose.copy()
    bent[:3, :3] += 1e-4 * np.arange(9).reshape(3, 3)
    mended = g.orthonormal(bent)
    assert np.allclose(mended[:3, :3] @ mended[:3, :3].T, np.eye(3), atol=1e-14)
    assert np.abs(mended - pose).max() < 1e-3


def test_projection_and_rays_are_inverse() -> None:
    intrinsics = np.array([500.0, 510.0, 320.0, 240.0])
    assert g.project(np.array([0.1, -0.2, 2.0]), intrinsics) == pytest.approx([345.0, 189.0])
    points = np.random.default_rng(1).uniform(0.5, 2.0, (20, 3))
    assert np.allclose(g.rays(g.project(points, intrinsics), intrinsics) * points[:, 2:], points)


def test_pose_error_in_metres_and_radians() -> None:
    other = g.make_pose(g.exp_so3(np.array([0.0, 0.3, 0.0])), np.array([0.0, 3.0, 4.0]))
    assert g.pose_error(np.eye(4), other) == pytest.approx((5.0, 0.3))
