"""Which cube is taken first, so that another one can be moved: that one, one that is in the fingers' way, or the one
that it is to come onto, where the camera would not see it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.panda import FOCAL_LENGTH, HOME_GRIPPER, camera_of
from hierax.nodes.picking.phases import is_sure
from hierax.nodes.picking.planning import Grasp, choose
from hierax.nodes.tower.placing import half_height
from hierax.nodes.tower.rules import Step
from hierax.nodes.tracking.math.geometry import Floats, invert, transform
from hierax.nodes.tracking.schema import TABLE

_NEAR_M = 0.12  # so near, as seen from above, a cube may be in the way of the hand that takes another one
_LYING_M = 0.01  # so much higher than if it stood on the table, a cube may seem to be
_CAMERA_FROM_WORLD = invert(camera_of(HOME_GRIPPER))


class Reach(NamedTuple):
    """What is taken, and what for."""

    grasp: Grasp
    goal: Step  # the one that was asked for, or that another cube comes onto the table first


def reach(
    bodies: Sequence[Mapping[str, Any]],
    goal: Step,
    tried: Sequence[tuple[int, Floats]] = (),
    cleared: Sequence[tuple[int, int]] = (),
) -> Reach | None:
    """How a goal is begun; None: its cube is not seen well enough, or not to be taken, nor any one that is in the way.

    Args: bodies: as `hierax.nodes.picking.tracker.scene_known` tells them; tried: ids of cubes, each with a
        box_from_gripper that the hand did not come to, which is not chosen again before all others were; cleared: ids
        of cubes, each with that of one that was moved aside for it, and is not again."""
    sure = {body["id"]: body for body in bodies if is_sure(body)}
    number, onto = goal
    if number not in sure:
        return None
    if onto in sure and (number, onto) not in cleared and _puts_out_of_sight(sure[onto]):
        grasp = choose(bodies, [onto])
        if grasp is not None:
            return Reach(grasp, (onto, TABLE))
    failed = [box_from_gripper for other, box_from_gripper in tried if other == number]
    grasp = choose(bodies, [number], failed) or (choose(bodies, [number]) if failed else None)
    if grasp is not None:
        return Reach(grasp, goal)
    away = {other: body["pose"][:3, 3] - sure[number]["pose"][:3, 3] for other, body in sure.items()}
    near = [other for other in sure if other != number and float(np.linalg.norm(away[other][:2])) < _NEAR_M]
    if not near or choose([body for body in bodies if body["id"] not in near], [number]) is None:
        return None  # something else is in the way
    near = [other for other in near if (number, other) not in cleared]
    # What it comes onto stays if it can; one that makes room by itself is better than one of several.
    near.sort(key=lambda other: (not _is_free(bodies, number, other), other == onto, np.linalg.norm(away[other])))
    grasps = ((other, choose(bodies, [other])) for other in near)
    return next((Reach(grasp, (other, TABLE)) for other, grasp in grasps if grasp is not None), None)


def _is_free(bodies: Sequence[Mapping[str, Any]], number: int, without: int) -> bool:
    """Whether a cube is to be taken where another one is gone."""
    return choose([body for body in bodies if body["id"] != without], [number]) is not None


def _puts_out_of_sight(lower: Mapping[str, Any]) -> bool:
    """Whether a cube on the table is so far aside that one on it would not be seen from home: its middle would be
    beside the picture."""
    height, pose = half_height(lower), lower["pose"]
    x, _, z = transform(_CAMERA_FROM_WORLD, pose[:3, 3] + [0.0, 0.0, 2.0 * height])
    return bool(pose[2, 3] < height + _LYING_M and abs(x) * FOCAL_LENGTH > 0.5 * z)
