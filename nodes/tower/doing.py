"""What the skills node does, by its belief: which skill, on which cube, and how that goes."""

from typing import Any

from hierax.nodes.picking.commands import REST
from hierax.nodes.picking.phases import LIFT, RETREAT, WATCH
from hierax.nodes.tower.moving import CARRY, LOWER, OPEN, moves_aside
from hierax.nodes.tower.rules import Step
from hierax.nodes.tower.tasks import LOOK, PLACE, is_look
from hierax.nodes.tracking.schema import LOST, TABLE
from hierax.runtime import Value

PICK, PLACE_ON_TABLE, MAKE_ROOM = "pick", "place on the table", "move out of the way"
DOING, DONE, FAILED = "doing", "done", "failed"

_HOLDING = (LIFT, CARRY, LOWER)  # phases in which the cube is in the hand
_PLACING = (CARRY, LOWER, OPEN)


def held(belief: Value) -> int | None:
    """The cube that the skills node has in its hand, by its belief; None: none."""
    return belief["target"] if belief["phase"] in _HOLDING else None


def doing(belief: Value) -> dict[str, Any]:
    """What the skills node does by its belief: {"skill", "cube", "onto", "status"}, with `REST` for the skill where it
    does nothing. ``status``: `DOING`; `DONE` or `FAILED`, while the hand comes back, or what was looked for is seen."""
    goal = belief["goal"]
    if belief["phase"] == WATCH:
        return _watching(belief, goal)
    status = DOING
    if belief["phase"] == RETREAT:
        status = DONE if belief["put"] == belief["target"] else FAILED
    return {"skill": _skill(belief, goal), "cube": belief["target"], "onto": goal[1], "status": status}


def _watching(belief: Value, goal: Step | None) -> dict[str, Any]:
    lost = {body["id"] for body in belief["bodies"] if body["status"] == LOST}
    status = DONE if is_look(goal) and goal[0] not in lost else DOING
    skill = REST if goal is None and not lost else LOOK
    cube, onto = (None, None) if goal is None else goal
    return {"skill": skill, "cube": cube, "onto": onto, "status": status}


def _skill(belief: Value, goal: Step) -> str:
    if moves_aside(belief):
        return MAKE_ROOM
    comes_back = belief["phase"] == RETREAT and belief["place"] is not None
    if belief["phase"] not in _PLACING and not comes_back:
        return PICK
    return PLACE_ON_TABLE if goal[1] == TABLE else PLACE
