"""Where a cube that the hand holds can be put down: on another one, or at a free place of the table."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from hierax.nodes.picking.panda import HOME_RAD, joints_for
from hierax.nodes.picking.planning import CLEARANCES_M, OPENING_M, Boxes, clear, is_alike, joints_at
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose

Body = Mapping[str, Any]

GAP_M = 0.001  # so far above what it will stand on, a cube is let go
# Between the circles around cubes on the table, so that a hand gets between them; less where there is no such place.
ROOMS_M = (0.035, 0.02, 0.005)
_LOW, _HIGH, _STEP_M = (0.38, -0.20), (0.62, 0.20), 0.02  # of the table, what the arm reaches and the camera sees
_QUARTERS = (0.0, np.pi / 2, -np.pi / 2, np.pi)


def place_on(
    held: Body,
    lower: Body,
    bodies: Sequence[Body],
    box_from_gripper: Floats,
    width_m: float,
    found_before: Floats | None = None,
) -> Floats | None:
    """world_from_gripper where a held box stands on the middle of another one, its sides along that one's; None: the
    arm does not reach it, or the hand would touch something.

    Args: held, lower: two of the bodies, as `hierax.nodes.picking.tracker.scene_known` tells them; bodies: all.
        box_from_gripper: how the box is held; width_m: between the fingers; found_before: what was found for them when
        they were seen last: what is like it, the arm reaches."""
    least = least_turn(held["pose"], lower["pose"])
    middle = lower["pose"][:3, 3] + [0.0, 0.0, half_height(lower) + half_height(held) + GAP_M]
    boxes = _boxes([body for body in bodies if body is not held])
    wrist = cache(partial(_wrist, held["pose"] @ box_from_gripper))
    for quarter in _QUARTERS:
        gripper = _turned(held["pose"], least + quarter, middle) @ box_from_gripper
        if _is_clear(gripper, boxes, width_m):
            reached = found_before is not None and is_alike(gripper, found_before)
            if reached or _comes_to(gripper, wrist):
                return gripper
    return None


def place_on_table(held: Body, bodies: Sequence[Body], box_from_gripper: Floats, width_m: float) -> Floats | None:
    """The same at a free place of the table: the nearest to where the box is; None: there is none."""
    others = [body for body in bodies if body is not held]
    circles = [(body["pose"][:2, 3], float(np.linalg.norm(body["size"][:2]))) for body in others]
    boxes, wrist = _boxes(others), cache(partial(_wrist, held["pose"] @ box_from_gripper))
    for spot in free_spots(circles, float(np.linalg.norm(held["size"][:2])), held["pose"][:2, 3]):
        pose = _turned(held["pose"], 0.0, np.array([*spot, half_height(held) + GAP_M]))
        gripper = pose @ box_from_gripper
        if _is_clear(gripper, boxes, width_m) and _comes_to(gripper, wrist):
            return gripper
    return None


def free_spots(circles: Sequence[tuple[Floats, float]], width_m: float, near: Floats | None = None) -> Floats:
    """Places of the table (n, 2) for a circle, away from others, the nearest first; those with little room are last.

    Args: circles: their middles, m, and widths; width_m: of the one for which there is to be room; near: to where."""
    spots = np.stack(np.meshgrid(*(np.arange(*ends, _STEP_M) for ends in zip(_LOW, _HIGH, strict=True))), axis=-1)
    spots = spots.reshape(-1, 2)
    gaps = [np.linalg.norm(spots - middle, axis=1) - (other_m + width_m) / 2 for middle, other_m in circles]
    gap = np.min(gaps, axis=0) if gaps else np.full(len(spots), np.inf)
    away = np.zeros(len(spots)) if near is None else np.linalg.norm(spots - near, axis=1)
    nearest = np.argsort(away, kind="stable")
    room = np.searchsorted(sorted(ROOMS_M), gap[nearest])
    order = np.argsort(-room, kind="stable")
    return np.asarray(spots[nearest[order]][room[order] > 0])


def top_of(bodies: Sequence[Body]) -> float:
    """How high the highest of some bodies is, m; 0 of none."""
    return max((float(body["pose"][2, 3]) + half_height(body) for body in bodies), default=0.0)


def at_height(gripper: Floats, height_m: float) -> Floats:
    """A gripper's pose, not below a height."""
    raised: Floats = gripper.copy()
    raised[2, 3] = max(raised[2, 3], height_m)
    return raised


def _boxes(bodies: Sequence[Body]) -> Boxes:
    poses = [body["pose"] for body in bodies]
    return Boxes(
        np.array([pose[:3, 3] for pose in poses]).reshape(-1, 3),
        np.array([pose[:3, :3] for pose in poses]).reshape(-1, 3, 3),
        np.array([body["size"] for body in bodies]).reshape(-1, 3) / 2,
    )


def _is_clear(gripper: Floats, boxes: Boxes, width_m: float) -> bool:
    """Whether the hand touches nothing where it lets go."""
    return clear(gripper, width_m + OPENING_M, boxes, CLEARANCES_M[-1])


def _wrist(gripper: Floats) -> float:
    """The angle of the last joint, rad, by which the hand is at a pose, come there from home."""
    return float(joints_for(gripper, HOME_RAD)[0][-1])


def _comes_to(gripper: Floats, wrist: Callable[[], float]) -> bool:
    """Whether the arm comes to a gripper's pose: not through the wrist's ends, between which it has less than a whole
    turn, so that the way from one side of them to the other is the long one. `wrist`: its angle now, asked if need be.
    """
    joints = joints_at(gripper)
    return joints is not None and abs(joints[-1] - wrist()) <= np.pi


def _turned(pose: Floats, angle: float, middle: Floats) -> Floats:
    """A pose turned about the vertical, at another place."""
    return make_pose(exp_so3(np.array([0.0, 0.0, angle])) @ pose[:3, :3], middle)


def least_turn(pose: Floats, other: Floats) -> float:
    """By how much a box is turned at least about the vertical, so that its sides are along another one's; rad."""
    return (_yaw(other) - _yaw(pose) + np.pi / 4) % (np.pi / 2) - np.pi / 4


def _yaw(pose: Floats) -> float:
    """How a box is turned about the vertical: the angle of that of its axes that is the most level."""
    axis = pose[:3, int(np.abs(pose[2, :3]).argmin())]
    return float(np.arctan2(axis[1], axis[0]))


def half_height(body: Body) -> float:
    """Half of how high a box is as it lies, m."""
    return 0.5 * float(np.abs(body["pose"][2, :3]) @ body["size"])
