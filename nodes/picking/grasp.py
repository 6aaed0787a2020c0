"""The grasp node: chooses a free cube of those that are tracked, and has the gripper take it and lift it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hierax.nodes.picking.commands import command
from hierax.nodes.picking.panda import HOME_GRIPPER, WIDEST_M
from hierax.nodes.picking.planning import OPENING_M, before, choose
from hierax.nodes.tracking.math.geometry import Floats, pose_error
from hierax.runtime import NO_TICK, Elements, Node, Tick, Value
from hierax.runtime.core.node import Policy

WATCH, APPROACH, DESCEND, CLOSE = "watch", "approach", "descend", "close"
LIFT, HOLD, RETREAT = "lift", "hold", "retreat"

# How fast the gripper goes while there is room, and beside the cube.
_FAST_M_S, _SLOW_M_S = 0.25, 0.08
# How long the camera looks before a grasp is chosen, the gripper stays above the cube, and the fingers stand still.
_LOOK_S, _AIM_S, _STILL_S = 1.0, 0.4, 0.25
_PATIENCE_S = 5.0  # how long a phase may take that waits for something
_SURE_M = 0.003  # a cube's place is known as well as this, or it is not taken
_NEAR_M, _NEAR_RAD = 0.004, np.radians(2.0)  # the gripper is where it should be when it is as near as this
_STILL_M = 0.0005  # fingers that move less in an epoch stand still
_THINNER_M = 0.008  # fingers that are nearer to one another than the cube is wide, less this, have lost it


class GraspNode(Node):
    """Picks up a cube: watch, approach, descend, close, lift, hold; after a failure retreat, and watch again.

    τ takes in what is tracked and says which phase the task has come to; the policy asks for what the phase needs;
    nothing passes in γ. Context for the node below is which cube the hand holds.

    The belief: ``phase`` and ``since_s`` (when it began), ``steady_s`` (since when what the phase waits for holds; None
    while it does not), ``width`` (of the gripper, then), ``bodies`` and ``hand`` as last observed, ``target`` (id of
    the cube, None while watching), ``box_from_gripper`` and ``box_width`` (m) of the chosen grasp, ``gripper``
    (world_from_gripper at the grasp; None while watching) and ``attempts``, how many have begun.

    Args: target: id of the cube to pick up; None for whichever is the easiest. lift_m: how far the cube is lifted.
    Raises ValueError: a number is out of its range."""

    initial_policy = "pick"

    def __init__(self, target: int | None = None, lift_m: float = 0.13) -> None:
        if target is not None and not 1 <= target <= 255:
            raise ValueError(f"target is {target}; expected the id of a cube, 1 to 255, or None")
        if not lift_m > 0.0:
            raise ValueError(f"lift_m is {lift_m}; expected a positive number")
        self._wanted = target
        self._lift_m = float(lift_m)

    def initial_belief(self) -> Value:
        """Watching; nothing is known yet."""
        seen = {"width": WIDEST_M, "bodies": (), "hand": None}
        grasp = dict.fromkeys(("target", "box_from_gripper", "box_width", "gripper"))
        return {"phase": WATCH, "since_s": 0.0, "steady_s": None, **seen, **grasp, "attempts": 0}

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ: the scene as `hierax.nodes.picking.tracker.scene_known` tells it, and the phase that follows."""
        if not observations:
            return belief
        bodies = tuple(item for item in observations if "pose" in item)
        hand = next(item["hand"] for item in observations if "hand" in item)
        seen = {**belief, "bodies": bodies, "hand": hand}
        return getattr(self, f"_after_{seen['phase']}")(seen, tick.time_s)

    def policies(self) -> Mapping[str, Policy]:
        """Π: to pick."""
        return {self.initial_policy: self._wish}

    def _wish(self, belief: Value) -> Elements:
        """The gripper's command in this phase."""
        if belief["phase"] == WATCH:
            return (command(HOME_GRIPPER, WIDEST_M, _FAST_M_S),)
        grasp, opened_m = belief["gripper"], belief["box_width"] + OPENING_M
        wishes = {
            APPROACH: (before(grasp), opened_m, _FAST_M_S),
            DESCEND: (grasp, opened_m, _SLOW_M_S),
            CLOSE: (grasp, 0.0, _SLOW_M_S),
            LIFT: (self._raised(belief), 0.0, _SLOW_M_S),
            HOLD: (self._raised(belief), 0.0, _SLOW_M_S),
            RETREAT: (before(grasp), WIDEST_M, _SLOW_M_S),
        }
        return (command(*wishes[belief["phase"]]),)

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """How many attempts there were, and of which cube (0: none)."""
        return {"attempts": float(belief["attempts"]), "target": float(belief["target"] or 0)}

    def _after_watch(self, belief: Value, time_s: float) -> Value:
        """A grasp is chosen once the tracker has had time for its first errors, the camera being home."""
        belief = _steadied(belief, _reached(belief, HOME_GRIPPER), time_s)
        if not _steady(belief, time_s, _LOOK_S):
            return belief
        sure = [body["id"] for body in belief["bodies"] if _sure(body)]
        chosen = choose(belief["bodies"], [number for number in sure if self._wanted in (None, number)])
        if chosen is None:
            return belief
        target, box_from_gripper, box_width = chosen
        grasp = {"target": target, "box_from_gripper": box_from_gripper, "box_width": box_width}
        return _enter(_aimed({**belief, **grasp, "attempts": belief["attempts"] + 1}), APPROACH, time_s)

    def _after_approach(self, belief: Value, time_s: float) -> Value:
        """The grasp follows the cube as long as that is tracked; then down, when the gripper is above it."""
        belief = _aimed(belief)
        belief = _steadied(belief, _reached(belief, before(belief["gripper"])), time_s)
        return _enter(belief, DESCEND, time_s) if _steady(belief, time_s, _AIM_S) else _unless_late(belief, time_s)

    def _after_descend(self, belief: Value, time_s: float) -> Value:
        """Where the cube was seen last is where it is taken: so near it is at the border of the view."""
        return _enter(belief, CLOSE, time_s) if _reached(belief, belief["gripper"]) else _unless_late(belief, time_s)

    def _after_close(self, belief: Value, time_s: float) -> Value:
        """The fingers stand still: on the cube, or on one another."""
        width = belief["hand"]["width"]
        belief = _steadied(belief, abs(width - belief["width"]) < _STILL_M, time_s)
        belief = {**belief, "width": width}
        if not _steady(belief, time_s, _STILL_S):
            return _unless_late(belief, time_s)
        return _enter(belief, LIFT if _filled(belief) else RETREAT, time_s)

    def _after_lift(self, belief: Value, time_s: float) -> Value:
        """Up, unless the cube is lost on the way."""
        if not _filled(belief):
            return _enter(belief, RETREAT, time_s)
        return _enter(belief, HOLD, time_s) if _reached(belief, self._raised(belief)) else _unless_late(belief, time_s)

    def _after_hold(self, belief: Value, time_s: float) -> Value:
        """It is held on, unless the cube is lost."""
        return belief if _filled(belief) else _enter(belief, RETREAT, time_s)

    def _after_retreat(self, belief: Value, time_s: float) -> Value:
        """Open and back, and then home to have another look."""
        if not _reached(belief, before(belief["gripper"])) and not _late(belief, time_s):
            return belief
        forgotten = dict.fromkeys(("target", "box_from_gripper", "box_width", "gripper"))
        return _enter({**belief, **forgotten}, WATCH, time_s)

    def _raised(self, belief: Value) -> Floats:
        raised: Floats = belief["gripper"].copy()
        raised[2, 3] += self._lift_m
        return raised


def held_now(belief: Value) -> Elements:
    """ϱ of the grasp node: {"held": id of the cube that the hand holds, None for none}."""
    return ({"held": belief["target"] if belief["phase"] in (LIFT, HOLD) else None},)


def _enter(belief: Value, phase: str, time_s: float) -> Value:
    return {**belief, "phase": phase, "since_s": time_s, "steady_s": None}


def _late(belief: Value, time_s: float) -> bool:
    return bool(time_s - belief["since_s"] >= _PATIENCE_S)


def _unless_late(belief: Value, time_s: float) -> Value:
    return _enter(belief, RETREAT, time_s) if _late(belief, time_s) else belief


def _steadied(belief: Value, holds: bool, time_s: float) -> Value:
    """The belief with the time since which a condition holds without a break."""
    since = belief["steady_s"] if belief["steady_s"] is not None else time_s
    return {**belief, "steady_s": since if holds else None}


def _steady(belief: Value, time_s: float, long_s: float) -> bool:
    return belief["steady_s"] is not None and time_s - belief["steady_s"] >= long_s - 1e-9


def _sure(body: Mapping[str, Any]) -> bool:
    """Whether a body is tracked, and its place known well enough to take it."""
    variance = float(np.trace(body["covariance"][:3, :3]))
    return body["status"] == "tracked" and variance < _SURE_M**2


def _aimed(belief: Value) -> Value:
    """The grasp where the target is now; where it was, if it is not tracked."""
    target = next(body for body in belief["bodies"] if body["id"] == belief["target"])
    if belief["gripper"] is not None and not _sure(target):
        return belief
    return {**belief, "gripper": target["pose"] @ belief["box_from_gripper"]}


def _reached(belief: Value, gripper: Floats) -> bool:
    distance, angle = pose_error(belief["hand"]["gripper"], gripper)
    return distance < _NEAR_M and angle < _NEAR_RAD


def _filled(belief: Value) -> bool:
    """Whether something as wide as the target is between the fingers."""
    return bool(belief["hand"]["width"] > belief["box_width"] - _THINNER_M)
