"""The straight way of a gripper from one pose to another, on which it turns as evenly as it moves."""

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, exp_so3, log_so3, make_pose

WIDE_RAD = 1.0  # what turns less comes from no side of the wrist's end to the other
_TURN_M_RAD = 0.2  # a turn of a radian takes as long as a move of this


def length_m(start: Floats, goal: Floats) -> float:
    """How long the way is; one that is mostly a turn as long as a move that takes the same time."""
    return _length_m(*_way(start, goal))


def along(start: Floats, goal: Floats, step_m: float) -> Floats:
    """The pose so far along the way; the goal, where that is no farther."""
    shift, turn = _way(start, goal)
    left = _length_m(shift, turn)
    if left <= step_m or left < 1e-6:
        return goal
    part = step_m / left
    return make_pose(exp_so3(part * turn) @ start[:3, :3], start[:3, 3] + part * shift)


def _way(start: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """By how much it moves, m, and turns, rad."""
    return goal[:3, 3] - start[:3, 3], log_so3(goal[:3, :3] @ start[:3, :3].T)


def _length_m(shift: Floats, turn: Floats) -> float:
    return max(float(np.linalg.norm(shift)), _TURN_M_RAD * float(np.linalg.norm(turn)))
