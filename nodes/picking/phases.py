"""What the phases of a grasp have in common: when one begins and ends, and what they wait for.

A belief here has ``phase`` and ``since_s`` (when it began), ``steady_s`` (since when what the phase waits for holds;
None while it does not), ``bodies`` and ``hand`` (see `hierax.nodes.picking.tracker.scene_known`), ``target`` (id of a
cube), ``box_from_gripper`` and ``box_width`` (m) of the chosen grasp, ``gripper`` (world_from_gripper there) and
``width`` (m, between the fingers, when they were last looked at)."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hierax.nodes.picking.planning import before
from hierax.nodes.tracking.math.geometry import Floats, pose_error
from hierax.runtime import Value

WATCH, APPROACH, DESCEND, CLOSE = "watch", "approach", "descend", "close"
LIFT, HOLD, RETREAT = "lift", "hold", "retreat"

# How fast the gripper goes while there is room, and beside the cube.
FAST_M_S, SLOW_M_S = 0.25, 0.08
# How long the camera looks before a grasp is chosen, the gripper stays above the cube, and the fingers stand still.
LOOK_S, AIM_S, STILL_S = 1.0, 0.4, 0.25
PATIENCE_S = 5.0  # how long a phase may take that waits for something
SURE_M = 0.003  # a cube's place is known as well as this, or it is not taken
NEAR_M, NEAR_RAD = 0.004, np.radians(2.0)  # the gripper is where it should be when it is as near as this
STILL_M = 0.0005  # fingers that move less in an epoch stand still
THINNER_M = 0.008  # fingers that are nearer to one another than the cube is wide, less this, have lost it


def entered(belief: Value, phase: str, time_s: float) -> Value:
    """The belief in another phase, which begins now."""
    return {**belief, "phase": phase, "since_s": time_s, "steady_s": None}


def is_late(belief: Value, time_s: float) -> bool:
    """Whether a phase takes longer than it may."""
    return bool(time_s - belief["since_s"] >= PATIENCE_S)


def unless_late(belief: Value, time_s: float) -> Value:
    """The same, or, where the phase takes too long, back."""
    return entered(belief, RETREAT, time_s) if is_late(belief, time_s) else belief


def steadied(belief: Value, holds: bool, time_s: float) -> Value:
    """The belief with the time since which a condition holds without a break."""
    since = belief["steady_s"] if belief["steady_s"] is not None else time_s
    return {**belief, "steady_s": since if holds else None}


def is_steady(belief: Value, time_s: float, long_s: float) -> bool:
    """Whether what the phase waits for has held for so long."""
    return belief["steady_s"] is not None and time_s - belief["steady_s"] >= long_s - 1e-9


def is_sure(body: Mapping[str, Any]) -> bool:
    """Whether a body is tracked, and its place known well enough to take it."""
    variance = float(np.trace(body["covariance"][:3, :3]))
    return body["status"] == "tracked" and variance < SURE_M**2


def aimed(belief: Value) -> Value:
    """The grasp where the target is now; where it was, if it is not tracked."""
    target = next(body for body in belief["bodies"] if body["id"] == belief["target"])
    if belief["gripper"] is not None and not is_sure(target):
        return belief
    return {**belief, "gripper": target["pose"] @ belief["box_from_gripper"]}


After = Callable[[Value, float], Value]
"""What becomes of a belief by the time: the same phase goes on, or another one begins."""


def after_approach(belief: Value, time_s: float, late: After = unless_late) -> Value:
    """The grasp follows the cube as long as that is tracked; then down, when the gripper is above it."""
    belief = aimed(belief)
    belief = steadied(belief, has_reached(belief, before(belief["gripper"])), time_s)
    return entered(belief, DESCEND, time_s) if is_steady(belief, time_s, AIM_S) else late(belief, time_s)


def after_descend(belief: Value, time_s: float, late: After = unless_late) -> Value:
    """Where the cube was seen last is where it is taken: so near it is at the border of the view."""
    return entered(belief, CLOSE, time_s) if has_reached(belief, belief["gripper"]) else late(belief, time_s)


def after_close(belief: Value, time_s: float) -> Value:
    """The fingers stand still: on the cube, or on one another."""
    width = belief["hand"]["width"]
    belief = {**steadied(belief, abs(width - belief["width"]) < STILL_M, time_s), "width": width}
    if not is_steady(belief, time_s, STILL_S):
        return unless_late(belief, time_s)
    return entered(belief, LIFT if is_filled(belief) else RETREAT, time_s)


def has_reached(belief: Value, gripper: Floats) -> bool:
    """Whether the gripper is where it should be."""
    distance, angle = pose_error(belief["hand"]["gripper"], gripper)
    return distance < NEAR_M and angle < NEAR_RAD


def is_filled(belief: Value) -> bool:
    """Whether something as wide as the target is between the fingers."""
    return bool(belief["hand"]["width"] > belief["box_width"] - THINNER_M)
