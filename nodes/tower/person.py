"""Somebody who interferes while towers are built: what is done, when, and by what movements of a hand.

Each interference begins when, by the truth, it means something (a tower that nobody has begun cannot be knocked over),
and after a pause that is drawn from the seed; then the hand goes from stop to stop. It is a body like others
(`hierax.nodes.picking.workcell.Guest`): it pushes, and what it grips hangs on it by a bounded force."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.panda import gripper_at
from hierax.nodes.picking.workcell import GUEST_HALF_M, Grip, Guest
from hierax.nodes.tower.placing import free_spots
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, log_so3, make_pose, project, transform
from hierax.runtime import Value

Body = Mapping[str, Any]

PAUSE_S = 3.0  # an interference begins at most so long after it could
FAST_M_S, SLOW_M_S = 0.5, 0.08
AWAY_S = (5.0, 10.0)  # how long a cube that was removed is away, from and to
_KEEPS_M = 0.15  # a careful person does not begin anything so near to the gripper
_HOME_M = np.array([0.95, 0.45, 0.35])  # where the hand comes from, and goes to; or as far on the other side
_OVER_M = 0.10  # so high over what it grips the hand comes and goes
_PUSHED_M = 0.05
_LATE_S = 2.0  # a stop that is not reached is given up so long after it should have been
_REACHED_M = 0.004
_TURN_RAD_S = 2.0
_MISSES_M = 0.02  # what is farther from the palm is not gripped
_DIAGONAL = 2**0.5
_PERSON = 5  # of the numbers that are drawn

SKIN, SLEEVE = (222, 170, 136), (58, 70, 96)
_FOREARM_M = (0.05, 0.05, 0.11)  # of each of the pieces behind the palm, drawn alone


class Stop(NamedTuple):
    """Where the hand goes next, and how."""

    to: Floats  # (3,) where the middle of the palm comes, m; or beside the cube that it follows
    speed: float = FAST_M_S  # m/s
    grip: int = 0  # the cube that is gripped on the way; 0: none
    yaw: float = 0.0  # how the palm is turned about the vertical then, rad
    dwell_s: float = 0.0  # how long it stays there
    follows: int = 0  # the cube that it comes to; 0: none
    onward: bool = False  # from where the stop before has brought it
    unless_near: int = 0  # the cube from which it draws back if the gripper comes near; 0: none
    counts: bool = True  # whether the interference has happened when this, the last stop, is over


class Scene(NamedTuple):
    """What the person sees: the truth, and what is asked for."""

    bodies: Mapping[int, Body]  # by id
    gripper: Floats  # (3,), m
    closing: Floats  # (3,), the direction in which its fingers close
    raised: Sequence[int]  # cubes that the robot holds
    standing: tuple[
        int, ...
    ]  # the cubes of the tower that is being built that stand as they should, from the bottom up
    wanted: int | None  # the one that comes next; None: no tower is to be built any more
    hidden: frozenset[int]  # cubes of which the robot's camera does not see the middle
    rng: np.random.Generator

    @property
    def idle(self) -> list[int]:
        """Cubes that stand in no tower, with nothing on them, and not in the robot's hand."""
        return [
            number
            for number, body in self.bodies.items()
            if number not in self.standing and number not in self.raised and not self.is_covered(body)
        ]

    def is_covered(self, body: Body) -> bool:
        """Whether something is on a cube."""
        return any(
            np.linalg.norm(other["pose"][:2, 3] - body["pose"][:2, 3]) < 0.7 * body["side_m"]
            and other["pose"][2, 3] > body["pose"][2, 3] + 0.5 * body["side_m"]
            for other in self.bodies.values()
        )

    def is_free(self, *numbers: int) -> bool:
        """Whether the robot's gripper is away from cubes, and does not hold them."""
        places = [self.bodies[number]["pose"][:3, 3] for number in numbers]
        near = any(np.linalg.norm(place - self.gripper) < _KEEPS_M for place in places)
        return not near and not set(numbers).intersection(self.raised)

    def spot(self, number: int) -> Floats:
        """(3,) where a cube can be put down on the table, away from all there is, and from where it is; m."""
        body = self.bodies[number]
        circles = [(each["pose"][:2, 3], _DIAGONAL * each["side_m"]) for each in self.bodies.values()]
        spots = free_spots(circles, _DIAGONAL * body["side_m"])
        return np.array([*spots[self.rng.integers(1 + len(spots) // 2)], body["side_m"] / 2])


Act = Callable[[Scene], "list[Stop] | None"]
"""The stops of an interference; None: it cannot be done now."""


def acted(belief: Value, scene: Scene, names: Sequence[str], interval_s: float) -> tuple[Value, Guest | None]:
    """What the person believes a frame later, and what the hand does in it; None: it is not there.

    The belief: ``done``, how many interferences are over; ``pause_s`` until the next one (None: it cannot begin yet);
    ``stops`` of the present one, maps of `Stop`'s fields; ``hand`` (world_from_palm), ``velocity`` (6,), ``target`` (of
    the hand, as ``hand``), ``holds`` (palm_from_cube; None: nothing), ``late_s`` (how long the present stop takes
    longer than it should)."""
    if not belief["stops"]:
        belief = _begun(belief, scene, names, interval_s)
        if not belief["stops"]:
            return belief, None
    stop = Stop(**belief["stops"][0])
    if stop.unless_near and not scene.is_free(stop.unless_near):
        belief = {**belief, "stops": ({**belief["stops"][-1], "counts": False},), "late_s": 0.0}
        stop = Stop(**belief["stops"][0])
    belief = _gripping(belief, stop, scene)
    target, there = _advanced(belief["target"], stop, scene, interval_s)
    grip = Grip(stop.grip, belief["holds"]) if belief["holds"] is not None else None
    guest = Guest(belief["hand"], belief["velocity"], belief["target"], target, grip)
    belief = {**belief, "target": target, "late_s": belief["late_s"] + interval_s if there else 0.0}
    return belief, guest


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
    return after if left else {**after, "holds": None, "done": belief["done"] + stop.counts, "pause_s": None}


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
    "done": 0,
    "pause_s": None,
    "stops": (),
    "holds": None,
    "late_s": 0.0,
    "hand": make_pose(np.eye(3), _HOME_M),
    "target": make_pose(np.eye(3), _HOME_M),
    "velocity": np.zeros(6),
}
"""The belief before anything has happened."""


def can_begin(belief: Value, scene: Scene, names: Sequence[str]) -> bool:
    """Whether something is under way, or will be."""
    at = belief["done"]
    return bool(belief["stops"]) or (at < len(names) and ACTS[names[at]](scene) is not None)


def scene_of(belief: Value, order: tuple[int, ...], height: int, rng: np.random.Generator) -> Scene:
    """What the person sees of a world's belief, where so many cubes of a tower stand as they should."""
    bodies = {body["id"]: body for body in belief["bodies"]}
    middles = np.stack([body["pose"][:3, 3] for body in belief["bodies"]])
    seen = transform(invert(belief["camera"]), middles)
    pixels = project(seen, belief["intrinsics"])
    inside = (seen[:, 2] > 0.0) & np.all((pixels > 0) & (pixels < np.array(belief["size"])), axis=1)
    hidden = frozenset(number for number, shown in zip(bodies, inside, strict=True) if not shown)
    wanted = order[height] if height < len(order) else None
    gripper = gripper_at(belief["joints"])
    return Scene(bodies, gripper[:3, 3], gripper[:3, 1], belief["raised"], order[:height], wanted, hidden, rng)


def generator(seed: int, scene: int, number: int) -> np.random.Generator:
    """What the interference of this number of a scene is drawn from."""
    return np.random.default_rng([seed, scene, number, _PERSON])


def _begun(belief: Value, scene: Scene, names: Sequence[str], interval_s: float) -> Value:
    """The belief with the next interference, if it begins now."""
    if belief["done"] >= len(names):
        return belief
    stops = ACTS[names[belief["done"]]](scene)
    pause_s = belief["pause_s"]
    if pause_s is None and stops is not None:
        pause_s = float(scene.rng.uniform(0.0, PAUSE_S))
    elif pause_s is not None:
        pause_s = max(pause_s - interval_s, 0.0)
    if stops is None or pause_s is None or pause_s > 0.0:
        return {**belief, "pause_s": pause_s}
    side = np.sign(stops[0].to[1]) or 1.0
    home = _HOME_M * (1.0, side, 1.0)
    there = make_pose(np.eye(3), home)
    every = tuple(stop._asdict() for stop in (*stops, Stop(home)))
    return {**belief, "pause_s": pause_s, "stops": every, "hand": there, "target": there, "velocity": np.zeros(6)}


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


def _upon(body: Body, place: Floats | None = None) -> Floats:
    """Where the palm is on a cube, which may be at another place; m."""
    at = body["pose"][:3, 3] if place is None else place
    return np.asarray(at + np.array([0.0, 0.0, body["side_m"] / 2 + GUEST_HALF_M[2] + 0.001]))


def _over(at: Floats, height_m: float = _OVER_M) -> Floats:
    return np.asarray(at + np.array([0.0, 0.0, height_m]))


def _carried(scene: Scene, number: int, place: Floats, yaw: float = 0.0) -> list[Stop]:
    """Take a cube from above, and put it down elsewhere, turned."""
    body = scene.bodies[number]
    taken, left = _upon(body), _upon(body, place)
    top = max(each["pose"][2, 3] + each["side_m"] for each in scene.bodies.values())
    clear = [np.array([*at[:2], max(at[2], top + body["side_m"]) + 0.06]) for at in (taken, left)]
    return [
        Stop(_over(taken), unless_near=number),
        Stop(taken, 0.2, unless_near=number),
        Stop(clear[0], 0.3, number),
        Stop(clear[1], FAST_M_S, number, yaw),
        Stop(_over(left, 0.001), 0.15, number, yaw, 0.2),
        Stop(_over(left), 0.2, yaw=yaw),
    ]


def _swept(scene: Scene, number: int, speed: float) -> list[Stop]:
    """Push a cube sideways with the side of the hand."""
    body = scene.bodies[number]
    side = float(scene.rng.choice([-1.0, 1.0]))
    middle = body["pose"][:3, 3].copy()
    middle[2] = max(middle[2], GUEST_HALF_M[2] + 0.003)
    reach = body["side_m"] / 2 * float(np.abs(body["pose"][1, :3]).sum()) + GUEST_HALF_M[1]
    before, after = (middle + np.array([0.0, side * off, 0.0]) for off in (reach + 0.06, reach - _PUSHED_M))
    return [
        Stop(_over(before, 0.15), unless_near=number),
        Stop(before, 0.3, unless_near=number),
        Stop(after, speed),
        Stop(before, 0.3),
        Stop(_over(before, 0.15)),
    ]


def _knock(scene: Scene) -> list[Stop] | None:
    if len(scene.standing) < 2 or not scene.is_free(*scene.standing):
        return None
    return _swept(scene, scene.standing[-1], 0.35)


def _push(scene: Scene) -> list[Stop] | None:
    if not scene.standing or not scene.is_free(*scene.standing):
        return None
    return _swept(scene, scene.standing[0], SLOW_M_S)


def _wanted_idle(scene: Scene) -> int | None:
    """The cube that comes next, if a person can take it now."""
    return scene.wanted if scene.wanted in scene.idle and scene.is_free(scene.wanted) else None


def _move(scene: Scene) -> list[Stop] | None:
    number = _wanted_idle(scene)
    return None if number is None else _carried(scene, number, scene.spot(number))


def _remove(scene: Scene) -> list[Stop] | None:
    number = _wanted_idle(scene)
    if number is None:
        return None
    body, place = scene.bodies[number], scene.spot(number)
    taken, left = _upon(body), _upon(body, place)
    away = _HOME_M * (1.0, np.sign(taken[1]) or 1.0, 1.0)
    return [
        *(Stop(_over(taken), unless_near=number), Stop(taken, 0.2, unless_near=number)),
        Stop(_over(taken, 0.2), 0.3, number),
        Stop(away, FAST_M_S, number, dwell_s=float(scene.rng.uniform(*AWAY_S))),
        *(Stop(_over(left, 0.2), FAST_M_S, number), Stop(_over(left, 0.001), 0.15, number, dwell_s=0.2)),
        Stop(_over(left), 0.2),
    ]


def _cover(scene: Scene) -> list[Stop] | None:
    wanted = _wanted_idle(scene)
    others = [number for number in scene.idle if number != wanted and scene.is_free(number)]
    if wanted is None or not others:
        return None
    number, body = others[0], scene.bodies[wanted]
    height = (body["side_m"] + scene.bodies[number]["side_m"]) / 2
    return _carried(scene, number, body["pose"][:3, 3] + np.array([0.0, 0.0, height]))


def _swap(scene: Scene) -> list[Stop] | None:
    flat = [number for number in scene.idle if scene.bodies[number]["pose"][2, 3] < scene.bodies[number]["side_m"]]
    if len(flat) < 2 or not scene.hidden.intersection(flat[:2]) or not scene.is_free(*flat[:2]):
        return None
    one, other = flat[:2]
    spot = scene.spot(one)
    lifted = (scene.bodies[one]["side_m"] - scene.bodies[other]["side_m"]) / 2 * np.array([0.0, 0.0, 1.0])
    places = {number: scene.bodies[number]["pose"][:3, 3] for number in (one, other)}
    aside = dict(scene.bodies) | {one: {**scene.bodies[one], "pose": make_pose(np.eye(3), spot)}}
    return [
        *_carried(scene, one, spot),
        *_carried(scene, other, places[one] - lifted),
        *_carried(scene._replace(bodies=aside), one, places[other] + lifted),
    ]


def _take(scene: Scene) -> list[Stop] | None:
    """From beside, where the fingers are not."""
    if not scene.raised:
        return None
    number = scene.raised[0]
    body = scene.bodies[number]
    if body["pose"][2, 3] < body["side_m"] or np.linalg.norm(body["pose"][:3, 3] - scene.gripper) > 0.03:
        return None
    way = np.cross(scene.closing, (0.0, 0.0, 1.0))
    way *= np.copysign(1.0, way @ (_HOME_M - body["pose"][:3, 3])) / np.linalg.norm(way)
    beside = (body["side_m"] / 2 + float(np.abs(way[:2]) @ GUEST_HALF_M[:2]) + 0.003) * way
    place = scene.spot(number)
    yaw = _with_room(scene, number, place, beside)
    turned = exp_so3(np.array([0.0, 0.0, yaw]))
    left = place + turned @ beside
    back = left + 0.06 * (turned @ way)
    top = max(each["pose"][2, 3] + each["side_m"] for each in scene.bodies.values())
    return [
        Stop(beside + 0.10 * way, follows=number),
        Stop(beside, 0.4, follows=number),
        Stop(0.14 * way, 0.4, number, onward=True),
        Stop(np.array([*left[:2], top + 0.03]), 0.4, number, yaw),
        Stop(_over(left, 0.002), 0.15, number, yaw, 0.2),
        Stop(back, 0.2, yaw=yaw),
        Stop(_over(back), 0.3, yaw=yaw),
    ]


def _with_room(scene: Scene, number: int, place: Floats, beside: Floats) -> float:
    """How a hand is turned that puts a cube down from beside it, so that it is away from all else; rad."""
    others = [body["pose"][:2, 3] for other, body in scene.bodies.items() if other != number]
    turns = np.array([0.0, 1.0, 2.0, -1.0]) * np.pi / 2
    palms = [place + 1.5 * exp_so3(np.array([0.0, 0.0, turn])) @ beside for turn in turns]
    rooms = [min((float(np.linalg.norm(palm[:2] - at)) for at in others), default=1.0) for palm in palms]
    return float(turns[int(np.argmax(rooms))])


def _help(scene: Scene) -> list[Stop] | None:
    number = _wanted_idle(scene)
    if number is None or not scene.standing or not scene.is_free(scene.standing[-1]):
        return None
    top, body = scene.bodies[scene.standing[-1]], scene.bodies[number]
    place = top["pose"][:3, 3] + np.array([0.0, 0.0, (top["side_m"] + body["side_m"]) / 2])
    return _carried(scene, number, place, _yaw_between(body, top))


def _yaw_between(body: Body, other: Body) -> float:
    """By how much a cube is turned at least about the vertical, so that its sides are along another one's; rad."""
    level = [each["pose"][:3, int(np.abs(each["pose"][2, :3]).argmin())] for each in (body, other)]
    one, two = (float(np.arctan2(axis[1], axis[0])) for axis in level)
    return (two - one + np.pi / 4) % (np.pi / 2) - np.pi / 4


ACTS: Mapping[str, Act] = {
    "knock": _knock,  # the tower over
    "move": _move,  # the cube that is about to be taken
    "swap": _swap,  # two cubes, one of which the camera does not see
    "take": _take,  # the cube out of the robot's hand
    "help": _help,  # put the next cube on
    "cover": _cover,  # the cube that is needed, with another one
    "remove": _remove,  # that one, and bring it back later, elsewhere
    "push": _push,  # the tower's base
}
"""By name, what a person does."""
