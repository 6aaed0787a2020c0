"""The tracking nodes between world and grasp node: what they know, what they hand up and down."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.commands import command
from hierax.nodes.picking.layout import SIDES_M, guessed
from hierax.nodes.picking.panda import HOME_RAD, camera_of, gripper_at, gripper_down
from hierax.nodes.picking.tracker import arm, poses_and_hand_seen, read_scene, scene_known, spatial
from hierax.nodes.picking.world import PickWorld, picture_and_hand_seen
from hierax.nodes.tracking.math.geometry import exp_se3, invert
from hierax.nodes.tracking.schema import TABLE
from hierax.runtime import Tick

SEED = 2
SCENE = 2
CUBES = 3
GRIPPER = gripper_at(HOME_RAD)


def seen(belief: Any) -> Any:
    return picture_and_hand_seen(belief, Tick(seed=SEED, epoch=belief["frame"] + 1))


def hand(pose: Any, width: float = 0.05) -> Any:
    return {"gripper": pose, "width": width}


def test_both_begin_with_the_guess() -> None:
    objects = arm(SCENE, CUBES).initial_belief()["objects"]
    bodies = spatial(SCENE, CUBES).initial_belief()["bodies"]
    for item, body, guess, side in zip(objects, bodies, guessed(SCENE, CUBES), SIDES_M, strict=False):
        np.testing.assert_allclose(camera_of(GRIPPER) @ item["pose"], guess, atol=1e-12)
        np.testing.assert_allclose(body["pose"], guess, atol=1e-12)
        np.testing.assert_allclose(np.ptp(body["model"]["vertices"], axis=0), side)
        assert "model" not in item


def test_the_hand_goes_up() -> None:
    node, above = arm(SCENE, CUBES), spatial(SCENE, CUBES)
    assert poses_and_hand_seen(node.initial_belief()) == ()
    assert scene_known(above.initial_belief()) == ()
    belief = node.observe(seen(PickWorld(SCENE, CUBES).initial_belief()), node.initial_belief())
    up = poses_and_hand_seen(belief)
    assert up[-1]["hand"]["width"] == pytest.approx(0.08)
    known = scene_known(above.observe(up, above.initial_belief(), Tick(time_s=0.0)))
    np.testing.assert_allclose(known[-1]["hand"]["gripper"], GRIPPER, atol=0.01)
    assert [item["id"] for item in known[:-1]] == [1, 2, 3]
    np.testing.assert_allclose(known[0]["size"], SIDES_M[0])


def test_without_observations_nothing_changes() -> None:
    node, above = arm(SCENE, CUBES), spatial(SCENE, CUBES)
    assert node.observe((), node.initial_belief())["hand"] is None
    assert above.observe((), above.initial_belief())["hand"] is None


def test_the_arm_turns_a_command_by_what_it_knows_of_its_camera() -> None:
    """A camera that is thought to be elsewhere moves everything seen, hand and command included, alike."""
    node = arm(SCENE, CUBES)
    off = exp_se3(np.array([0.004, -0.003, 0.002, 0.0, 0.01, 0.02]))
    felt = {**node.initial_belief(), "joints_from_camera": invert(off)}
    wanted = command(off @ gripper_down((0.5, 0.0, 0.1)), 0.03, 0.2)
    (action,) = node.policies()[node.select_policy((wanted,))](felt)
    np.testing.assert_allclose(action["gripper"], gripper_down((0.5, 0.0, 0.1)), atol=1e-9)
    assert (action["width"], action["speed"]) == (0.03, 0.2)
    (first,) = node.policies()[node.select_policy((wanted,))](node.initial_belief())
    np.testing.assert_allclose(first["gripper"], wanted["gripper"], atol=1e-9)


def test_the_hand_is_said_to_be_where_the_camera_would_have_it() -> None:
    node = arm(SCENE, CUBES)
    world = PickWorld(SCENE, CUBES)
    belief, truth = node.initial_belief(), world.initial_belief()
    for _ in range(3):
        belief = node.predict((), (), node.observe(seen(truth), belief))
        gripper = poses_and_hand_seen(belief)[-1]["hand"]["gripper"]
        np.testing.assert_allclose(camera_of(gripper), belief["camera"], atol=1e-9)
        truth = world.predict((), (), truth)


@pytest.mark.parametrize(("width", "kept"), [(0.0, True), (0.05, False)])
def test_while_the_hand_grips_the_correction_stays(width: float, kept: bool) -> None:
    node = arm(SCENE, CUBES)
    first = exp_se3(np.array([0.003, 0.0, 0.0, 0.0, 0.0, 0.0]))
    asked = node.predict((), (command(GRIPPER, width, 0.1),), node.initial_belief())
    felt = node.observe(seen(PickWorld(SCENE, CUBES).initial_belief()), {**asked, "joints_from_camera": first})
    assert np.array_equal(felt["joints_from_camera"], first) == kept
    assert felt["grips"] == kept


def test_what_is_held_goes_on_as_the_hand_went() -> None:
    node = spatial(SCENE, CUBES)
    moved = GRIPPER.copy()
    moved[2, 3] += 0.004
    raised = tuple({**body, "pose": _raised(body["pose"], 0.1)} for body in node.initial_belief()["bodies"])
    belief = {**node.initial_belief(), "bodies": raised, "hand": hand(moved), "hand_before": hand(GRIPPER)}
    after = node.predict(({"held": 2},), (), belief)
    heights = [body["pose"][2, 3] - before["pose"][2, 3] for body, before in zip(after["bodies"], raised, strict=True)]
    assert heights[1] == pytest.approx(0.004)
    assert heights[0] < 0.0
    assert heights[2] < 0.0
    np.testing.assert_array_equal(after["bodies"][1]["velocity"], np.zeros(6))


@pytest.mark.parametrize(("left_m", "goes_m"), [(0.05, 0.004), (0.003, 0.003), (0.0, 0.0)])
def test_what_is_held_goes_no_farther_than_the_hand_is_commanded(left_m: float, goes_m: float) -> None:
    """Up, by what is left of the way, while the hand went sideways."""
    node = spatial(SCENE, CUBES)
    moved = GRIPPER.copy()
    moved[1, 3] += 0.004
    goal = moved.copy()
    goal[2, 3] += left_m
    belief = {**node.initial_belief(), "hand": hand(moved), "hand_before": hand(GRIPPER)}
    actions = node.policies()[node.select_policy((command(goal, 0.0, 0.1),))](belief)
    after = node.predict(({"held": 2},), actions, belief)
    gone = after["bodies"][1]["pose"] - belief["bodies"][1]["pose"]
    np.testing.assert_allclose(gone[:3, 3], [0.0, 0.0, goes_m], atol=1e-9)


def test_who_carries_whom_goes_up() -> None:
    node = spatial(SCENE, CUBES)
    belief = {**node.initial_belief(), "hand": hand(GRIPPER), "interval_s": 0.05}
    places = {number: body["pose"].copy() for number, body in enumerate(belief["bodies"], start=1)}
    places[2][:3, 3] = places[1][:3, 3] + [0.0, 0.0, (SIDES_M[0] + SIDES_M[1]) / 2]
    places[3][2, 3] += 0.2
    bodies = tuple({**body, "pose": places[body["id"]]} for body in belief["bodies"])
    told = read_scene(scene_known(node.predict((), (), {**belief, "bodies": bodies})))
    assert told.carried == ((1, TABLE), (2, 1))
    assert [body["id"] for body in told.bodies] == [1, 2, 3]


def test_nothing_is_held_without_context() -> None:
    node = spatial(SCENE, CUBES)
    belief = {**node.initial_belief(), "hand": hand(GRIPPER), "hand_before": hand(_raised(GRIPPER, 0.1))}
    for context in ((), ({"held": None},)):
        after = node.predict(context, (), belief)
        for body, before in zip(after["bodies"], belief["bodies"], strict=True):
            assert abs(body["pose"][2, 3] - before["pose"][2, 3]) < 0.01


def test_no_true_pose_is_in_what_the_nodes_are_given_or_believe() -> None:
    truth = PickWorld(SCENE, CUBES).initial_belief()
    node, above = arm(SCENE, CUBES), spatial(SCENE, CUBES)
    felt = node.observe(seen(truth), node.initial_belief())
    known = above.observe(poses_and_hand_seen(felt), above.initial_belief(), Tick(time_s=0.0))
    camera_from_world = invert(truth["camera"])
    true = [pose for body in truth["bodies"] for pose in (body["pose"], camera_from_world @ body["pose"])]
    for where, value in (("seen", seen(truth)), ("arm", felt), ("spatial", known), ("up", scene_known(known))):
        for matrix in _poses(value):
            nearest = min(float(np.abs(matrix - pose).max()) for pose in true)
            assert nearest > 1e-6, where
    assert len(list(_poses(truth))) > len(true) / 2


def _poses(value: Any) -> Iterator[Any]:
    if isinstance(value, np.ndarray):
        if value.shape == (4, 4):
            yield value
        return
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, (tuple, list)):
        for part in value:
            yield from _poses(part)


def _raised(pose: Any, by_m: float) -> Any:
    raised = pose.copy()
    raised[2, 3] += by_m
    return raised
