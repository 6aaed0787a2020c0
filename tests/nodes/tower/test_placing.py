"""Where a cube that the hand holds is put down."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.panda import gripper_down
from hierax.nodes.tower.placing import place_on
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, make_pose, pose_error

SIDE_M = 0.05
WIDTH_M = 0.05


def cube(place: tuple[float, float, float], yaw_deg: float) -> dict[str, Any]:
    turn = exp_so3(np.array([0.0, 0.0, np.radians(yaw_deg)]))
    return {"pose": make_pose(turn, np.array(place)), "size": np.full(3, SIDE_M)}


def put(gripper_deg: float, lower_deg: float) -> tuple[Floats, Floats]:
    """Where the gripper is that holds a cube as it points down, turned so far, and where it goes with it."""
    held, lower = cube((0.46, 0.13, 0.25), 0.0), cube((0.46, 0.03, SIDE_M / 2), lower_deg)
    gripper = gripper_down(held["pose"][:3, 3], np.radians(gripper_deg))
    found = place_on(held, lower, [held, lower], invert(held["pose"]) @ gripper, WIDTH_M)
    assert found is not None
    return gripper, found


def turned_deg(before: Floats, after: Floats) -> float:
    turn = after[:3, :3] @ before[:3, :3].T
    return float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))


@pytest.mark.parametrize("lower_deg", [-40.0, 0.0, 30.0])
def test_it_is_turned_as_little_as_its_sides_ask_for(lower_deg: float) -> None:
    gripper, found = put(90.0, lower_deg)
    assert turned_deg(gripper, found) == pytest.approx(lower_deg, abs=0.01)
    assert pose_error(found, make_pose(found[:3, :3], np.array([0.46, 0.03, 1.5 * SIDE_M + 0.001])))[0] < 1e-9


def test_the_wrist_does_not_turn_through_its_end() -> None:
    """Turned by 44 degrees from 170 the hand does not come there; a quarter more it would, but on a way that leads
    through the end of its last joint."""
    gripper, found = put(170.0, 44.0)
    assert turned_deg(gripper, found) == pytest.approx(-46.0, abs=0.01)
