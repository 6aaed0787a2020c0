"""Physics of the arm: held by friction, let go without, and a function of values alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from hierax.nodes.picking import workcell
from hierax.nodes.picking.panda import HOME_RAD, gripper_at, gripper_down, joints_for
from hierax.nodes.picking.workcell import Arm, Cube, Order, Touch, Workcell
from hierax.nodes.tracking.math.geometry import Floats, invert, make_pose, pose_error

SIDE_M = 0.045
STEPS = 12
TURN_RAD = 0.2
LIFT_M = 0.12


class Scene(NamedTuple):
    arm: Arm
    cube: Cube
    touch: Touch
    targets: Floats


def gripper_over(height_m: float) -> Floats:
    return gripper_down((0.5, 0.03, height_m), TURN_RAD)


def around_a_cube() -> Scene:
    joints, _ = joints_for(gripper_over(SIDE_M / 2), HOME_RAD, 200)
    arm = Arm(joints, np.zeros(7), np.full(2, 0.033), np.zeros(2))
    turned = gripper_over(0.0)[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    pose = make_pose(turned, np.array([0.501, 0.032, SIDE_M / 2]))
    return Scene(arm, Cube(SIDE_M, pose, np.zeros(6)), Touch(False, False), joints)


def forth(cell: Workcell, scene: Scene, height_m: float, width_m: float, frames: int) -> Scene:
    """Frames on the way to a height, at an even pace."""
    start = gripper_at(scene.targets)[2, 3]
    for frame in range(1, frames + 1):
        wanted = gripper_over(start + (height_m - start) * frame / frames)
        targets, _ = joints_for(wanted, scene.targets)
        arm, (cube,), (touch,), _ = cell.run(scene.arm, [scene.cube], Order(scene.targets, targets, width_m), STEPS)
        scene = Scene(arm, cube, touch, targets)
    return scene


def held(cell: Workcell) -> Scene:
    closed = forth(cell, around_a_cube(), SIDE_M / 2, 0.0, 12)
    return forth(cell, closed, SIDE_M / 2 + LIFT_M, 0.0, 24)


def hand_from_cube(scene: Scene) -> Floats:
    return invert(gripper_at(scene.arm.joints)) @ scene.cube.pose


def test_a_cube_is_lifted_and_held_by_the_fingers_alone() -> None:
    cell = Workcell()
    lifted = held(cell)
    assert lifted.cube.pose[2, 3] - SIDE_M / 2 > LIFT_M - 0.004
    assert lifted.touch == Touch(fingers=True, other=False)
    assert float(lifted.arm.fingers.sum()) == pytest.approx(SIDE_M, abs=0.001)
    after = forth(cell, lifted, SIDE_M / 2 + LIFT_M, 0.0, 40)
    distance, angle = pose_error(hand_from_cube(lifted), hand_from_cube(after))
    assert distance < 0.001
    assert angle < np.radians(4.0)
    assert np.abs(after.cube.velocity).max() < 0.01
    assert cell.bullet.getNumConstraints() == 0


def test_without_friction_it_stays_on_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workcell, "CUBE_FRICTION", 0.0)
    after = held(Workcell())
    assert after.cube.pose[2, 3] < SIDE_M / 2 + 0.01
    assert after.touch.other


def test_it_falls_when_the_gripper_opens() -> None:
    cell = Workcell()
    lifted = held(cell)
    after = forth(cell, lifted, SIDE_M / 2 + LIFT_M, 0.08, 16)
    assert after.cube.pose[2, 3] < SIDE_M
    assert not after.touch.fingers


def test_another_process_goes_on_to_the_bit() -> None:
    cell = Workcell()
    scene = forth(cell, around_a_cube(), SIDE_M / 2, 0.0, 8)
    here = forth(cell, scene, SIDE_M / 2 + 0.05, 0.0, 6)
    there = forth(Workcell(), scene, SIDE_M / 2 + 0.05, 0.0, 6)
    assert np.array_equal(here.cube.pose, there.cube.pose)
    assert np.array_equal(here.cube.velocity, there.cube.velocity)
    for one, two in zip(here.arm, there.arm, strict=True):
        assert np.array_equal(one, two)


def test_at_rest_nothing_moves() -> None:
    joints = HOME_RAD
    arm = Arm(joints, np.zeros(7), np.full(2, 0.04), np.zeros(2))
    cube = Cube(SIDE_M, make_pose(np.eye(3), np.array([0.5, 0.0, SIDE_M / 2])), np.zeros(6))
    cell = Workcell()
    for _ in range(10):
        arm, (cube,), (touch,), _ = cell.run(arm, [cube], Order(joints, joints, 0.08), STEPS)
    np.testing.assert_allclose(arm.joints, joints, atol=1e-3)
    np.testing.assert_allclose(cube.pose[:3, 3], [0.5, 0.0, SIDE_M / 2], atol=3e-4)
    assert touch == Touch(fingers=False, other=True)


def test_what_is_given_is_not_changed() -> None:
    scene = around_a_cube()
    before = scene.cube.pose.copy(), scene.arm.joints.copy()
    forth(Workcell(), scene, SIDE_M / 2, 0.0, 1)
    assert np.array_equal(scene.cube.pose, before[0])
    assert np.array_equal(scene.arm.joints, before[1])
