"""Where a parallel-jaw gripper can take a box: by two opposite faces, reachable, without touching anything else."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.picking.panda import HOME_GRIPPER, HOME_RAD, WIDEST_M, joints_for
from hierax.nodes.tracking.math.geometry import Floats, invert, make_pose, pose_error, transform

APPROACH_M = 0.10  # how far before the grasp the gripper begins to approach it in a straight line
CLEARANCES_M = (0.006, 0.003)  # how far the gripper keeps off everything; less only where there is no grasp with more
OPENING_M = 0.022  # how much wider than the box the gripper is while it approaches
_TILTS_RAD = np.radians([0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0])
_LEVEL = 0.2
_FINGERS_M = 0.037
_STAGES = 4
_RAISES_M = (0.015, 0.040)
_SHRUNK_M = 0.005
_REACHED = 1e-3
_TURN_COST = 0.3
_SLIDE_COST = 2.0
_ALIKE_M, _ALIKE_RAD = 0.002, np.radians(2.0)


class Boxes(NamedTuple):
    """Boxes in space: centres (n, 3), axes (n, 3, 3) in columns, halves of their lengths (n, 3); metres."""

    centres: Floats
    axes: Floats
    halves: Floats


class Grasp(NamedTuple):
    """A way to take a box."""

    id: int  # of the box
    box_from_gripper: Floats  # the gripper's pose when it closes
    width_m: float  # between the faces that it takes


def choose(bodies: Sequence[Mapping[str, Any]], eligible: Sequence[int], tried: Sequence[Floats] = ()) -> Grasp | None:
    """The easiest grasp of any eligible box, by id; None where there is none. Of the bodies, {"id", "pose":
    world_from_box, "size": (3,) m}, all are told; the table is z = 0. From above is easier than from the side, little
    turning is easier than much. A grasp is possible where nothing lies on the box, hand and camera keep clear of all
    boxes and of the table all along the approach, and the arm reaches both ends of it. One whose box_from_gripper was
    tried is none."""
    poses, halves = (np.stack([body[name] for body in bodies]) for name in ("pose", "size"))
    boxes = Boxes(poses[:, :3, 3], poses[:, :3, :3], halves / 2)
    free = [index for index, body in enumerate(bodies) if body["id"] in eligible and _uncovered(boxes, index)]
    found = [(cost, grasp, pose) for index in free for cost, grasp, pose in _candidates(bodies[index])]
    found = [each for each in found if not any(is_alike(each[1].box_from_gripper, other) for other in tried)]
    found.sort(key=lambda item: item[0])
    reached: dict[int, bool] = {}
    for clearance_m in CLEARANCES_M:
        for index, (_, grasp, pose) in enumerate(found):
            if not clear(pose, grasp.width_m + OPENING_M, boxes, clearance_m):
                continue
            if index not in reached:
                reached[index] = joints_at(pose) is not None
            if reached[index]:
                return grasp
    return None


def is_alike(first: Floats, second: Floats) -> bool:
    """Whether two poses of the gripper are one, in whatever frame, but for how well the box is known."""
    distance_m, angle_rad = pose_error(first, second)
    return distance_m < _ALIKE_M and angle_rad < _ALIKE_RAD


def before(gripper: Floats, back_m: float = APPROACH_M) -> Floats:
    """The gripper's pose so far before another one, against the direction of approach."""
    pose: Floats = gripper.copy()
    pose[:3, 3] -= back_m * gripper[:3, 2]
    return pose


def clear(gripper: Floats, width_m: float, boxes: Boxes, clearance_m: float) -> bool:
    """Whether hand and camera keep so far off all boxes, what is to be taken included, and off the table on the whole
    approach to world_from_gripper, the gripper being so wide open."""
    hand = _hand(width_m)
    stages = [before(gripper, back) for back in np.linspace(0.0, APPROACH_M, _STAGES)]
    placed = Boxes(
        np.concatenate([transform(pose, hand.centres) for pose in stages]),
        np.concatenate([pose[:3, :3] @ hand.axes for pose in stages]),
        np.concatenate([hand.halves + clearance_m] * _STAGES),
    )
    lowest = placed.centres[:, 2] - np.einsum("nk,nk->n", np.abs(placed.axes[:, 2, :]), placed.halves)
    if float(lowest.min()) < 0.0:
        return False
    return not any(overlapping(placed, boxes, index).any() for index in range(len(boxes.centres)))


def overlapping(first: Boxes, second: Boxes, index: int) -> NDArray[np.bool_]:
    """Which of the first boxes overlap one of the second, (n,) bool: none of the 15 axes separates them. The axes are
    the faces' normals of both and the cross products of their edges (Gottschalk, Lin and Manocha, OBBTree, 1996)."""
    between = second.centres[index] - first.centres
    mine = first.axes.transpose(0, 2, 1)
    theirs = np.broadcast_to(second.axes[index].T, mine.shape)
    crossed = np.cross(mine[:, :, None], theirs[:, None]).reshape(-1, 9, 3)
    axes = np.concatenate((mine, theirs, crossed), axis=1)
    reach = np.einsum("nij,nj->ni", np.abs(axes @ first.axes), first.halves)
    reach += np.abs(axes @ second.axes[index]) @ second.halves[index] + 1e-9  # of edges that run alike no axis is left
    return np.asarray((np.abs(np.einsum("nij,nj->ni", axes, between)) <= reach).all(axis=1))


def _uncovered(boxes: Boxes, index: int) -> bool:
    """Whether nothing is in the way of a box upwards."""
    count = len(_RAISES_M)
    raises = np.outer(_RAISES_M, [0.0, 0.0, 1.0])
    alike = (np.repeat(part[index][None], count, axis=0) for part in (boxes.axes, boxes.halves - _SHRUNK_M))
    raised = Boxes(boxes.centres[index] + raises, *alike)
    others = [other for other in range(len(boxes.centres)) if other != index]
    return not any(overlapping(raised, boxes, other).any() for other in others)


def _candidates(body: Mapping[str, Any]) -> list[tuple[float, Grasp, Floats]]:
    """All grasps of a box that closes from the sides: cost, grasp, and world_from_gripper."""
    pose, half = body["pose"], np.asarray(body["size"]) / 2
    down = np.array([0.0, 0.0, -1.0])
    found = []
    for axis in range(3):
        width = 2.0 * float(half[axis])
        if abs(pose[2, axis]) > _LEVEL or width + OPENING_M > WIDEST_M:
            continue
        for sign in (1.0, -1.0):
            closing = sign * pose[:3, axis]
            # Straight down, as far as the faces that it takes stand upright.
            first = down - (down @ closing) * closing
            first /= np.linalg.norm(first)
            second = np.cross(closing, first)
            for tilt in _TILTS_RAD:
                approach = np.cos(tilt) * first + np.sin(tilt) * second
                depth = float(np.abs(approach @ pose[:3, :3]) @ half)
                # The palm stays before the box.
                slide = max(0.0, depth + 2 * CLEARANCES_M[0] - _FINGERS_M)
                rotation = np.stack((np.cross(closing, approach), closing, approach), axis=1)
                gripper = make_pose(rotation, pose[:3, 3] - slide * approach)
                turn = float(np.arccos(np.clip(rotation[:, 0] @ HOME_GRIPPER[:3, 0], -1.0, 1.0)))
                cost = abs(tilt) + _TURN_COST * turn + _SLIDE_COST * slide / _FINGERS_M
                found.append((cost, Grasp(body["id"], invert(pose) @ gripper, width), gripper))
    return found


def joints_at(gripper: Floats) -> Floats | None:
    """Joint angles (7,) with which the arm comes to a gripper's pose by the one before it; None: it does not."""
    joints, off = joints_for(before(gripper), HOME_RAD)
    if off >= _REACHED:
        return None
    joints, off = joints_for(gripper, joints)
    return joints if off < _REACHED else None


def _hand(width_m: float) -> Boxes:
    """Fingers, hand and camera as boxes in the gripper's frame, a little larger than they are."""
    low_high = [
        ((-0.0325, -0.105, -0.130), (0.0325, 0.105, -_FINGERS_M)),
        ((-0.0980, -0.045, -0.080), (-0.0690, 0.045, -0.052)),
    ]
    for side in (1.0, -1.0):
        for thickness, top, tip in ((0.0265, -0.050, -0.012), (0.0205, -0.012, 0.0095)):
            ends = sorted((side * width_m / 2, side * (width_m / 2 + thickness)))
            low_high.append(((-0.0110, ends[0], top), (0.0110, ends[1], tip)))
    low, high = (np.array([item[end] for item in low_high]) for end in (0, 1))
    return Boxes((low + high) / 2, np.repeat(np.eye(3)[None], len(low), axis=0), (high - low) / 2)
