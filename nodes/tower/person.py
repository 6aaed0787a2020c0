"""Somebody who interferes while towers are built: when it begins, where the hand is, and how it is seen.

Each interference (`hierax.nodes.tower.interferences`) begins when it can be done, once the tower is as high as is drawn
from the seed, after a pause that is drawn, too; then the hand goes from stop to stop. Of several that can begin the
first one does, so that one that cannot does not keep others from it. The hand is a body like others
(`hierax.nodes.picking.workcell.Guest`): it pushes, and what it grips hangs on it by a bounded force."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.picking.panda import gripper_at
from hierax.nodes.picking.workcell import GUEST_HALF_M, Grip, Guest
from hierax.nodes.tower.interferences import ACTS, HOME_M, KEEPS_M, Drawn, Scene, Stop, brought, is_due
from hierax.nodes.tracking.math.geometry import (
    Floats,
    exp_so3,
    invert,
    is_behind,
    log_so3,
    make_pose,
    project,
    transform,
)
from hierax.runtime import Value

PAUSE_S = 1.5  # an interference begins at most so long after it could
_LETS_PASS_S = 4.0  # so long in all a hand lets the gripper pass
_LATE_S = 2.0  # a stop that is not reached is given up so long after it should have been
_REACHED_M = 0.004
_TURN_RAD_S = 2.0
_MISSES_M = 0.02  # what is farther from the palm is not gripped
_MOVED_M, _BESIDE_M = 0.01, 0.12
_LEASH_M = 0.04  # a hand that is farther behind is drawn as if it were so far: one that comes free flings nothing away
_PERSON, _HEIGHT = 5, 6  # of the numbers that are drawn

SKIN, SLEEVE = (222, 170, 136), (58, 70, 96)
_FOREARM_M = (0.05, 0.05, 0.11)  # of each of the pieces behind the palm, drawn alone


Seen = Callable[[int], Scene]
"""What the person sees, for the interference of a number."""


def acted(belief: Value, seen: Seen, names: Sequence[str], interval_s: float) -> tuple[Value, Guest | None]:
    """What the person believes a frame later, and what the hand does in it; None: it is not there.

    The belief: ``over``, the numbers of the interferences that are over, and ``happened``, in how many of them a cube
    was gripped or moved; ``pauses_s``, by number, until others may begin that could. Of the present one: ``act``, its
    number (None: there is none); ``stops``, maps of `Stop`'s fields; ``hand`` (world_from_palm), ``velocity`` (6,),
    ``target`` (of the hand, as ``hand``), ``holds`` (palm_from_cube; None: nothing); ``touched``, whether it counts as
    happened, also where the hand drew back after that, to try again, and ``from``, where each cube was when it began,
    m; ``late_s``, how long the present stop takes longer than it should, and ``waited_s``, how long the hand has let
    the gripper pass."""
    if not belief["stops"]:
        belief = _begun(belief, seen, names, interval_s)
        if not belief["stops"]:
            return belief, None
    scene = seen(belief["act"])
    belief = _going_on(belief, scene)
    stop = Stop(**belief["stops"][0])
    belief = _gripping(belief, stop, scene)
    belief = {**belief, "touched": belief["touched"] or belief["holds"] is not None or _has_moved(belief, scene)}
    target, there = _advanced(belief["target"], stop, scene, interval_s)
    if _lets_pass(belief, stop, scene, target):
        target, there = belief["target"], False
        belief = {**belief, "waited_s": belief["waited_s"] + interval_s}
    grip = Grip(stop.grip, belief["holds"]) if belief["holds"] is not None else None
    slack = _slack(belief)
    start, end = (make_pose(each[:3, :3], each[:3, 3] - slack) for each in (belief["target"], target))
    guest = Guest(belief["hand"], belief["velocity"], start, end, grip)
    belief = {**belief, "target": target, "late_s": belief["late_s"] + interval_s if there else 0.0}
    return belief, guest


def _going_on(belief: Value, scene: Scene) -> Value:
    """The belief with other stops, where the hand draws back, or brings a cube to where there is room now."""
    stop, *left = belief["stops"]
    if stop["unless_near"] and not scene.is_free(stop["unless_near"]):
        return {**belief, "stops": ({**belief["stops"][-1], "counts": False},), "late_s": 0.0}
    if stop["brings"]:
        return {**belief, "stops": (*(each._asdict() for each in brought(scene, stop["brings"])), *left)}
    return belief


def _lets_pass(belief: Value, stop: Stop, scene: Scene, target: Floats) -> bool:
    """Whether a hand waits for the gripper to go by, on its way to a next target so near to that."""
    now, then = (float(np.linalg.norm(pose[:3, 3] - scene.gripper)) for pose in (belief["target"], target))
    return not stop.follows and then < min(now, KEEPS_M) and belief["waited_s"] < _LETS_PASS_S


def _slack(belief: Value) -> Floats:
    """By how much (3,) less far a hand is drawn than to where it should be by now, m: nothing, unless it is held up."""
    way = belief["target"][:3, 3] - belief["hand"][:3, 3]
    return np.asarray(way * max(0.0, 1.0 - _LEASH_M / max(float(np.linalg.norm(way)), _LEASH_M)))


def moved(belief: Value, hand: Floats, velocity: Floats) -> Value:
    """The same after the frame, with the hand where it has come."""
    belief = {**belief, "hand": hand, "velocity": velocity}
    stop = Stop(**belief["stops"][0])
    near = float(np.linalg.norm(hand[:3, 3] - belief["target"][:3, 3])) < _REACHED_M
    if belief["late_s"] <= (stop.dwell_s if near else _LATE_S + stop.dwell_s):
        return belief
    left = belief["stops"][1:]
    if left and left[0]["onward"]:
        left = ({**left[0], "to": left[0]["to"] + belief["target"][:3, 3], "onward": False}, *left[1:])
    after = {**belief, "stops": left, "late_s": 0.0}
    if left:
        return after
    after = {**after, "holds": None, "act": None, "pauses_s": {}}
    if not stop.counts:
        return after
    over, happened = (*belief["over"], belief["act"]), belief["happened"] + belief["touched"]
    return {**after, "over": over, "happened": happened, "touched": False}


def obstacles(belief: Value) -> tuple[Mapping[str, Any], ...]:
    """The hand as it is to be drawn, boxes as {"pose", "size", "colour"}: a palm, and a forearm in a sleeve."""
    if not belief["stops"]:
        return ()
    palm = belief["hand"]
    side = np.sign(palm[1, 3]) or 1.0
    lean = exp_so3(np.array([-side * 0.6, 0.5, 0.0]))
    pieces = [{"pose": palm, "size": tuple((2.0 * GUEST_HALF_M).tolist()), "colour": SKIN}]
    for piece in range(3):
        middle = lean @ np.array([0.0, 0.0, (piece + 0.5) * _FOREARM_M[2]]) + palm[:3, 3]
        colour = SKIN if piece == 0 else SLEEVE
        pieces.append({"pose": make_pose(lean, middle), "size": _FOREARM_M, "colour": colour})
    return tuple(pieces)


NOBODY: Value = {
    "over": (),
    "happened": 0,
    "touched": False,
    "from": {},
    "pauses_s": {},
    "act": None,
    "stops": (),
    "holds": None,
    "late_s": 0.0,
    "waited_s": 0.0,
    "hand": make_pose(np.eye(3), HOME_M),
    "target": make_pose(np.eye(3), HOME_M),
    "velocity": np.zeros(6),
}
"""The belief before anything has happened."""


def is_about_to(belief: Value, seen: Seen, names: Sequence[str]) -> bool:
    """Whether something is under way, or could begin now."""
    left = _left(belief, names)
    return bool(belief["stops"]) or any(ACTS[names[number]](seen(number)) is not None for number in left)


def _left(belief: Value, names: Sequence[str]) -> list[int]:
    """The numbers of the interferences that are not over yet."""
    return [number for number in range(len(names)) if number not in belief["over"]]


def seen_of(belief: Value, order: tuple[int, ...], height: int, drawn: Callable[[int], Drawn]) -> Seen:
    """What the person sees of a world's belief, where so many cubes of a tower stand as they should, and what is drawn
    for the interference of each number."""
    bodies = {body["id"]: body for body in belief["bodies"]}
    middles = np.stack([body["pose"][:3, 3] for body in belief["bodies"]])
    seen = transform(invert(belief["camera"]), middles)
    pixels = project(seen, belief["intrinsics"])
    inside = (seen[:, 2] > 0.0) & np.all((pixels > 0) & (pixels < np.array(belief["size"])), axis=1)
    for body in bodies.values():
        box = body["side_m"] / 2 * np.array([[-1.0] * 3, [1.0] * 3])
        others = np.array([number != body["id"] for number in bodies])
        inside &= ~(is_behind(seen, invert(belief["camera"]) @ body["pose"], box) & others)
    hidden = frozenset(number for number, shown in zip(bodies, inside, strict=True) if not shown)
    wanted = order[height] if height < len(order) else None
    gripper = gripper_at(belief["joints"])
    hand = (gripper[:3, 3], gripper[:3, 1], belief["raised"])
    return lambda number: Scene(bodies, *hand, order[:height], wanted, hidden, len(order), *drawn(number))


def drawn_for(seed: int, scene: int, number: int, count: int) -> Drawn:
    """What is drawn for the interference of this number, of so many of a scene: the first of several is due while the
    tower is low, the last one when it is high."""
    share = float(np.random.default_rng([seed, scene, number, _HEIGHT]).uniform())
    return Drawn(np.random.default_rng([seed, scene, number, _PERSON]), (number + share) / count)


def _begun(belief: Value, seen: Seen, names: Sequence[str], interval_s: float) -> Value:
    """The belief with the first interference that begins now, if there is one."""
    pauses_s = dict(belief["pauses_s"])
    for number in _left(belief, names):
        scene, name, key = seen(number), names[number], str(number)
        stops = ACTS[name](scene) if is_due(name, scene) else None
        if key in pauses_s:
            pauses_s[key] = max(pauses_s[key] - interval_s, 0.0)
        elif stops is not None:
            pauses_s[key] = float(scene.rng.uniform(0.0, PAUSE_S))
        if stops is not None and pauses_s[key] <= 0.0:
            return _beginning(belief, scene, number, stops)
    return {**belief, "pauses_s": pauses_s}


def _beginning(belief: Value, scene: Scene, number: int, stops: Sequence[Stop]) -> Value:
    """The belief with an interference that begins."""
    side = np.sign(stops[0].to[1]) or 1.0
    home = HOME_M * (1.0, side, 1.0)
    there = make_pose(np.eye(3), home)
    begun = {
        "act": number,
        "waited_s": 0.0,
        "from": {str(number): body["pose"][:3, 3] for number, body in scene.bodies.items()},
    }
    every = tuple(stop._asdict() for stop in (*stops, Stop(home)))
    return {**belief, **begun, "hand": there, "target": there, "velocity": np.zeros(6), "pauses_s": {}, "stops": every}


def _has_moved(belief: Value, scene: Scene) -> bool:
    """Whether a cube that is beside the hand, and not in the robot's, is elsewhere than when the interference began."""
    palm = belief["hand"][:3, 3]
    places = {number: body["pose"][:3, 3] for number, body in scene.bodies.items() if number not in scene.raised}
    near = {number: place for number, place in places.items() if np.linalg.norm(place - palm) < _BESIDE_M}
    return any(np.linalg.norm(place - belief["from"][str(number)]) > _MOVED_M for number, place in near.items())


def _gripping(belief: Value, stop: Stop, scene: Scene) -> Value:
    """The belief with what the hand holds: a cube that it is to grip, if that is there."""
    if not stop.grip or belief["holds"] is not None:
        return belief if stop.grip else {**belief, "holds": None}
    body = scene.bodies[stop.grip]
    holds = invert(belief["hand"]) @ body["pose"]
    reach = np.abs(holds[:3, 3]) - GUEST_HALF_M - body["side_m"] / 2
    return {**belief, "holds": holds if reach.max() < _MISSES_M else None}


def _advanced(target: Floats, stop: Stop, scene: Scene, interval_s: float) -> tuple[Floats, bool]:
    """Where the hand is drawn to an interval later, and whether that is where it is to stop."""
    goal = stop.to + (scene.bodies[stop.follows]["pose"][:3, 3] if stop.follows else 0.0)
    way = goal - target[:3, 3]
    length, step = float(np.linalg.norm(way)), stop.speed * interval_s
    turn = log_so3(exp_so3(np.array([0.0, 0.0, stop.yaw])) @ target[:3, :3].T)
    angle, most = float(np.linalg.norm(turn)), _TURN_RAD_S * interval_s
    there = length <= step and angle <= most
    place = target[:3, 3] + way * min(1.0, step / max(length, 1e-12))
    return make_pose(exp_so3(turn * min(1.0, most / max(angle, 1e-12))) @ target[:3, :3], place), there
