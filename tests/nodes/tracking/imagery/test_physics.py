"""Rigid bodies: the laws they must follow, and equal results to the bit."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from hierax.nodes.tracking.imagery import physics
from hierax.nodes.tracking.imagery.physics import GRAVITY_M_S2, HULL_DIRECTIONS, Motion, Simulator, Solid
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose, pose_error

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def box(side_m: float = 0.06, friction: float = 0.7) -> Solid:
    return Solid(CORNERS * side_m / 2, 500.0 * side_m**3, friction)


def resting(x: float, z: float, velocity: tuple[float, ...] = (0.0,) * 6, yaw: float = 0.0) -> Motion:
    return Motion(make_pose(exp_so3(np.array([0.0, 0.0, yaw])), np.array([x, 0.0, z])), np.array(velocity))


def test_a_body_falls_as_gravity_has_it() -> None:
    (after,) = Simulator().run([box()], [resting(0.0, 0.5)], 0.1)
    # Symplectic Euler in 24 steps of 1/240 s: g·h²·n(n + 1)/2.
    assert after.pose[2, 3] == pytest.approx(0.5 - GRAVITY_M_S2 / 240**2 * 24 * 25 / 2, abs=1e-4)
    assert after.velocity[2] == pytest.approx(-GRAVITY_M_S2 * 0.1, rel=1e-2)


def test_a_stack_stays_where_it_is() -> None:
    solids, motions = [box(0.08), box(0.06)], [resting(0.0, 0.04), resting(0.005, 0.11, yaw=0.6)]
    simulator, start = Simulator(), [motion.pose for motion in motions]
    for _ in range(60):
        motions = simulator.run(solids, motions, 1 / 30)
    for before, after in zip(start, motions, strict=True):
        distance, angle = pose_error(before, after.pose)
        assert distance < 0.002
        assert angle < np.radians(1.0)


def test_who_carries_whom_is_told_by_the_forces() -> None:
    """A bridge on two boxes, one more that only leans against them from beside, and one that falls."""
    wide = Solid(CORNERS * [0.08, 0.03, 0.03], 0.3)
    solids = [box(), box(), wide, box(), box()]
    places = [(0.0, 0.03), (0.1, 0.03), (0.05, 0.09), (0.1598, 0.03), (0.4, 0.3)]
    simulator = Simulator()
    assert simulator.carried() == []
    simulator.run(solids, [resting(*place) for place in places], 1 / 20)
    assert simulator.carried() == [(0, None), (1, None), (2, 0), (2, 1), (3, None)]
    simulator.run(solids[:1], [resting(0.0, 0.03)], 1 / 20)
    assert simulator.carried() == [(0, None)]
    simulator.run([], [], 1 / 20)
    assert simulator.carried() == []


def test_bodies_that_interpenetrate_are_pushed_apart() -> None:
    solids, motions = [box(), box()], [resting(0.0, 0.03), resting(0.052, 0.03)]
    simulator = Simulator()
    for _ in range(10):
        motions = simulator.run(solids, motions, 1 / 30)
    assert motions[1].pose[0, 3] - motions[0].pose[0, 3] > 0.0585


def test_a_driven_body_reaches_its_velocity_against_friction() -> None:
    (after,) = Simulator().run([box()], [resting(0.0, 0.03)], 0.5, {0: np.array([0.06, 0.0])})
    assert after.pose[0, 3] == pytest.approx(0.03, abs=0.002)


def test_a_driven_body_pushes_what_is_in_its_way() -> None:
    solids, motions = [box(), box()], [resting(0.0, 0.03), resting(0.065, 0.03)]
    first, second = Simulator().run(solids, motions, 0.5, {0: np.array([0.06, 0.0])})
    assert second.pose[0, 3] > 0.07
    assert second.pose[0, 3] - first.pose[0, 3] == pytest.approx(0.06, abs=0.001)


def test_friction_stops_a_sliding_body() -> None:
    (after,) = Simulator().run([box(friction=0.5)], [resting(0.0, 0.03, (0.3, 0.0, 0.0, 0.0, 0.0, 0.0))], 0.5)
    assert after.pose[0, 3] == pytest.approx(0.3**2 / (2 * 0.5 * GRAVITY_M_S2), rel=0.25)
    assert abs(after.velocity[0]) < 0.01


def test_the_object_frame_may_be_anywhere_in_the_body() -> None:
    offset = np.array([0.1, -0.05, 0.02])
    shifted = Solid(CORNERS * 0.03 + offset, 0.1)
    assert shifted.is_box
    spin = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 1.5])
    motion = Motion(make_pose(exp_so3(np.array([0.3, 0.2, 0.1])), np.array([0.0, 0.0, 1.0])), spin)
    (after,) = Simulator().run([shifted], [motion], 0.05)
    (centred,) = Simulator().run(
        [Solid(CORNERS * 0.03, 0.1)],
        [
            Motion(
                make_pose(motion.pose[:3, :3], motion.pose[:3, 3] + motion.pose[:3, :3] @ offset),
                spin + np.concatenate((np.cross(spin[3:], motion.pose[:3, :3] @ offset), np.zeros(3))),
            )
        ],
        0.05,
    )
    np.testing.assert_allclose(after.pose[:3, :3], centred.pose[:3, :3], atol=1e-9)
    np.testing.assert_allclose(after.pose[:3, :3] @ offset + after.pose[:3, 3], centred.pose[:3, 3], atol=1e-9)


def test_a_hull_of_a_large_mesh_is_reduced_and_rests_on_the_table() -> None:
    rng = np.random.default_rng(5)
    directions = rng.standard_normal((4000, 3))
    ball = Solid(0.05 * directions / np.linalg.norm(directions, axis=1)[:, None], 0.2)
    assert len(ball.hull) <= HULL_DIRECTIONS
    assert not ball.is_box
    motions, simulator = [resting(0.0, 0.06)], Simulator()
    for _ in range(30):
        motions = simulator.run([ball], motions, 1 / 30)
    assert motions[0].pose[2, 3] == pytest.approx(0.05, abs=0.003)


def test_equal_to_the_bit_whatever_was_done_before() -> None:
    solids = [box(0.08), box(0.06), box(0.05)]
    motions = [resting(0.0, 0.04), resting(0.005, 0.111, yaw=0.6), resting(0.08, 0.05, (0.1, 0.0, 0.2, 1.0, 2.0, 0.0))]
    used = Simulator()
    used.run(solids[:2], motions[1:], 0.2)
    first = [used.run(solids, motions, 1 / 30), used.run(solids, motions, 1 / 30)]
    fresh = Simulator().run(solids, motions, 1 / 30)
    for run in first:
        for mine, other in zip(run, fresh, strict=True):
            assert mine.pose.tobytes() == other.pose.tobytes()
            assert mine.velocity.tobytes() == other.velocity.tobytes()


def test_nothing_happens_in_no_time() -> None:
    motions = [resting(0.0, 0.5)]
    assert Simulator().run([box()], motions, 0.0) == motions
    assert Simulator().run([], [], 1.0) == []


def test_a_world_that_was_used_long_is_emptied_and_goes_on_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of bodies that are gone pybullet keeps something, and all of their shapes: equal ones share one."""
    monkeypatch.setattr(physics, "MADE_MOST", 7)
    rng = np.random.default_rng(8)
    directions = rng.standard_normal((50, 3))
    ball = Solid(0.03 * directions / np.linalg.norm(directions, axis=1)[:, None], 0.2)
    used, solids = Simulator(), [box(0.08), ball, box(0.08)]
    motions = [resting(0.0, 0.04), resting(0.01, 0.15, yaw=0.6), resting(0.09, 0.05, (0.1, 0.0, 0.2, 1.0, 2.0, 0.0))]
    for _ in range(12):
        after = used.run(solids, motions, 1 / 30)
        for mine, other in zip(after, Simulator().run(solids, motions, 1 / 30), strict=True):
            assert mine.pose.tobytes() == other.pose.tobytes()
            assert mine.velocity.tobytes() == other.velocity.tobytes()
        motions = after
        assert len(used._bullet.shapes) == 3  # box, ball and table
        assert used._bullet.made <= 7 + len(solids)
