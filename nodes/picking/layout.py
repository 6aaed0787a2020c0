"""How the cubes of a scene are laid out, by its number, as far as everybody may know it.

The plan gives each cube a place. Where it really stands is the world's alone: it moves every cube off its place
(`hierax.nodes.picking.world`). What the trackers begin with is the plan with an error of its own, as a first look at
the scene would have."""

from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose

# Of the table, what the arm reaches and the camera sees.
TABLE_MIDDLE_M = np.array([0.5, 0.0, 0.0])

# By id, from 1: sides and RGB of the cubes.
SIDES_M = (0.055, 0.040, 0.048, 0.044, 0.051, 0.046)
COLOURS = ((196, 52, 44), (45, 96, 190), (58, 150, 72), (235, 190, 40), (120, 70, 160), (60, 170, 180))
CUBES = 5  # on the table, where nothing else is said

# How far a first guess is off the plan at most, in place and in turn.
GUESS_M = 0.003
GUESS_RAD = np.radians(1.2)

_CORNER_M = np.array([0.40, -0.17])
_FAR_CORNER_M = np.array([0.60, 0.17])
_GAP_M = 0.030
_BESIDE_M = (0.008, 0.018)
_TRIES = 10_000

_PLAN, _GUESS = 1, 2


class Place(NamedTuple):
    """Where a cube is to stand."""

    id: int  # its label, from 1, which is its model's number too
    side_m: float  # length of its edges
    colour: tuple[int, int, int]  # RGB, 0 to 255
    pose: Floats  # world_from_object, upright
    below: int  # id of the cube that it stands on; 0 for the table


def planned(scene: int, cubes: int = CUBES) -> tuple[Place, ...]:
    """The places of all cubes, 1 to 6, of a scene, from 0. In every other scene the second cube stands on the first.
    The third one stands close to the first, so that one of them hides the other and keeps the gripper from some of its
    sides. Raises ValueError: a number is out of its range, or there is no room."""
    check_cubes(cubes)
    if scene < 0:
        raise ValueError(f"scene is {scene}; expected a number from 0")
    rng = np.random.default_rng([scene, _PLAN])
    places: list[Place] = []
    for number, (side, colour) in enumerate(zip(SIDES_M[:cubes], COLOURS, strict=False), start=1):
        if number == 2 and scene % 2 == 1:
            centre, below = places[0].pose[:2, 3] + rng.uniform(-0.006, 0.006, 2), 1
            height = places[0].side_m + side / 2
        else:
            centre, below, height = _free_spot(rng, places, number, side), 0, side / 2
        yaw = exp_so3(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        places.append(Place(number, side, colour, make_pose(yaw, np.array([*centre, height])), below))
    return tuple(places)


def check_cubes(cubes: int) -> None:
    """Raises ValueError: no scene has so many cubes."""
    if not 1 <= cubes <= len(SIDES_M):
        raise ValueError(f"cubes is {cubes}; expected a number from 1 to {len(SIDES_M)}")


def guessed(scene: int, cubes: int = CUBES) -> list[Floats]:
    """world_from_object of all cubes as the trackers are told at the start: the plan, a little wrong."""
    rng = np.random.default_rng([scene, _GUESS])
    return [disturbed(place.pose, _within(rng, GUESS_M), _within(rng, GUESS_RAD)) for place in planned(scene, cubes)]


def disturbed(pose: Floats, shift_m: Floats, turn_rad: Floats) -> Floats:
    """A pose shifted, and turned about its own origin, along and about the world's axes."""
    return make_pose(exp_so3(turn_rad) @ pose[:3, :3], pose[:3, 3] + shift_m)


def _free_spot(rng: np.random.Generator, places: list[Place], number: int, side: float) -> Floats:
    """A place where a cube has room however the cubes are turned; the third is close to the first."""
    others = [place for place in places if not (place.below or (number == 3 and place.id == 1))]
    for _ in range(_TRIES):
        spot = rng.uniform(_CORNER_M, _FAR_CORNER_M)
        if number == 3:
            angle = rng.uniform(-np.pi, np.pi)
            distance = _radius(places[0].side_m) + _radius(side) + rng.uniform(*_BESIDE_M)
            spot = places[0].pose[:2, 3] + distance * np.array([np.cos(angle), np.sin(angle)])
        apart = [(np.linalg.norm(spot - place.pose[:2, 3]), _radius(place.side_m)) for place in others]
        gaps = [float(distance) - radius - _radius(side) for distance, radius in apart]
        inside = bool(np.all(spot >= _CORNER_M) and np.all(spot <= _FAR_CORNER_M))
        if inside and min(gaps, default=np.inf) >= _GAP_M:
            return spot
    raise ValueError(f"there is no room for cube {number}")


def _radius(side: float) -> float:
    return side / 2**0.5


def _within(rng: np.random.Generator, radius: float) -> Floats:
    """A vector in a ball, anywhere in it alike."""
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * radius * np.cbrt(rng.uniform()))
