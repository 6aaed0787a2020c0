"""Grasps: free, reachable, clear of everything; and boxes that overlap."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.layout import planned
from hierax.nodes.picking.panda import HOME_RAD, joints_for
from hierax.nodes.picking.planning import Boxes, before, choose, overlapping
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose

SEED = 8
SIDE_M = 0.045


def cube(number: int, x: float, y: float, z: float | None = None, yaw_rad: float = 0.0, side_m: float = SIDE_M) -> Any:
    turn = exp_so3(np.array([0.0, 0.0, yaw_rad]))
    pose = make_pose(turn, np.array([x, y, side_m / 2 if z is None else z]))
    return {"id": number, "pose": pose, "size": np.full(3, side_m)}


def gripper(bodies: list[Any], eligible: list[int]) -> Floats:
    grasp = choose(bodies, eligible)
    assert grasp is not None
    body = next(item for item in bodies if item["id"] == grasp.id)
    pose: Floats = body["pose"] @ grasp.box_from_gripper
    return pose


def test_a_lonely_cube_is_taken_from_above_by_two_of_its_sides() -> None:
    body = cube(1, 0.5, 0.1, yaw_rad=0.3)
    pose = gripper([body], [1])
    np.testing.assert_allclose(pose[:3, 2], [0.0, 0.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(pose[:3, 3], body["pose"][:3, 3], atol=1e-9)
    closing = np.abs(body["pose"][:3, :3].T @ pose[:3, 1])
    assert closing.max() == pytest.approx(1.0)


def test_a_neighbour_decides_by_which_sides() -> None:
    """The same cube, with a neighbour close to one pair of its sides and then to the other."""
    body = cube(1, 0.5, 0.0)
    for beside, axis in (((0.5, SIDE_M + 0.012), 0), ((0.5 + SIDE_M + 0.012, 0.0), 1)):
        pose = gripper([body, cube(2, *beside)], [1])
        assert abs(pose[axis, 1]) == pytest.approx(1.0)


def test_a_cube_between_others_on_all_sides_is_not_free() -> None:
    far = SIDE_M + 0.010
    around = [(0.5 + far, 0.0), (0.5 - far, 0.0), (0.5, far), (0.5, -far)]
    bodies = [cube(1, 0.5, 0.0), *(cube(number, x, y) for number, (x, y) in enumerate(around, start=2))]
    assert choose(bodies, [1]) is None
    assert choose(bodies, [1, 2, 3, 4, 5]) is not None


def test_of_a_stack_only_the_top_is_free() -> None:
    bodies = [cube(1, 0.5, 0.0), cube(2, 0.503, 0.002, z=1.5 * SIDE_M, yaw_rad=0.5)]
    assert choose(bodies, [1]) is None
    grasp = choose(bodies, [1, 2])
    assert grasp is not None
    assert grasp.id == 2


def test_where_there_is_no_way_from_above_it_comes_from_the_side() -> None:
    """A beam hangs over the cube, which stands high enough for the hand to come from beside it."""
    body = cube(1, 0.5, 0.0, z=0.10, side_m=0.04)
    beam = {**cube(2, 0.5, 0.0, z=0.27), "size": np.array([0.06, 0.06, 0.20])}
    pose = gripper([body, beam], [1])
    assert pose[2, 2] > -0.9


def test_what_is_out_of_reach_or_too_wide_is_not_taken() -> None:
    assert choose([cube(1, 1.1, 0.0)], [1]) is None
    assert choose([cube(1, 0.5, 0.0, side_m=0.07)], [1]) is None


def test_only_what_may_be_taken_is_taken() -> None:
    bodies = [cube(1, 0.5, -0.1), cube(2, 0.5, 0.1)]
    for eligible in ([1], [2]):
        grasp = choose(bodies, eligible)
        assert grasp is not None
        assert [grasp.id] == eligible
    assert choose(bodies, []) is None


def test_every_scene_has_a_grasp_whose_approach_is_reached() -> None:
    for scene in range(4):
        bodies = [{"id": place.id, "pose": place.pose, "size": np.full(3, place.side_m)} for place in planned(scene)]
        pose = gripper(bodies, [1, 2, 3, 4, 5])
        joints, off = joints_for(before(pose), HOME_RAD, 200)
        assert off < 1e-3, f"scene {scene}"
        assert joints_for(pose, joints, 200)[1] < 1e-3, f"scene {scene}"


def test_boxes_overlap_exactly_when_no_plane_separates_them() -> None:
    """Against points: one of the first box in the second proves an overlap; far centres prove there is none."""
    rng = np.random.default_rng(SEED)
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 9)] * 3), axis=-1).reshape(-1, 3)
    verdicts = {True: 0, False: 0}
    for _ in range(300):
        axes = np.stack([exp_so3(rng.uniform(-3.0, 3.0, 3)) for _ in range(2)])
        halves = rng.uniform(0.2, 1.0, (2, 3))
        centres = np.stack((np.zeros(3), rng.uniform(-1.6, 1.6, 3)))
        first, second = (Boxes(centres[i : i + 1], axes[i : i + 1], halves[i : i + 1]) for i in (0, 1))
        found = bool(overlapping(first, second, 0)[0])
        assert found == bool(overlapping(second, first, 0)[0])
        points = grid * halves[0] @ axes[0].T
        local = (points - centres[1]) @ axes[1]
        if np.any(np.all(np.abs(local) <= halves[1], axis=1)):
            assert found, f"seed {SEED}"
        elif np.linalg.norm(centres[1]) > np.linalg.norm(halves[0]) + np.linalg.norm(halves[1]):
            assert not found, f"seed {SEED}"
        verdicts[found] += 1
    assert min(verdicts.values()) > 30


def test_boxes_apart_by_little_are_apart() -> None:
    one = Boxes(np.zeros((1, 3)), np.eye(3)[None], np.full((1, 3), 0.5))
    for gap, touching in ((0.001, False), (-0.001, True)):
        turned = exp_so3(np.array([0.0, 0.0, np.pi / 4]))
        other = Boxes(np.array([[0.5 + 0.5 * 2**0.5 + gap, 0.0, 0.0]]), turned[None], np.full((1, 3), 0.5))
        assert bool(overlapping(one, other, 0)[0]) == touching
