"""What is odd about where cubes are seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.tower.plausible import odd_bodies
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def cube(number: int, side_m: float, place_m: tuple[float, float, float], yaw_deg: float = 0.0) -> dict[str, Any]:
    turn = exp_so3(np.array([0.0, 0.0, np.radians(yaw_deg)]))
    pose = make_pose(turn, np.array(place_m))
    return {"id": number, "status": "tracked", "pose": pose, "model": {"vertices": side_m * CORNERS}}


@pytest.mark.parametrize(("beside_m", "odd"), [(0.0, set()), (0.026, set()), (0.048, {2}), (0.1, {2})])
@pytest.mark.parametrize("yaw_deg", [0.0, 45.0])
def test_what_is_not_over_another_cube_is_not_carried_by_it(beside_m: float, odd: set[int], yaw_deg: float) -> None:
    below, above = cube(1, 0.055, (0.5, 0.0, 0.0275), yaw_deg), cube(2, 0.04, (0.5 + beside_m, 0.0, 0.075))
    assert odd_bodies([below, above]) == odd
