"""The phases in which a cube is moved: when each of them ends, which one follows, and where the gripper goes by that.

A belief is that of `hierax.nodes.tower.skills.SkillsNode`."""

from collections.abc import Mapping
from functools import partial
from typing import Any, cast

import numpy as np

from hierax.nodes.picking.panda import HOME_GRIPPER, gripper_down
from hierax.nodes.picking.phases import (
    AIM_S,
    APPROACH,
    CLOSE,
    DESCEND,
    LIFT,
    LOOK_S,
    RETREAT,
    STILL_S,
    WATCH,
    After,
    after_approach,
    after_close,
    after_descend,
    aimed,
    entered,
    has_reached,
    is_filled,
    is_late,
    is_steady,
    is_sure,
    steadied,
)
from hierax.nodes.picking.planning import OPENING_M, before, is_alike
from hierax.nodes.tower.placing import at_height, place_on, place_on_table, top_of
from hierax.nodes.tower.reaching import Reach, reach
from hierax.nodes.tower.tasks import is_move
from hierax.nodes.tracking.math.geometry import Floats, invert
from hierax.nodes.tracking.schema import LOST, TABLE
from hierax.runtime import Value

OVER, CARRY, LOWER, OPEN = "over", "carry", "lower", "open"

_ABOVE_M = 0.06  # so far above everything the empty gripper crosses the table
_BELOW_M = 0.03  # so far above everything the lowest of a cube that is carried goes
_ALIKE = 2.5  # trace of a turn, 3 at most: by less than 40° a place is followed, not another way to turn the cube taken

SIGHTED_S = 3.0  # so long what a cube comes onto is where it was seen last, while the one in hand hides it

_MOST_TRIED = 64  # so many ways to take cubes that failed are remembered; one cube has 28 at most

OF_A_MOVE = ("target", "box_from_gripper", "box_width", "gripper", "place", "sighted_s", "refused", "frees")

VIEW_S = 4.0  # so long the camera looks from one side for what is lost
VIEWS = (
    HOME_GRIPPER,
    *(gripper_down(np.array([0.34, side * 0.24, 0.36]), side * -0.8, np.radians(15.0)) for side in (1.0, -1.0)),
    gripper_down(np.array([0.44, 0.0, 0.46])),
    *(gripper_down(np.array([0.30, side * 0.42, 0.34]), side * -0.8, np.radians(15.0)) for side in (1.0, -1.0)),
)
"""world_from_gripper where the camera overlooks the table: from home, from both sides, from above; and, for what is
still not seen then, from farther aside, where the arm reaches, but nothing is laid."""


def watching(belief: Value, time_s: float) -> Value:
    """The belief in which the hand has nothing, and the camera looks from home."""
    return entered({**belief, **dict.fromkeys(OF_A_MOVE), "view": 0}, WATCH, time_s)


def asked_anew(belief: Value, time_s: float) -> Value:
    """The belief in which something else is to be done now, and nothing was begun: where the camera has been brought to
    look for what is lost, it stays for its time, as what was found from there may not be seen from home."""
    if belief["phase"] == WATCH and belief["view"] > 0:
        return {**belief, **dict.fromkeys(OF_A_MOVE)}
    return watching(belief, time_s)


def moves_aside(belief: Value) -> bool:
    """Whether what is moved is in the way of what was asked for."""
    return belief["refused"] is not None and bool(belief["refused"][0] != belief["target"])


def _others(belief: Value) -> list[Mapping[str, Any]]:
    return [body for body in belief["bodies"] if body["id"] != belief["target"]]


def _known(belief: Value) -> list[Mapping[str, Any]]:
    return [body for body in belief["bodies"] if body["status"] != LOST]


def _body(belief: Value, number: int) -> Mapping[str, Any]:
    return next(body for body in belief["bodies"] if body["id"] == number)


def _is_lost(belief: Value, number: int) -> bool:
    return number != TABLE and bool(_body(belief, number)["status"] == LOST)


def over(belief: Value) -> Floats:
    """Before the grasp, above everything."""
    return at_height(before(belief["gripper"]), top_of(belief["bodies"]) + _ABOVE_M)


def lifted(belief: Value, gripper: Floats) -> Floats:
    """The gripper so high that the cube in it passes over all others."""
    return at_height(gripper, top_of(_others(belief)) + _body(belief, belief["target"])["size"].max() + _BELOW_M)


def up(belief: Value) -> Floats:
    """Straight up from where the gripper was last, above everything."""
    last = belief["gripper"] if belief["place"] is None else belief["place"]
    return at_height(before(last), top_of(belief["bodies"]) + _ABOVE_M)


def _after_watch(belief: Value, time_s: float) -> Value:
    """A grasp of the cube is chosen once the tracker has had time, the camera being still, unless what it comes onto is
    lost. What is not found from one side is looked for from another one."""
    belief = steadied(belief, has_reached(belief, VIEWS[belief["view"]]), time_s)
    if belief["put"] is not None and _is_lost(belief, belief["put"]):
        belief = {**belief, "put": None}  # it is looked for everywhere
    goal, is_settled = belief["goal"], is_steady(belief, time_s, LOOK_S)
    if is_move(goal) and is_settled and not _is_lost(belief, goal[1]):
        found = _reached(belief)
        if found is not None:
            return entered(aimed(_begun(belief, found)), OVER, time_s)
    if not is_steady(belief, time_s, VIEW_S):
        return belief
    searches = goal is not None or any(body["status"] == LOST for body in belief["bodies"])
    view = (belief["view"] + 1) % len(VIEWS) if searches else 0
    if view == 0:  # looked from everywhere
        belief = {**belief, "frees": None, "cleared": ()}
    return belief if view == belief["view"] else {**belief, "view": view, "steady_s": None}


def _reached(belief: Value) -> Reach | None:
    """How what is to be done is begun; where something is lost, it may be where it was as long as the camera has only
    looked from home."""
    known, how = _known(belief), (belief["goal"], belief["tried"], belief["cleared"])
    found = reach(belief["bodies"], *how)
    if found is not None or belief["view"] == 0 or len(known) == len(belief["bodies"]):
        return found
    return reach(known, *how)


def _begun(belief: Value, reached: Reach) -> Value:
    """The belief in which a move begins: the one that was asked for, or one that makes room for it."""
    number, box_from_gripper, width_m = reached.grasp
    grasp = {"target": number, "box_from_gripper": box_from_gripper, "box_width": width_m}
    begun = {**belief, **grasp, "goal": reached.goal, "moves": belief["moves"] + 1, "put": None}
    if reached.goal == belief["goal"]:
        return {**begun, "refused": None, "cleared": ()}
    return {**begun, "refused": belief["goal"]}


def _unless_late(belief: Value, time_s: float) -> Value:
    """The same, or, where the hand does not come to the cube, back, to take it otherwise."""
    if not is_late(belief, time_s):
        return belief
    number, way, tried = belief["target"], belief["box_from_gripper"], belief["tried"]
    if any(other == number and is_alike(way, failed) for other, failed in tried):  # it was taken as no other was left
        tried = tuple(each for each in tried if each[0] != number)
    return entered({**belief, "tried": (*tried, (number, way))[-_MOST_TRIED:]}, RETREAT, time_s)


def _after_over(belief: Value, time_s: float) -> Value:
    belief = aimed(belief)
    return entered(belief, APPROACH, time_s) if has_reached(belief, over(belief)) else _unless_late(belief, time_s)


def _after_close(belief: Value, time_s: float) -> Value:
    """To the cube the hand has come."""
    after = after_close(belief, time_s)
    return after if after["phase"] == CLOSE else {**after, "tried": ()}


def _after_lift(belief: Value, time_s: float) -> Value:
    """Up, unless the cube is lost on the way."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    if has_reached(belief, lifted(belief, belief["gripper"])) or is_late(belief, time_s):
        return entered(belief, CARRY, time_s)
    return belief


def _after_carry(belief: Value, time_s: float) -> Value:
    """Above where it is to be put down, which is chosen with how the cube is really held. The cube below is only seen
    on the way there: from above, the one in hand may hide it. Where it is not seen, or there is no place on it, the one
    in hand comes onto the table."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    seen, place = _is_seen(belief), _place(belief)
    begins = belief["goal"][1] == TABLE and belief["place"] is None and place is not None  # now there is room
    times = {"sighted_s": time_s if seen else belief["sighted_s"], "since_s": time_s if begins else belief["since_s"]}
    belief = {**belief, "place": place, **times}
    above = belief["place"] is not None and has_reached(belief, lifted(belief, belief["place"]))
    known = belief["sighted_s"] is not None and time_s - belief["sighted_s"] <= SIGHTED_S
    belief = steadied(belief, above and known, time_s)
    if is_steady(belief, time_s, AIM_S):
        return entered(belief, LOWER, time_s)
    if not is_late(belief, time_s):
        return belief
    if belief["goal"][1] == TABLE:  # a place there that the hand does not quite come to will do
        return belief if belief["place"] is None else entered(belief, LOWER, time_s)
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
    found = place_on(held, _body(belief, onto), belief["bodies"], holds, belief["box_width"], place)
    if found is None and belief["view"] > 0:  # the arm has looked for what is lost
        found = place_on(held, _body(belief, onto), _known(belief), holds, belief["box_width"], place)
    turned = place is None or found is None or float((found[:3, :3] * place[:3, :3]).sum()) < _ALIKE
    return found if place is None or not turned else cast(Floats, place)


def _after_lower(belief: Value, time_s: float) -> Value:
    """Down, until it is there, or stands on something."""
    if not is_filled(belief):
        return entered(belief, RETREAT, time_s)
    belief = steadied(belief, has_reached(belief, belief["place"]), time_s)
    if not is_steady(belief, time_s, STILL_S) and not is_late(belief, time_s):
        return belief
    aside = ((belief["refused"][0], belief["target"]),) if moves_aside(belief) else ()
    return entered({**belief, "put": belief["target"], "cleared": (*belief["cleared"], *aside)}, OPEN, time_s)


def _after_open(belief: Value, time_s: float) -> Value:
    opened = belief["hand"]["width"] > belief["box_width"] + 0.5 * OPENING_M
    belief = steadied(belief, opened, time_s)
    done = is_steady(belief, time_s, STILL_S) or is_late(belief, time_s)
    return entered(belief, RETREAT, time_s) if done else belief


def _after_retreat(belief: Value, time_s: float) -> Value:
    """Open and up, and then home to have another look. If a cube was moved aside for another one, and something else is
    asked for now than what was done, that is set free first: of a tower that was in its way, the builder would have the
    upper cubes put back."""
    if not has_reached(belief, up(belief)) and not is_late(belief, time_s):
        return belief
    frees, asked, is_put = belief["frees"], belief["asked"], belief["put"] == belief["target"]
    if is_put and moves_aside(belief):
        as_wished = asked in (belief["refused"], (belief["target"], TABLE))
        frees = None if as_wished and frees is None else belief["refused"][0]
    elif is_put:
        frees = None  # it is
    after = watching(belief, time_s)
    return after if frees is None or not is_move(asked) else {**after, "goal": (frees, TABLE), "frees": frees}


AFTER: Mapping[str, After] = {
    WATCH: _after_watch,
    OVER: _after_over,
    APPROACH: partial(after_approach, late=_unless_late),
    DESCEND: partial(after_descend, late=_unless_late),
    CLOSE: _after_close,
    LIFT: _after_lift,
    CARRY: _after_carry,
    LOWER: _after_lower,
    OPEN: _after_open,
    RETREAT: _after_retreat,
}
