"""Physics of the arm: held by friction, let go without, and a function of values alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from hierax.nodes.picking import workcell
from hierax.nodes.picking.panda import HOME_RAD, gripper_at, gripper_down, joints_for
from hierax.nodes.picking.workcell import Arm, Cube, Grip, Guest, Order, Touch, Workcell
from hierax.nodes.tracking.imagery import physics
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


class Situation(NamedTuple):
    arm: Arm
    cubes: list[Cube]
    order: Order
    guest: Guest | None


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


def beside_cubes(rng: np.random.Generator) -> Situation:
    """An arm whose fingers are among three cubes, two of them one upon the other; and often somebody's hand."""
    width_m = rng.uniform(0.0, 0.08)
    place = (0.5 + rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05), rng.uniform(0.02, 0.12))
    joints, _ = joints_for(gripper_down(place, rng.uniform(-0.5, 0.5)), HOME_RAD, 200)
    arm = Arm(joints, rng.normal(0.0, 0.1, 7), np.full(2, width_m / 2), np.zeros(2))
    middles = np.array([[0.5, 0.0, SIDE_M / 2], [0.505, 0.004, 1.5 * SIDE_M], [0.5, 0.09, SIDE_M / 2]])
    cubes = [Cube(SIDE_M, make_pose(np.eye(3), middle), rng.normal(0.0, 0.02, 6)) for middle in middles]
    guest = None
    if rng.random() < 0.3:
        hand = make_pose(np.eye(3), np.array([0.5, 0.16, 0.06]))
        grip = Grip(3, make_pose(np.eye(3), np.array([0.0, -0.07, -0.0375]))) if rng.random() < 0.5 else None
        guest = Guest(hand, np.zeros(6), hand, make_pose(np.eye(3), np.array([0.5, 0.12, 0.06])), grip)
    return Situation(arm, cubes, Order(joints, joints + rng.normal(0.0, 0.02, 7), width_m), guest)


@pytest.mark.parametrize("seed", range(3))
def test_what_was_before_does_not_matter(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor where the client is emptied now and then, as what is gone adds up."""
    monkeypatch.setattr(physics, "MADE_MOST", 20)
    rng, cell = np.random.default_rng(seed), Workcell()
    for turn in range(12):
        arm, cubes, order, guest = beside_cubes(rng)
        for _ in range(4):
            here = cell.run(arm, cubes, order, STEPS, guest)
            assert values_of(here) == values_of(Workcell().run(arm, cubes, order, STEPS, guest)), f"turn {turn}"
            arm, cubes, _, guest = here
            order = order._replace(start=order.end)


def test_where_the_arm_was_bullet_looks_for_nothing_of_it() -> None:
    """What is in the boxes that it keeps around links is solved together with them, in another order."""
    poses = [gripper_down((0.57, 0.02, 0.2)), gripper_down((0.56, 0.0, 0.19)), gripper_down((0.52, -0.05, 0.15))]
    joints = [joints_for(pose, HOME_RAD, 200)[0] for pose in poses]
    cell, boxes = Workcell(), []
    for angles in joints:
        arm, order = Arm(angles, np.zeros(7), np.full(2, 0.033), np.zeros(2)), Order(angles, angles, 0.066)
        for each in (cell, Workcell()):
            each.run(arm, [], order, 1)
            boxes.append(links_near(each, angles))
    assert boxes[::2] == boxes[1::2]
    assert all(any(near) for near in boxes)


def links_near(cell: Workcell, joints: Floats) -> list[set[tuple[int, int]]]:
    """Which links bullet looks at near places around the gripper."""
    middle = gripper_at(joints)[:3, 3]
    places = middle + np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 17)] * 3), axis=-1).reshape(-1, 3)
    found = (cell.bullet.getOverlappingObjects(place.tolist(), (place + 0.001).tolist()) for place in places)
    return [set(each or ()) for each in found]


def values_of(after: tuple[Arm, list[Cube], list[Touch], Guest | None]) -> list[object]:
    """All that is told, to be compared to the bit."""
    arm, cubes, touches, guest = after
    bodies = [(cube.pose.tolist(), cube.velocity.tolist()) for cube in cubes]
    hand = None if guest is None else (guest.pose.tolist(), guest.velocity.tolist())
    return [[part.tolist() for part in arm], bodies, touches, hand]


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
