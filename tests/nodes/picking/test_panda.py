"""The arm's geometry against pybullet's model of it, and joints that reach what they should."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.picking.panda import (
    HIGHEST_RAD,
    HOME_GRIPPER,
    HOME_RAD,
    LOWEST_RAD,
    camera_of,
    gripper_at,
    gripper_down,
    joints_for,
)
from hierax.nodes.picking.workcell import panda_file
from hierax.nodes.tracking.imagery.physics import Bullet
from hierax.nodes.tracking.math.geometry import Floats, make_pose, pose_error, rotation_of

SEED = 5
HAND_LINK = 8
HAND_TO_GRIPPER_M = 0.1034


def in_pybullet(joints: Floats) -> Floats:
    bullet = Bullet()
    robot = bullet.loadURDF(str(panda_file()), useFixedBase=1)
    for joint, angle in enumerate(joints):
        bullet.resetJointState(robot, joint, angle)
    state = bullet.getLinkState(robot, HAND_LINK, computeForwardKinematics=1)
    rotation = rotation_of(state[5])
    return make_pose(rotation, np.array(state[4]) + HAND_TO_GRIPPER_M * rotation[:, 2])


def test_the_gripper_is_where_pybullet_has_it() -> None:
    rng = np.random.default_rng(SEED)
    for _ in range(5):
        joints = rng.uniform(LOWEST_RAD, HIGHEST_RAD)
        distance, angle = pose_error(gripper_at(joints), in_pybullet(joints))
        assert distance < 1e-6, f"seed {SEED}, joints {joints}"
        assert angle < 1e-6, f"seed {SEED}, joints {joints}"


@pytest.mark.parametrize("yaw_deg", [-80.0, 0.0, 55.0])
@pytest.mark.parametrize("place", [(0.40, -0.17, 0.03), (0.60, 0.17, 0.03), (0.5, 0.0, 0.2)])
def test_all_of_the_table_is_reached(place: tuple[float, ...], yaw_deg: float) -> None:
    wanted = gripper_down(place, np.radians(yaw_deg))
    joints, off = joints_for(wanted, HOME_RAD, 200)
    distance, angle = pose_error(gripper_at(joints), wanted)
    assert off < 1e-4
    assert distance < 1e-4
    assert angle < 1e-4
    assert np.all(joints >= LOWEST_RAD)
    assert np.all(joints <= HIGHEST_RAD)


def test_what_is_as_near_as_asked_for_is_left_at_that() -> None:
    wanted = gripper_down((0.5, 0.1, 0.2))
    joints, off = joints_for(wanted, HOME_RAD, 60, 1e-3)
    assert 1e-7 < off < 1e-3
    again, _ = joints_for(wanted, joints, 60, 1e-3)
    np.testing.assert_array_equal(again, joints)


def test_what_is_out_of_reach_is_said_to_be() -> None:
    _, off = joints_for(gripper_down((1.2, 0.0, 0.1)), HOME_RAD, 100)
    assert off > 0.1


def test_at_home_the_gripper_hangs_over_the_table_and_the_camera_sees_its_middle() -> None:
    distance, angle = pose_error(gripper_at(HOME_RAD), HOME_GRIPPER)
    assert distance < 1e-4
    assert angle < 1e-4
    camera = camera_of(HOME_GRIPPER)
    position, ahead = camera[:3, 3], camera[:3, 2]
    seen = position - position[2] / ahead[2] * ahead
    np.testing.assert_allclose(seen, [0.5, 0.0, 0.0], atol=0.03)


def test_a_gripper_that_points_down_closes_across_its_way_forward() -> None:
    pose = gripper_down((0.1, 0.2, 0.3), np.radians(90.0))
    np.testing.assert_allclose(pose[:3, 2], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 1], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 3], [0.1, 0.2, 0.3])
