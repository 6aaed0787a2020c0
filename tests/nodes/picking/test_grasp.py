"""The grasp node: its phases, one after the other, and back after failures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.grasp import GraspNode, held_now
from hierax.nodes.picking.panda import HOME_GRIPPER
from hierax.nodes.picking.phases import APPROACH, CLOSE, DESCEND, HOLD, LIFT, RETREAT, WATCH
from hierax.nodes.picking.planning import before
from hierax.nodes.tracking.math.geometry import make_pose
from hierax.runtime import Tick

SIDE_M = 0.045
SURE = np.diag([1e-6] * 3 + [1e-4] * 3)
UNSURE = np.diag([1e-4] * 3 + [1e-2] * 3)


class Obedient:
    """Everything goes as the node wishes, at once; the cube is as wide as the test says."""

    def __init__(self, node: GraspNode | None = None) -> None:
        self.node = node or GraspNode()
        self.belief = self.node.initial_belief()
        self.time_s = 0.0
        self.gripper, self.width = HOME_GRIPPER, 0.08
        self.between_m = SIDE_M
        self.cubes = [self.cube(1, 0.5, 0.0), self.cube(2, 0.45, 0.12)]

    @staticmethod
    def cube(number: int, x: float, y: float, status: str = "tracked", covariance: Any = SURE) -> Any:
        pose = make_pose(np.eye(3), np.array([x, y, SIDE_M / 2]))
        return {"id": number, "pose": pose, "size": np.full(3, SIDE_M), "covariance": covariance, "status": status}

    def epoch(self) -> Any:
        seen = (*self.cubes, {"hand": {"gripper": self.gripper, "width": self.width}, "carried": ()})
        self.belief = self.node.observe(seen, self.belief, Tick(time_s=self.time_s))
        (wish,) = self.node.policies()[self.node.initial_policy](self.belief)
        self.belief = self.node.predict((), (wish,), self.belief)
        self.gripper = wish["gripper"]
        self.width = max(wish["width"], self.between_m)
        self.time_s += 0.05
        return wish

    def until(self, phase: str, epochs: int = 200) -> Any:
        for _ in range(epochs):
            wish = self.epoch()
            if self.belief["phase"] == phase:
                return wish
        raise AssertionError(f"{phase} never came; it is {self.belief['phase']}")


def test_the_phases_follow_one_another() -> None:
    world = Obedient()
    phases = []
    for _ in range(120):
        world.epoch()
        if not phases or phases[-1] != world.belief["phase"]:
            phases.append(world.belief["phase"])
    assert phases == [WATCH, APPROACH, DESCEND, CLOSE, LIFT, HOLD]
    assert world.node.metrics(world.belief)["attempts"] == 1.0


def test_each_phase_asks_for_what_it_needs() -> None:
    world = Obedient()
    np.testing.assert_array_equal(world.until(WATCH)["gripper"], HOME_GRIPPER)
    wish = world.until(APPROACH)
    grasp = world.belief["gripper"]
    np.testing.assert_allclose(wish["gripper"], before(grasp))
    assert wish["width"] > SIDE_M
    fast = wish["speed"]
    wish = world.until(DESCEND)
    np.testing.assert_allclose(wish["gripper"], grasp)
    assert wish["speed"] < fast
    wish = world.until(CLOSE)
    assert wish["width"] == 0.0
    wish = world.until(LIFT)
    assert wish["gripper"][2, 3] - grasp[2, 3] > 0.11
    assert wish["width"] == 0.0
    np.testing.assert_array_equal(world.until(HOLD)["gripper"], wish["gripper"])


def test_it_looks_for_a_while_before_it_chooses() -> None:
    world = Obedient()
    world.until(APPROACH)
    assert world.time_s >= 1.0


def test_only_what_is_tracked_well_is_taken() -> None:
    world = Obedient()
    world.cubes = [Obedient.cube(1, 0.5, 0.0, "expected"), Obedient.cube(2, 0.45, 0.12, covariance=UNSURE)]
    for _ in range(60):
        world.epoch()
    assert world.belief["phase"] == WATCH
    world.cubes[1] = Obedient.cube(2, 0.45, 0.12)
    world.until(APPROACH, 2)
    assert world.belief["target"] == 2


def test_the_wanted_cube_is_taken() -> None:
    for number in (1, 2):
        world = Obedient(GraspNode(target=number))
        world.until(APPROACH)
        assert world.belief["target"] == number


def test_the_approach_follows_the_cube_and_the_descent_does_not() -> None:
    world = Obedient()
    world.until(APPROACH)
    number = world.belief["target"]
    aimed = world.belief["gripper"].copy()
    world.cubes[number - 1]["pose"] = world.cubes[number - 1]["pose"].copy()
    world.cubes[number - 1]["pose"][0, 3] += 0.003
    world.epoch()
    assert world.belief["gripper"][0, 3] - aimed[0, 3] == pytest.approx(0.003)
    world.until(DESCEND)
    aimed = world.belief["gripper"].copy()
    world.cubes[number - 1] = {**world.cubes[number - 1], "pose": np.eye(4), "status": "lost"}
    world.epoch()
    np.testing.assert_array_equal(world.belief["gripper"], aimed)


def test_fingers_that_close_on_nothing_open_again_and_it_tries_anew() -> None:
    world = Obedient()
    world.between_m = 0.0
    world.until(RETREAT)
    assert held_now(world.belief) == ({"held": None},)
    assert world.epoch()["width"] == 0.08
    world.between_m = SIDE_M
    world.until(HOLD)
    assert world.node.metrics(world.belief)["attempts"] == 2.0


@pytest.mark.parametrize("phase", [LIFT, HOLD])
def test_a_cube_that_is_dropped_is_noticed(phase: str) -> None:
    world = Obedient()
    world.until(phase)
    assert held_now(world.belief) == ({"held": world.belief["target"]},)
    world.between_m = 0.0
    world.until(RETREAT, 3)


@pytest.mark.parametrize("phase", [APPROACH, DESCEND])
def test_what_is_never_reached_is_given_up(phase: str) -> None:
    world = Obedient()
    world.until(phase)
    stuck = world.gripper = before(HOME_GRIPPER)
    for _ in range(120):
        world.epoch()
        world.gripper = stuck
        if world.belief["phase"] == RETREAT:
            return
    raise AssertionError(f"it is still in {world.belief['phase']}")


def test_without_observations_it_waits() -> None:
    node = GraspNode()
    belief = node.initial_belief()
    assert node.observe((), belief) is belief
    (wish,) = node.policies()[node.initial_policy](belief)
    np.testing.assert_array_equal(wish["gripper"], HOME_GRIPPER)


@pytest.mark.parametrize(("options", "said"), [({"lift_m": 0.0}, "lift_m is 0"), ({"target": 0}, "target is 0")])
def test_what_is_out_of_range_is_named(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        GraspNode(**options)
