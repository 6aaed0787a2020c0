"""Where else a body may be than it is imagined: poses to look for it at, by what physics leaves open.

Mental imagery proposes, the image decides: each of these poses is drawn as the expected one is, with what would be
seen of it there.

And what it says of a body that it lies on something."""

from statistics import NormalDist

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.geometry import Floats, exp_se3
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
