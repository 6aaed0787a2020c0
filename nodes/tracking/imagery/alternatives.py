"""Where else a body may be than it is imagined: poses to look for it at, by what physics leaves open.

Mental imagery proposes, the image decides: each of these poses is drawn as the expected one is, with what would be
seen of it there.

And what it says of a body that it lies on something."""

from collections.abc import Sequence
from itertools import product
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.imagery.proposals import outermost, stable_faces
from hierax.nodes.tracking.math.geometry import NO_POSES, Floats, exp_se3, exp_so3, make_pose, transform, unit
from hierax.nodes.tracking.schema import Body


def _normal_table() -> Floats:
    """(n, 6) evenly spread draws of standard normal variables, any few rows that follow one another, too."""
    table = np.zeros((const.DRAWS, len(const.BASES)))
    for column, base in enumerate(const.BASES):
        for row in range(const.DRAWS):
            number, share, value = row + 20, 1.0 / base, 0.0
            while number:
                number, digit = divmod(number, base)
                value += share * digit
                share /= base
            table[row, column] = NormalDist().inv_cdf(value)
    return table


_DRAWS = _normal_table()


def elsewhere(pose: Floats, covariance: Floats, support: Floats, turn: int) -> Floats:
    """Poses (`AT_ONCE`, 4, 4) that a body may have as well as that which it is imagined at, with its covariance (6, 6),
    twist in the object's frame; other turns give other poses. `support` is (3,) a unit vector upwards in the object's
    frame where the body stands on something: there it may be elsewhere and turned, but not higher or tilted; zeros
    where nothing carries it."""
    directions = _open(support)
    within = directions.T @ covariance @ directions
    values, vectors = np.linalg.eigh(within)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    rows = (np.arange(const.AT_ONCE) + const.AT_ONCE * turn) % const.DRAWS
    # The widest direction gets the evenest draws.
    draws = _DRAWS[rows][:, : len(values)][:, ::-1]
    twists = draws @ spread.T @ directions.T
    return np.stack([pose @ exp_se3(twist) for twist in twists])


def _open(support: Floats) -> Floats:
    """(6, n): twists that what carries a body leaves open."""
    if not support.any():
        return np.eye(6)
    level = np.linalg.svd(support[None])[2][1:]
    directions = np.zeros((6, 3))
    directions[:3, :2] = level.T
    directions[3:, 2] = support
    return directions


class Footing(NamedTuple):
    """How a body may rest."""

    corners: Floats  # (n, 3) of its convex hull, object's frame
    centre: Floats  # (3,) of its bounding box
    faces: list[Floats]  # unit vectors (3,) that point downwards then, object's frame


def footing_of(vertices: Floats) -> Footing:
    """How a body of these vertices (n, 3) may rest."""
    corners = outermost(vertices)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    return Footing(corners, centre, stable_faces(corners, centre))


def set_down(pose: Floats, footing: Footing, eye: Floats, heights: Sequence[float], turn: int) -> Floats:
    """Poses (n, 4, 4) in which a body rests at heights, m, that look about as it does at a pose in which it cannot:
    farther away or nearer along the line of sight from `eye` (3,), on those of its faces that are nearly down, turned
    about the vertical; other turns give others. None for what has no face to rest on, or is not below the eye."""
    away = transform(pose, footing.centre[None])[0] - eye
    if away[2] > -const.SLANT * float(np.linalg.norm(away)):
        return NO_POSES
    lowest = [face for face in footing.faces if float(face @ pose[2, :3]) < -const.NEARLY_DOWN]
    ways = list(product(lowest, heights))
    found = []
    for row in range(const.AT_ONCE * turn, const.AT_ONCE * (turn + 1)) if ways else ():
        down, height = ways[row % len(ways)]
        yaw = np.sqrt(const.BODY_ASTRAY[5, 5]) * _DRAWS[row // len(ways) % const.DRAWS, 0]
        rotation = exp_so3(np.array([0.0, 0.0, yaw])) @ _levelled(pose[:3, :3], down)
        foot = float(((footing.corners - footing.centre) @ rotation[2]).min())
        centre = eye + away * ((height - foot - eye[2]) / away[2])
        found.append(make_pose(rotation, centre - rotation @ footing.centre))
    return np.array(found).reshape(-1, 4, 4)


def tops_behind(pose: Floats, standing: Sequence[Body], eye: Floats) -> list[float]:
    """How high, m, those of the standing bodies are to whose upper face the line of sight from `eye` (3,) to a body at
    a pose goes, or would go on to."""
    away = pose[:3, 3] - eye
    found = []
    for other in standing:
        corners = transform(other["pose"], other["model"]["vertices"])
        low, high = corners.min(axis=0), corners.max(axis=0)
        there = eye + away * ((high[2] - eye[2]) / min(float(away[2]), -1e-6))
        if ((there[:2] > low[:2]) & (there[:2] < high[:2])).all():
            found.append(float(high[2]))
    return found


def _levelled(rotation: Floats, down: Floats) -> Floats:
    """(3, 3) a rotation, turned on by as little as has a direction of the object's frame point downwards."""
    ahead = rotation @ down
    axis = np.array([-ahead[1], ahead[0], 0.0])  # ahead × downwards
    angle = np.arctan2(np.linalg.norm(axis), -ahead[2])
    return np.asarray(exp_so3(angle * unit(axis)) @ rotation)


def resting(body: Body, carried: bool) -> Body:
    """What rests on something is as high, and as upright, as that leaves it: no longer less certain than that. Whether
    something below keeps it from falling is told; of the body "support", "stands" and "covariance" follow."""
    velocity, pose = body["velocity"], body["pose"]
    moves = np.abs(velocity[3:5]).max() > const.RESTING_RAD_S or abs(velocity[2]) > const.RESTING_M_S
    up = pose[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    if moves or not carried or not _stands(body["model"]["vertices"] @ pose[:3, :3].T):
        return {**body, "support": up if carried else np.zeros(3), "stands": False}
    return {**body, "covariance": at_rest(body["covariance"], slice(6), up), "support": up, "stands": True}


def at_rest(covariance: Floats, pose: slice, up: Floats) -> Floats:
    """A covariance (n, n) where something rests, whose pose, a twist in its frame, has these rows: what carries it
    tells its height and how it is tilted. `up` is (3,) upwards in that frame."""
    directions = np.zeros((3, 6))
    directions[0, :3] = up
    directions[1:, 3:] = np.linalg.svd(up[None])[2][1:]
    for direction, spread in zip(directions, (const.RESTING_M, const.RESTING_RAD, const.RESTING_RAD), strict=True):
        along = covariance[:, pose] @ direction
        variance = float(direction @ along[pose])
        if variance > spread**2:
            covariance = covariance - np.outer(along, along) * ((variance - spread**2) / variance**2)
    return covariance


def _stands(vertices: Floats) -> bool:
    """Whether a body, its vertices (n, 3) turned as it is, lies on a face, not on an edge or a corner."""
    heights = vertices[:, 2]
    lowest = vertices[heights < heights.min() + const.FLAT_M, :2]
    spread = lowest - lowest.mean(axis=0)
    return len(lowest) > 2 and float(np.linalg.eigvalsh(spread.T @ spread / len(lowest))[0]) > const.BASE_M**2
