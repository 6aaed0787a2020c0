"""The world: true places that nobody else knows, a controller, and what counts as grasped."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.commands import command, name_of
from hierax.nodes.picking.layout import GUESS_M, GUESS_RAD, guessed, planned
from hierax.nodes.picking.panda import HOME_GRIPPER, WIDEST_M, gripper_at, gripper_down
from hierax.nodes.picking.views import SceneView
from hierax.nodes.picking.world import OFF_PLAN_M, OFF_PLAN_RAD, PickWorld, picture_and_hand_seen
from hierax.nodes.tracking.math.geometry import Array, Floats, pose_error
from hierax.runtime import Tick

SEED = 3


def after(world: PickWorld, belief: Any, wanted: Any, frames: int) -> Any:
    for _ in range(frames):
        (action,) = world.policies()[world.select_policy((wanted,))](belief)
        belief = world.predict((), (action,), belief)
    return belief


def test_cubes_stand_near_the_plan_and_the_guess_but_on_neither() -> None:
    for scene in range(20):
        bodies = PickWorld(scene).initial_belief()["bodies"]
        for body, place, guess in zip(bodies, planned(scene), guessed(scene), strict=True):
            off_plan, turned = pose_error(body["pose"], place.pose)
            assert off_plan <= OFF_PLAN_M + 1e-9
            assert turned <= OFF_PLAN_RAD + 1e-9
            off_guess, angle = pose_error(body["pose"], guess)
            assert 1e-5 < off_guess <= OFF_PLAN_M + GUESS_M + 1e-9, f"scene {scene}, cube {body['id']}"
            assert 1e-5 < angle <= OFF_PLAN_RAD + GUESS_RAD + 1e-9, f"scene {scene}, cube {body['id']}"
            assert body["pose"][2, 3] == pytest.approx(place.pose[2, 3])


def test_stacks_stand() -> None:
    for scene in (1, 3):
        world = PickWorld(scene)
        belief = world.initial_belief()
        for _ in range(10):
            belief = world.predict((), (), belief)
        for body, first in zip(belief["bodies"], world.initial_belief()["bodies"], strict=True):
            assert pose_error(body["pose"], first["pose"])[0] < 5e-4, f"scene {scene}, cube {body['id']}"


def test_the_gripper_goes_where_it_is_told_and_no_faster() -> None:
    world = PickWorld(0, cubes=1)
    goal = gripper_down((0.45, -0.05, 0.30), 0.4)
    belief, places = world.initial_belief(), [HOME_GRIPPER[:3, 3]]
    for _ in range(50):
        belief = after(world, belief, command(goal, 0.05, 0.2), 1)
        places.append(gripper_at(belief["joints"])[:3, 3])
    distance, angle = pose_error(gripper_at(belief["joints"]), goal)
    assert distance < 1e-3
    assert angle < np.radians(0.3)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 1.3 * 0.2 / 20
    assert float(belief["fingers"].sum()) == pytest.approx(0.05, abs=1e-3)


def test_the_path_is_straight() -> None:
    world = PickWorld(0, cubes=1)
    start, goal = HOME_GRIPPER[:3, 3], np.array([0.40, 0.10, 0.25])
    belief = world.initial_belief()
    along = (goal - start) / np.linalg.norm(goal - start)
    for _ in range(20):
        belief = after(world, belief, command(gripper_down(goal), 0.08, 0.25), 1)
        off = gripper_at(belief["joints"])[:3, 3] - start
        assert np.linalg.norm(off - (off @ along) * along) < 0.004


WAYS = [((177.0, 0.03), (-87.0, 0.03)), ((-87.0, 0.03), (177.0, 0.13)), ((177.0, 0.13), (0.0, 0.03))]


@pytest.mark.parametrize(("start", "goal"), WAYS)
def test_the_wrist_turns_round_the_other_way_where_its_end_is_in_between(
    start: tuple[float, float], goal: tuple[float, float]
) -> None:
    """Of the first two ways the shortest turn leads through the end of the last joint."""
    world = PickWorld()
    poses = [gripper_down(np.array([0.46, y, 0.25]), np.radians(degrees)) for degrees, y in (start, goal)]
    belief = after(world, world.initial_belief(), command(poses[0], WIDEST_M, 0.4), 80)
    assert pose_error(gripper_at(belief["joints"]), poses[0])[0] < 0.002
    for _ in range(150):
        belief = after(world, belief, command(poses[1], WIDEST_M, 0.4), 1)
        assert np.linalg.norm(gripper_at(belief["joints"])[:3, 3] - belief["setpoint"][:3, 3]) < 0.02
    assert pose_error(gripper_at(belief["joints"]), poses[1])[0] < 0.002
    assert pose_error(gripper_at(belief["joints"]), poses[1])[1] < 0.01


def test_where_it_cannot_come_the_arm_stays_and_comes_back() -> None:
    world = PickWorld()
    start = gripper_down(np.array([0.50, 0.0, 0.25]))
    belief = after(world, world.initial_belief(), command(start, WIDEST_M, 0.4), 60)
    away = command(gripper_down(np.array([1.20, 0.0, 0.25])), WIDEST_M, 0.4)
    for _ in range(100):
        belief = after(world, belief, away, 1)
        assert np.linalg.norm(gripper_at(belief["joints"])[:3, 3] - belief["setpoint"][:3, 3]) < 0.04
    assert 0.6 < belief["setpoint"][0, 3] < 1.0
    assert pose_error(after(world, belief, away, 5)["setpoint"], belief["setpoint"])[0] < 0.02
    back = after(world, belief, command(start, WIDEST_M, 0.4), 80)
    assert pose_error(gripper_at(back["joints"]), start)[0] < 0.002


def test_without_a_command_the_arm_stays() -> None:
    world = PickWorld(0, cubes=1)
    belief = world.initial_belief()
    assert world.policies()[world.select_policy(())](belief) == ()
    for _ in range(5):
        belief = world.predict((), (), belief)
    distance, _ = pose_error(gripper_at(belief["joints"]), HOME_GRIPPER)
    assert distance < 1e-3


def test_what_is_seen_is_a_picture_and_the_hand_and_no_cubes_pose() -> None:
    world = PickWorld(1)
    belief = world.initial_belief()
    (seen,) = picture_and_hand_seen(belief, Tick(seed=SEED))
    assert set(seen) == {"image", "camera", "intrinsics", "frame", "hand"}
    assert set(seen["hand"]) == {"gripper", "width"}
    assert seen["image"].shape == (480, 640, 3)
    assert seen["image"].dtype == np.uint8
    assert seen["hand"]["width"] == pytest.approx(0.08)


def opengl_view(camera: Floats) -> list[float]:
    """OpenGL's view matrix (16,) of world_from_camera: it looks along -z with y up, ours along z with y down."""
    matrix: Floats = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(camera)
    return [float(number) for number in matrix.T.ravel()]


def opengl_lens(intrinsics: Array, size: tuple[int, int], near_m: float = 0.005, far_m: float = 4.0) -> list[float]:
    """OpenGL's projection matrix (16,) of a pinhole camera with its principal point in the middle."""
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * intrinsics[0] / size[0]
    matrix[1, 1] = 2.0 * intrinsics[1] / size[1]
    matrix[2, 2] = -(far_m + near_m) / (far_m - near_m)
    matrix[2, 3] = -2.0 * far_m * near_m / (far_m - near_m)
    matrix[3, 2] = -1.0
    return [float(number) for number in matrix.T.ravel()]


def test_nothing_of_the_arm_is_in_the_cameras_view() -> None:
    """What the pictures leave out is not there to be seen."""
    belief = PickWorld(0, cubes=1).initial_belief()
    scene, size = SceneView(), (320, 240)
    intrinsics = belief["intrinsics"] / 2
    for place in (0.0, 0.02, 0.04):
        open_so_far = {**belief, "fingers": np.full(2, place)}
        _, labels = scene.draw(open_so_far, opengl_view(belief["camera"]), opengl_lens(intrinsics, size), size)
        assert not np.any(labels == scene.arm)
        assert len(np.unique(labels)) >= 3


def test_a_cube_counts_as_grasped_after_two_seconds() -> None:
    world = PickWorld(0, cubes=2)
    belief = world.initial_belief()
    first, second = belief["bodies"]
    for held_s, grasped, finished in ((0.0, 0.0, False), (1.95, 0.0, False), (2.0, 1.0, False), (2.5, 1.0, True)):
        held = {**belief, "bodies": (first, {**second, "held_s": held_s, "lift_m": 0.125})}
        metrics = world.metrics(held)
        assert metrics["grasped"] == grasped
        assert metrics["lift_mm"] == pytest.approx(125.0)
        assert world.finished(held) == finished


def test_the_world_ends_after_its_frames() -> None:
    world = PickWorld(0, cubes=1, frames=2)
    belief = world.initial_belief()
    belief = world.predict((), (), belief)
    assert not world.finished(belief)
    belief = world.predict((), (), belief)
    assert world.finished(belief)
    assert world.time_s(belief, 3) == pytest.approx(0.1)


def test_a_name_of_a_policy_is_a_command() -> None:
    wanted = command(gripper_down((0.4, 0.0, 0.3)), 0.02, 0.1)
    assert PickWorld(0, cubes=1).select_policy((wanted,)) == name_of((wanted,))


def test_the_gripper_is_sooner_where_it_is_sent_if_it_speeds_up_faster() -> None:
    goal = HOME_GRIPPER.copy()
    goal[0, 3] += 0.1
    ways = []
    for acceleration in (0.5, 2.0):
        world = PickWorld(cubes=1, acceleration_m_s2=acceleration)
        belief = world.initial_belief()
        for _ in range(10):
            belief = world.predict((), (command(goal, 0.08, 0.25),), belief)
        ways.append(belief["setpoint"][0, 3] - HOME_GRIPPER[0, 3])
    assert ways[0] < ways[1] - 0.01


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fps": 7}, "fps is 7"),
        ({"frames": 0}, "frames is 0"),
        ({"width": 10}, "width is 10"),
        ({"noise": -1.0}, "noise is -1"),
        ({"scene": -2}, "scene is -2"),
        ({"acceleration_m_s2": 0.0}, "acceleration_m_s2 is 0"),
    ],
)
def test_what_is_out_of_range_is_named(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PickWorld(**options)


def test_where_the_straight_way_ends_at_a_joints_limit_the_arm_goes_by_its_joints_all_the_way() -> None:
    """From here it went by its joints for an interval, then straight back to where it could not go on, for ever."""
    joints = np.array([1.1137, -1.162, -0.267693, -2.40201, 1.77551, 3.69443, -1.10187])
    world, still = PickWorld(0, cubes=1), np.zeros(7)
    begun = {**world.initial_belief(), "joints": joints, "targets": joints, "speeds": still}
    belief = {**begun, "setpoint": gripper_at(joints)}
    wanted, turning = command(HOME_GRIPPER, WIDEST_M, 0.4), []
    for _ in range(100):
        belief = after(world, belief, wanted, 1)
        turning.append(belief["turns"] is not None)
    distance, angle = pose_error(gripper_at(belief["joints"]), HOME_GRIPPER)
    assert distance < 1e-3
    assert angle < np.radians(0.3)
    assert any(turning)
    assert sum(now and not before for before, now in pairwise(turning)) == 1  # it begins once


def test_what_is_to_come_elsewhere_meanwhile_goes_straight_there() -> None:
    world = PickWorld(0, cubes=1)
    begun = {**world.initial_belief(), "turns": gripper_down((0.3, 0.3, 0.4), 1.0)}
    down = HOME_GRIPPER.copy()
    down[2, 3] -= 0.1
    belief, off = begun, []
    for _ in range(40):
        belief = after(world, belief, command(down, WIDEST_M, 0.2), 1)
        off.append(float(np.linalg.norm(belief["setpoint"][:2, 3] - down[:2, 3])))
    assert max(off) < 1e-5
    assert pose_error(gripper_at(belief["joints"]), down)[0] < 1e-3
