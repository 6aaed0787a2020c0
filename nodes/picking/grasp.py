"""The grasp node: chooses a free cube of those that are tracked, and has the gripper take it and lift it."""

from collections.abc import Mapping

from hierax.nodes.picking.commands import command
from hierax.nodes.picking.panda import HOME_GRIPPER, WIDEST_M
from hierax.nodes.picking.phases import (
    APPROACH,
    CLOSE,
    DESCEND,
    FAST_M_S,
    HOLD,
    LIFT,
    LOOK_S,
    RETREAT,
    SLOW_M_S,
    WATCH,
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
    unless_late,
)
from hierax.nodes.picking.planning import OPENING_M, before, choose
from hierax.nodes.picking.tracker import read_scene
from hierax.nodes.tracking.math.geometry import Floats
from hierax.runtime import NO_TICK, Elements, Node, Tick, Value
from hierax.runtime.core.node import Policy


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
        bodies, hand, _ = read_scene(observations)
        seen = {**belief, "bodies": bodies, "hand": hand}
        return getattr(self, f"_after_{seen['phase']}")(seen, tick.time_s)

    def policies(self) -> Mapping[str, Policy]:
        """Π: to pick."""
        return {self.initial_policy: self._wish}

    def _wish(self, belief: Value) -> Elements:
        """The gripper's command in this phase."""
        if belief["phase"] == WATCH:
            return (command(HOME_GRIPPER, WIDEST_M, FAST_M_S),)
        grasp, opened_m = belief["gripper"], belief["box_width"] + OPENING_M
        wishes = {
            APPROACH: (before(grasp), opened_m, FAST_M_S),
            DESCEND: (grasp, opened_m, SLOW_M_S),
            CLOSE: (grasp, 0.0, SLOW_M_S),
            LIFT: (self._raised(belief), 0.0, SLOW_M_S),
            HOLD: (self._raised(belief), 0.0, SLOW_M_S),
            RETREAT: (before(grasp), WIDEST_M, SLOW_M_S),
        }
        return (command(*wishes[belief["phase"]]),)

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """How many attempts there were, and of which cube (0: none)."""
        return {"attempts": float(belief["attempts"]), "target": float(belief["target"] or 0)}

    def _after_watch(self, belief: Value, time_s: float) -> Value:
        """A grasp is chosen once the tracker has had time for its first errors, the camera being home."""
        belief = steadied(belief, has_reached(belief, HOME_GRIPPER), time_s)
        if not is_steady(belief, time_s, LOOK_S):
            return belief
        sure = [body["id"] for body in belief["bodies"] if is_sure(body)]
        chosen = choose(belief["bodies"], [number for number in sure if self._wanted in (None, number)])
        if chosen is None:
            return belief
        target, box_from_gripper, box_width = chosen
        grasp = {"target": target, "box_from_gripper": box_from_gripper, "box_width": box_width}
        return entered(aimed({**belief, **grasp, "attempts": belief["attempts"] + 1}), APPROACH, time_s)

    _after_approach = staticmethod(after_approach)
    _after_descend = staticmethod(after_descend)
    _after_close = staticmethod(after_close)

    def _after_lift(self, belief: Value, time_s: float) -> Value:
        """Up, unless the cube is lost on the way."""
        if not is_filled(belief):
            return entered(belief, RETREAT, time_s)
        return (
            entered(belief, HOLD, time_s) if has_reached(belief, self._raised(belief)) else unless_late(belief, time_s)
        )

    def _after_hold(self, belief: Value, time_s: float) -> Value:
        """It is held on, unless the cube is lost."""
        return belief if is_filled(belief) else entered(belief, RETREAT, time_s)

    def _after_retreat(self, belief: Value, time_s: float) -> Value:
        """Open and back, and then home to have another look."""
        if not has_reached(belief, before(belief["gripper"])) and not is_late(belief, time_s):
            return belief
        forgotten = dict.fromkeys(("target", "box_from_gripper", "box_width", "gripper"))
        return entered({**belief, **forgotten}, WATCH, time_s)

    def _raised(self, belief: Value) -> Floats:
        raised: Floats = belief["gripper"].copy()
        raised[2, 3] += self._lift_m
        return raised


def held_now(belief: Value) -> Elements:
    """ϱ of the grasp node: {"held": id of the cube that the hand holds, None for none}."""
    return ({"held": belief["target"] if belief["phase"] in (LIFT, HOLD) else None},)
