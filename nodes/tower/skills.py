"""The skills node: moves one cube onto another one, or to a free place of the table, or looks for one, as it is told.

A task becomes the name of a policy, as the commands for the gripper do below. Phases: watch, over, approach,
descend, close, lift, carry, lower, open, retreat, and watch again. Another task counts where it can: before the hand
goes down, and while a cube is carried; else when the present one is done. Where no hand gets at a cube, one that is
in the way is moved out of it first. While it watches, the camera looks from one side after the other for what is
lost."""

from collections.abc import Mapping
from typing import Any

from hierax.nodes.picking.commands import REST, Named, command
from hierax.nodes.picking.panda import WIDEST_M
from hierax.nodes.picking.phases import APPROACH, CLOSE, DESCEND, LIFT, RETREAT, WATCH
from hierax.nodes.picking.planning import OPENING_M, before
from hierax.nodes.picking.tracker import read_scene
from hierax.nodes.tower.display import skill_things
from hierax.nodes.tower.doing import doing, held
from hierax.nodes.tower.moving import (
    AFTER,
    CARRY,
    LOWER,
    OF_A_MOVE,
    OPEN,
    OVER,
    VIEWS,
    asked_anew,
    lifted,
    moves_aside,
    over,
    up,
)
from hierax.nodes.tower.tasks import goal_of, is_move, name_of
from hierax.nodes.tracking.math.geometry import invert
from hierax.nodes.tracking.schema import TRACKED
from hierax.runtime import NO_TICK, Elements, Node, Step, Tick, Value
from hierax.runtime.core.node import Policy
from hierax.runtime.core.showing import Things

_FREE = (WATCH, OVER, APPROACH)  # phases in which it does not matter yet which cube is meant
# How fast the gripper goes, m/s: across the table and up from what it has put down, where there is room; between cubes;
# and with one up from the others, slowly, as it is then that the camera has to see how it is held.
ACROSS_M_S = 0.4
SPEEDS_M_S = {DESCEND: 0.12, CLOSE: 0.12, LIFT: 0.08, LOWER: 0.12, OPEN: 0.12}


def _policy(name: str) -> Policy:
    """What is done for a goal, by the name of the task; of none, the arm watches."""
    goal = None if name == REST else goal_of(name)
    return lambda belief: ({"goal": goal}, _wish(belief))


class SkillsNode(Node):
    """Moves cubes.

    The belief is that of phases (`hierax.nodes.picking.phases`), with ``carried`` (what carries which cube), ``goal``
    (what is being done; None: nothing), ``asked`` (what was asked for last), ``view`` (from which of `VIEWS` it
    watches), ``place`` (world_from_gripper where the cube is put down; None before that is known), ``sighted_s`` (when
    it was last seen, while the cube is carried, what that comes onto; None: never), ``refused`` (what was asked for and
    cannot be done with the cube in the hand, or before the one that is moved in its place is out of the way), ``frees``
    (the cube that comes to a free place of the table before any other one is moved for what is asked for, as no hand
    got at it where it stands; None: none), ``cleared`` (which cubes were moved aside for which one, pairs of ids, that
    one first), ``width`` (of the gripper, when it was last looked at), ``put`` (the cube that the hand has put down
    last, until it begins to move the next one, or that one is lost; None: none), ``tried`` (to which ways to take cubes
    the hand did not come, pairs of an id and a box_from_gripper, the last few), ``stands`` (cubes of which the builder
    says so) and ``moves``, how many have begun.

    Args: once: the cubes are where they were when the first move began, or where the hand has put them since, whatever
        is seen. For comparison."""

    def __init__(self, once: bool = False) -> None:
        self._once = once

    def initial_belief(self) -> Value:
        """Watching; nothing is known, and nothing asked for."""
        seen = {"width": WIDEST_M, "bodies": (), "hand": None, "carried": ()}
        nothing = dict.fromkeys(("goal", "asked", *OF_A_MOVE))
        return {
            "phase": WATCH,
            "view": 0,
            "since_s": 0.0,
            "steady_s": None,
            **seen,
            **nothing,
            "put": None,
            "tried": (),
            "cleared": (),
            "stands": (),
            "moves": 0,
        }

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ: the scene, and the phase that follows."""
        if not observations:
            return belief
        bodies, hand, carried = read_scene(observations)
        if self._once and belief["moves"]:
            bodies = _as_left(belief, hand)
        seen = _with_goal({**belief, "bodies": bodies, "hand": hand, "carried": carried}, tick.time_s)
        return AFTER[seen["phase"]](seen, tick.time_s)

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: what is asked for is remembered, and what the builder knows to stand, {"stands": ids}."""
        asked = next((action["goal"] for action in actions if "goal" in action), None)
        return {**belief, "asked": asked, "stands": context[0]["stands"] if context else ()}

    def select_policy(self, tasks: Elements) -> str:
        """λ: to do what is asked for."""
        return name_of(tasks)

    def policies(self) -> Mapping[str, Policy]:
        """Π: for each task, its execution."""
        return Named(_policy)

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
    where it should be is elsewhere}. Where the cube that is held is about to be says the command that comes with it."""
    stands = {*belief["stands"]} if belief["put"] is None else {*belief["stands"], belief["put"]}
    return ({"held": held(belief), "stands": tuple(sorted(stands)), "looks": belief["phase"] == WATCH},)


def scene_and_skill(belief: Value) -> Elements:
    """φ of the skills node: the bodies; {"hand", "carried"}, as they came; then {"skill": what `doing` tells, with
    "holding", the cube that the hand should have, and "looks", as in the context}. None before the first look."""
    if belief["hand"] is None:
        return ()
    skill = {**doing(belief), "holding": held(belief), "looks": belief["phase"] == WATCH}
    return (*belief["bodies"], {"hand": belief["hand"], "carried": belief["carried"]}, {"skill": skill})


def _as_left(belief: Value, hand: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """The cubes where the last look has them, whatever they were then, but for the one that is in the hand, which moves
    with it."""
    cube = held(belief)
    moved = {} if cube is None else {cube: hand["gripper"] @ invert(belief["box_from_gripper"])}
    return tuple({**body, "status": TRACKED, "pose": moved.get(body["id"], body["pose"])} for body in belief["bodies"])


def _with_goal(belief: Value, time_s: float) -> Value:
    """The belief with what is asked for, where that may change now."""
    asked, frees = belief["asked"], belief["frees"]
    moves = is_move(asked)
    waits = moves and (asked == belief["refused"] or frees not in (None, asked[0]))
    if asked == belief["goal"] or waits:
        return belief
    if belief["phase"] in _FREE:
        return asked_anew({**belief, "goal": asked}, time_s)
    is_carried = belief["phase"] in (LIFT, CARRY) and moves and asked[0] == belief["target"]
    if is_carried and not moves_aside(belief):
        since_s = time_s if belief["phase"] == CARRY else belief["since_s"]  # the hand has another way to go
        return {**belief, "goal": asked, "place": None, "sighted_s": None, "since_s": since_s}
    return belief


def _wish(belief: Value) -> Value:
    """The gripper's command in this phase."""
    phase, grasp = belief["phase"], belief["gripper"]
    speed = SPEEDS_M_S.get(phase, ACROSS_M_S)
    if phase == WATCH:
        return command(VIEWS[belief["view"]], WIDEST_M, speed)
    opened_m = belief["box_width"] + OPENING_M
    if phase in (OVER, APPROACH, DESCEND):
        ways = {OVER: over(belief), APPROACH: before(grasp), DESCEND: grasp}
        return command(ways[phase], opened_m, speed)
    if phase == RETREAT:
        return command(up(belief), opened_m, speed)
    place = belief["place"]
    ways = {CLOSE: grasp, LIFT: lifted(belief, grasp), LOWER: place, OPEN: place}
    if phase == CARRY:
        ways[CARRY] = lifted(belief, grasp if place is None else place)
    return command(ways[phase], opened_m if phase == OPEN else 0.0, speed)
