"""What somebody does to towers, by movements of a hand: what each interference asks for, and from stop to stop its way.

One can be done when, by the truth, it means something, as there are two cubes at least in a tower that is knocked over;
and it is due from when the tower is as high as is drawn for it."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.workcell import GUEST_HALF_M
from hierax.nodes.tower.placing import free_spots, least_turn
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose

Body = Mapping[str, Any]

HOME_M = np.array([0.95, 0.45, 0.35])  # where the hand comes from, and goes to; or as far on the other side
FAST_M_S, SLOW_M_S = 0.8, 0.08
AWAY_S = (5.0, 10.0)  # how long a cube that was removed is away, from and to
KEEPS_M = 0.15  # a careful person does not come so near to the gripper
_OVER_M = 0.10  # so high over what it grips the hand comes and goes
_PUSHED_M = 0.05
_DIAGONAL = 2**0.5


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
    brings: int = 0  # the cube that is brought back in place of this stop, to where there is room by then; 0: none


class Drawn(NamedTuple):
    """What is drawn for an interference."""

    rng: np.random.Generator
    height: float  # between 0 and 1: how high the tower is when it is due


class Scene(NamedTuple):
    """What the person sees: the truth, and what is asked for."""

    bodies: Mapping[int, Body]  # by id
    gripper: Floats  # (3,), m
    closing: Floats  # (3,), the direction in which its fingers close
    raised: Sequence[int]  # cubes that the robot holds
    standing: tuple[int, ...]  # of the tower that is being built, those that stand as they should, from the bottom up
    wanted: int | None  # the one that comes next; None: no tower is to be built any more
    hidden: frozenset[int]  # cubes of which the robot's camera does not see the middle
    whole: int  # how many cubes the tower that is being built has once it is done
    rng: np.random.Generator  # as `Drawn` has it, and so is the next
    drawn: float

    @property
    def idle(self) -> list[int]:
        """Cubes that stand in no tower, with nothing on them, and not in the robot's hand."""
        return [
            number
            for number, body in self.bodies.items()
            if number not in self.standing and number not in self.raised and not self.is_covered(body)
        ]

    @property
    def top_m(self) -> float:
        """Above all cubes, m."""
        return max(float(body["pose"][2, 3] + body["side_m"]) for body in self.bodies.values())

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
        near = any(np.linalg.norm(place - self.gripper) < KEEPS_M for place in places)
        return not near and not set(numbers).intersection(self.raised)

    def spot(self, number: int) -> Floats:
        """(3,) where a cube can be put down on the table, away from all there is, and from where it is; m."""
        body = self.bodies[number]
        circles = [(each["pose"][:2, 3], _DIAGONAL * each["side_m"]) for each in self.bodies.values()]
        spots = free_spots(circles, _DIAGONAL * body["side_m"])
        return np.array([*spots[self.rng.integers(1 + len(spots) // 2)], body["side_m"] / 2])


Act = Callable[[Scene], "list[Stop] | None"]
"""The stops of an interference; None: it cannot be done now."""


def _upon(body: Body, place: Floats | None = None) -> Floats:
    """Where the palm is on a cube, which may be at another place; m."""
    at = body["pose"][:3, 3] if place is None else place
    return np.asarray(at + np.array([0.0, 0.0, body["side_m"] / 2 + GUEST_HALF_M[2] + 0.001]))


def _over(at: Floats, height_m: float = _OVER_M) -> Floats:
    return np.asarray(at + np.array([0.0, 0.0, height_m]))


def _taken(number: int, taken: Floats) -> list[Stop]:
    """Come to a cube from above."""
    return [Stop(_over(taken), unless_near=number), Stop(taken, 0.2, unless_near=number)]


def _carried(scene: Scene, number: int, place: Floats, yaw: float = 0.0) -> list[Stop]:
    """Take a cube from above, and put it down elsewhere, turned."""
    body = scene.bodies[number]
    taken, left = _upon(body), _upon(body, place)
    clear = [np.array([*at[:2], max(at[2], scene.top_m + body["side_m"]) + 0.06]) for at in (taken, left)]
    return [
        *_taken(number, taken),
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
    level = scene.rng.integers(1, len(scene.standing))  # what stands on that one falls with it
    return _swept(scene, scene.standing[level], 0.35)


def _push(scene: Scene) -> list[Stop] | None:
    if len(scene.standing) < 2 or not scene.is_free(*scene.standing):
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
    taken = _upon(scene.bodies[number])
    away = HOME_M * (1.0, np.sign(taken[1]) or 1.0, 1.0)
    return [
        *_taken(number, taken),
        Stop(_over(taken, 0.2), 0.3, number),
        Stop(away, FAST_M_S, number, dwell_s=float(scene.rng.uniform(*AWAY_S))),
        Stop(away, FAST_M_S, number, brings=number),
    ]


def brought(scene: Scene, number: int) -> list[Stop]:
    """Put a cube that was away down on the table."""
    left = _upon(scene.bodies[number], scene.spot(number))
    return [
        Stop(_over(left, 0.2), FAST_M_S, number),
        Stop(_over(left, 0.001), 0.15, number, dwell_s=0.2),
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
    pairs = (pair for pair in combinations(flat, 2) if scene.hidden.intersection(pair) and scene.is_free(*pair))
    pair = next(pairs, None)
    if pair is None:
        return None
    one, other = pair
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
    way *= np.copysign(1.0, way @ (HOME_M - body["pose"][:3, 3])) / np.linalg.norm(way)
    beside = (body["side_m"] / 2 + float(np.abs(way[:2]) @ GUEST_HALF_M[:2]) + 0.003) * way
    place = scene.spot(number)
    yaw = _with_room(scene, number, place, beside)
    turned = exp_so3(np.array([0.0, 0.0, yaw]))
    left = place + turned @ beside
    back = left + 0.06 * (turned @ way)
    return [
        Stop(beside + 0.10 * way, follows=number),
        Stop(beside, 0.4, follows=number),
        Stop(0.14 * way, 0.4, number, onward=True),
        Stop(np.array([*left[:2], scene.top_m + 0.03]), 0.4, number, yaw),
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
    return _carried(scene, number, place, least_turn(body["pose"], top["pose"]))


ACTS: Mapping[str, Act] = {
    "knock": _knock,  # the tower over, from one of its cubes on that is not the lowest
    "move": _move,  # the cube that is about to be taken
    "swap": _swap,  # two cubes, one of which the camera does not see
    "take": _take,  # the cube out of the robot's hand
    "help": _help,  # put the next cube on
    "cover": _cover,  # the cube that is needed, with another one
    "remove": _remove,  # that one, and bring it back later, elsewhere
    "push": _push,  # the tower's base
}
"""By name, what a person does."""

_HEIGHTS: Mapping[str, tuple[int, int]] = {"knock": (2, 0), "push": (2, 0), "cover": (1, 2), "swap": (1, 3)}
_NEXT = (1, 1)  # of what is done to the cube that comes next
"""How many cubes of a tower stand at least when something is due, and how many are still to come at least."""


def is_due(name: str, scene: Scene) -> bool:
    """Whether the tower is as high as was drawn, among the heights at which the interference of a name can be done."""
    least, to_come = _HEIGHTS.get(name, _NEXT)
    heights = max(scene.whole - to_come - least, 0) + 1
    return len(scene.standing) >= least + int(scene.drawn * heights)
