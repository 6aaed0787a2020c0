"""The skills node: moves one cube onto another one, or to a free place of the table, as it is told.

A task becomes the name of a policy, as the commands for the gripper do below. Phases: watch, over, approach, descend,
close, lift, carry, lower, open, retreat, and watch again. Another task counts where it can: before the hand closes, and
while a cube is carried; else when the present one is done. Where no hand gets at a cube, one that is in the way is
moved aside first."""

from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np

from hierax.nodes.picking.commands import command
from hierax.nodes.picking.panda import HOME_GRIPPER, WIDEST_M, gripper_down
from hierax.nodes.picking.phases import (
    AIM_S,
    APPROACH,
    CLOSE,
    DESCEND,
    FAST_M_S,
    LIFT,
    LOOK_S,
    RETREAT,
    SLOW_M_S,
    STILL_M,
    STILL_S,
    WATCH,
    aimed,
    entered,
    has_reached,
    is_filled,
    is_late,
    is_steady,
    is_sure,
    steadied,
    unless_late,
)
from hierax.nodes.picking.planning import OPENING_M, before
from hierax.nodes.tower.display import skill_things
from hierax.nodes.tower.placing import at_height, place_on, place_on_table, top_of
from hierax.nodes.tower.reaching import Reach, reach
from hierax.nodes.tower.rules import TABLE
from hierax.nodes.tracking.math.geometry import Floats, invert
from hierax.nodes.tracking.schema import LOST
from hierax.runtime import NO_TICK, Elements, Node, Step, Tick, Value
from hierax.runtime.core.node import Policy
from hierax.runtime.core.showing import Things

OVER, CARRY, LOWER, OPEN = "over", "carry", "lower", "open"

REST = "default"
_MOVE, _ONTO = "move", "onto"
_HOLDING = (LIFT, CARRY, LOWER)  # phases in which the cube is in the hand
_FREE = (WATCH, OVER, APPROACH)  # those in which it does not matter yet which cube is meant
_ABOVE_M = 0.06  # so far above everything the empty gripper crosses the table
_BELOW_M = 0.03  # so far above everything the lowest of a cube that is carried goes
_ALIKE = 2.5  # trace of a turn, 3 at most: by less than 40° a place is followed, not another way to turn the cube taken

SIGHTED_S = 3.0  # so long what a cube comes onto is where it was seen last, while the one in hand hides it

_OF_A_MOVE = ("target", "box_from_gripper", "box_width", "gripper", "place", "sighted_s", "refused")

VIEW_S = 4.0  # so long the camera looks from one side for what is lost
VIEWS = (
    HOME_GRIPPER,
    *(gripper_down(np.array([0.34, side * 0.24, 0.36]), side * -0.8, np.radians(15.0)) for side in (1.0, -1.0)),
    gripper_down(np.array([0.44, 0.0, 0.46])),
)
"""world_from_gripper where the camera overlooks the table: from home, from both sides, and from above."""


def name_of(tasks: Elements) -> str:
    """The name of the policy that does what is asked for."""
    return f"{_MOVE} {tasks[0]['cube']} {_ONTO} {tasks[0]['onto']}" if tasks else REST


class _Skills(Mapping[str, Policy]):
    """Π: for each cube and what it may be moved onto, the policy that does it; ``default`` has the arm watch."""

    def __getitem__(self, name: str) -> Policy:
        words = name.split(" ")
        if name == REST:
            return lambda belief: ({"goal": None}, _wish(belief))
        if len(words) != 4 or (words[0], words[2]) != (_MOVE, _ONTO):
            raise KeyError(name)
        try:
            goal = int(words[1]), int(words[3])
        except ValueError:
            raise KeyError(name) from None
        return lambda belief: ({"goal": goal}, _wish(belief))

    def __iter__(self) -> Iterator[str]:
        return iter((REST,))

    def __len__(self) -> int:
        return 1


class SkillsNode(Node):
    """Moves cubes.

    The belief is that of phases (`hierax.nodes.picking.phases`), with ``goal`` (what is being done; None: nothing),
    ``asked`` (what was asked for last), ``view`` (from which of `VIEWS` it watches), ``place`` (world_from_gripper
    where the cube is put down; None before that is known), ``sighted_s`` (when it was last seen, while the cube is
    carried, what that comes onto; None: never), ``refused`` (what is asked for and cannot be done with the cube in the
    hand, or before the one that is moved in its place is out of the way), ``width`` (of the gripper, when it was last
    looked at), ``put`` (the cube that the hand has put down last, until it begins to move the next one; None: none),
    ``stands`` (cubes of which the builder says so) and ``moves``, how many have begun.

    Args: once: the cubes are where they were when the first move began, or where the hand has put them since, whatever
        is seen. For comparison."""

    def __init__(self, once: bool = False) -> None:
        self._once = once

    def initial_belief(self) -> Value:
        """Watching; nothing is known, and nothing asked for."""
        seen = {"width": WIDEST_M, "bodies": (), "hand": None}
        nothing = dict.fromkeys(("goal", "asked", *_OF_A_MOVE))
        return {
            "phase": WATCH,
            "view": 0,
            "since_s": 0.0,
            "steady_s": None,
            **seen,
            **nothing,
            "put": None,
            "stands": (),
            "moves": 0,
        }

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ: the scene, and the phase that follows."""
        if not observations:
            return belief
        bodies = tuple(item for item in observations if "pose" in item)
        hand = next(item["hand"] for item in observations if "hand" in item)
        if self._once and belief["moves"]:
            bodies = _as_left(belief, hand)
        seen = _with_goal({**belief, "bodies": bodies, "hand": hand}, tick.time_s)
        return _AFTER[seen["phase"]](seen, tick.time_s)

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: what is asked for is remembered, and what the builder knows to stand, {"stands": ids}."""
        asked = next((action["goal"] for action in actions if "goal" in action), None)
        return {**belief, "asked": asked, "stands": context[0]["stands"] if context else ()}

    def select_policy(self, tasks: Elements) -> str:
        """λ: to do what is asked for."""
        return name_of(tasks)

    def policies(self) -> Mapping[str, Policy]:
        """Π: for each move, its execution."""
        return _Skills()

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """How many moves have begun."""
        return {"moves": float(belief["moves"])}

    def show(self, step: Step, before: Value) -> Things:
        """What the hand does, for what, and where to."""
        return skill_things(step.belief, step.time_s)


def gripper_commands(actions: Elements) -> Elements:
    """ψ of the skills node: what is asked of the gripper."""
    return tuple(action for action in actions if "gripper" in action)


def held_and_standing(belief: Value) -> Elements:
    """ϱ of the skills node: {"held": id of the cube that the hand holds, None for none; "stands": those that stand,
    with the one that it has put down last; "looks": whether the camera overlooks the table, so that what is not seen
    where it should be is elsewhere}."""
    stands = {*belief["stands"]} if belief["put"] is None else {*belief["stands"], belief["put"]}
    return ({"held": _held(belief), "stands": tuple(sorted(stands)), "looks": belief["phase"] == WATCH},)


def scene_and_skill(belief: Value) -> Elements:
    """φ of the skills node: the bodies, then {"skill": {"phase", "goal", "holding"}}; none before the first look."""
    if belief["hand"] is None:
        return ()
    return (
        *belief["bodies"],
        {"skill": {**{name: belief[name] for name in ("phase", "goal")}, "holding": _held(belief)}},
    )


def _as_left(belief: Value, hand: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """The cubes where the last look has them, but for the one that is in the hand, which moves with it."""
    held = _held(belief)
    return tuple(
        {**body, "pose": hand["gripper"] @ invert(belief["box_from_gripper"])} if body["id"] == held else body
        for body in belief["bodies"]
    )


def _held(belief: Value) -> int | None:
    return belief["target"] if belief["phase"] in _HOLDING else None


def _with_goal(belief: Value, time_s: float) -> Value:
    """The belief with what is asked for, where that may change now."""
    asked = belief["asked"]
    if asked == belief["goal"] or (asked is not None and asked == belief["refused"]):
        return belief
    if belief["phase"] in _FREE:
        return _watching({**belief, "goal": asked}, time_s)
    carried = belief["phase"] in (LIFT, CARRY) and asked is not None and asked[0] == belief["target"]
    if carried:
        return {**belief, "goal": asked, "place": None, "sighted_s": None}
    return belief


def _watching(belief: Value, time_s: float) -> Value:
    return entered({**belief, **dict.fromkeys(_OF_A_MOVE), "view": 0}, WATCH, time_s)


def _wish(belief: Value) -> Value:
    """The gripper's command in this phase."""
    phase, grasp = belief["phase"], belief["gripper"]
    if phase == WATCH:
        return command(VIEWS[belief["view"]], WIDEST_M, FAST_M_S)
    opened_m = belief["box_width"] + OPENING_M
    if phase in (OVER, APPROACH, DESCEND):
        ways = {OVER: _over(belief), APPROACH: before(grasp), DESCEND: grasp}
        return command(ways[phase], opened_m, SLOW_M_S if phase == DESCEND else FAST_M_S)
    if phase == RETREAT:
        return command(_up(belief), opened_m, FAST_M_S)
    place = belief["place"]
    ways = {CLOSE: grasp, LIFT: _lifted(belief, grasp), LOWER: place, OPEN: place}
    if phase == CARRY:
        ways[CARRY] = _lifted(belief, grasp if place is None else place)
    return command(ways[phase], opened_m if phase == OPEN else 0.0, FAST_M_S if phase == CARRY else SLOW_M_S)


def _others(belief: Value) -> list[Mapping[str, Any]]:
    return [body for body in belief["bodies"] if body["id"] != belief["target"]]


def _body(belief: Value, number: int) -> Mapping[str, Any]:
    return next(body for body in belief["bodies"] if body["id"] == number)


def _over(belief: Value) -> Floats:
    """Before the grasp, above everything."""
    return at_height(before(belief["gripper"]), top_of(belief["bodies"]) + _ABOVE_M)


def _lifted(belief: Value, gripper: Floats) -> Floats:
    """The gripper so high that the cube in it passes over all others."""
    return at_height(gripper, top_of(_others(belief)) + _body(belief, belief["target"])["size"].max() + _BELOW_M)


def _up(belief: Value) -> Floats:
    """Straight up from where the gripper was last, above everything."""
    last = belief["gripper"] if belief["place"] is None else belief["place"]
    return at_height(before(last), top_of(belief["bodies"]) + _ABOVE_M)


def _after_watch(belief: Value, time_s: float) -> Value:
    """A grasp of the cube is chosen once the tracker has had time, the camera being still. What is not found from one
    side is looked for from another one."""
    belief = steadied(belief, has_reached(belief, VIEWS[belief["view"]]), time_s)
    if belief["goal"] is not None and is_steady(belief, time_s, LOOK_S):
        found = reach(belief["bodies"], belief["goal"])
        if found is not None:
            return entered(aimed(_begun(belief, found)), OVER, time_s)
    if not is_steady(belief, time_s, VIEW_S):
        return belief
    searches = belief["goal"] is not None or any(body["status"] == LOST for body in belief["bodies"])
    view = (belief["view"] + 1) % len(VIEWS) if searches else 0
    return belief if view == belief["view"] else {**belief, "view": view, "steady_s": None}


def _begun(belief: Value, reached: Reach) -> Value:
    """The belief in which a move begins: the one that was asked for, or one that makes room for it."""
    number, box_from_gripper, width_m = reached.grasp
    grasp = {"target": number, "box_from_gripper": box_from_gripper, "box_width": width_m}
    refused = None if reached.goal == belief["goal"] else belief["goal"]
    moves = belief["moves"] + 1
    return {**belief, **grasp, "goal": reached.goal, "refused": refused, "moves": moves, "put": None}


def _after_over(belief: Value, time_s: float) -> Value:
    belief = aimed(belief)
    return entered(belief, APPROACH, time_s) if has_reached(belief, _over(belief)) else unless_late(belief, time_s)


def _after_approach(belief: Value, time_s: float) -> Value:
    """The grasp follows the cube as long as that is tracked; then down, when the gripper is above it."""
    belief = aimed(belief)
    belief = steadied(belief, has_reached(belief, before(belief["gripper"])), time_s)
    return entered(belief, DESCEND, time_s) if is_steady(belief, time_s, AIM_S) else unless_late(belief, time_s)


def _after_descend(belief: Value, time_s: float) -> Value:
    return entered(belief, CLOSE, time_s) if has_reached(belief, belief["gripper"]) else unless_late(belief, time_s)


def _after_close(belief: Value, time_s: float) -> Value:
    """The fingers stand still: on the cube, or on one another."""
    width = belief["hand"]["width"]
    belief = steadied(belief, abs(width - belief["width"]) < STILL_M, time_s)
    belief = {**belief, "width": width}
    if not is_steady(belief, time_s, STILL_S):
        return unless_late(belief, time_s)
    return entered(belief, LIFT if is_filled(belief) else RETREAT, time_s)


def _after_lift(belief: Value, time_s: float) -> Value:
    """Up, unless the cube is lost on the way."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    if has_reached(belief, _lifted(belief, belief["gripper"])) or is_late(belief, time_s):
        return entered(belief, CARRY, time_s)
    return belief


def _after_carry(belief: Value, time_s: float) -> Value:
    """Above where it is to be put down, which is chosen with how the cube is really held. The cube below is only seen
    on the way there: from above, the one in hand may hide it. Where it is not seen, or there is no place on it, the one
    in hand comes onto the table."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    seen = _is_seen(belief)
    belief = {**belief, "place": _place(belief), "sighted_s": time_s if seen else belief["sighted_s"]}
    above = belief["place"] is not None and has_reached(belief, _lifted(belief, belief["place"]))
    known = belief["sighted_s"] is not None and time_s - belief["sighted_s"] <= SIGHTED_S
    belief = steadied(belief, above and known, time_s)
    if is_steady(belief, time_s, AIM_S):
        return entered(belief, LOWER, time_s)
    if not is_late(belief, time_s) or belief["goal"][1] == TABLE:
        return belief
    aside = {"goal": (belief["target"], TABLE), "refused": belief["goal"], "place": None}
    return entered({**belief, **aside}, CARRY, time_s)


def _is_seen(belief: Value) -> bool:
    """Whether it is known where the cube is to be put down."""
    return belief["goal"][1] == TABLE or is_sure(_body(belief, belief["goal"][1]))


def _place(belief: Value) -> Floats | None:
    """Where the cube is put down: on another one as that is seen now, and the hand turned as little as before; on the
    table where that was chosen."""
    held, onto, place = _body(belief, belief["target"]), belief["goal"][1], belief["place"]
    holds = invert(held["pose"]) @ belief["hand"]["gripper"]
    if onto == TABLE:
        return place if place is not None else place_on_table(held, belief["bodies"], holds, belief["box_width"])
    if place is not None and not _is_seen(belief):
        return cast(Floats, place)
    found = place_on(held, _body(belief, onto), belief["bodies"], holds, belief["box_width"])
    turned = place is None or found is None or float((found[:3, :3] * place[:3, :3]).sum()) < _ALIKE
    return found if place is None or not turned else cast(Floats, place)


def _after_lower(belief: Value, time_s: float) -> Value:
    """Down, until it is there, or stands on something."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    belief = steadied(belief, has_reached(belief, belief["place"]), time_s)
    there = is_steady(belief, time_s, STILL_S) or is_late(belief, time_s)
    return entered({**belief, "put": belief["target"]}, OPEN, time_s) if there else belief


def _after_open(belief: Value, time_s: float) -> Value:
    opened = belief["hand"]["width"] > belief["box_width"] + 0.5 * OPENING_M
    belief = steadied(belief, opened, time_s)
    done = is_steady(belief, time_s, STILL_S) or is_late(belief, time_s)
    return entered(belief, RETREAT, time_s) if done else belief


def _after_retreat(belief: Value, time_s: float) -> Value:
    """Open and up, and then home to have another look."""
    return _watching(belief, time_s) if has_reached(belief, _up(belief)) or is_late(belief, time_s) else belief


_AFTER = {
    WATCH: _after_watch,
    OVER: _after_over,
    APPROACH: _after_approach,
    DESCEND: _after_descend,
    CLOSE: _after_close,
    LIFT: _after_lift,
    CARRY: _after_carry,
    LOWER: _after_lower,
    OPEN: _after_open,
    RETREAT: _after_retreat,
}
