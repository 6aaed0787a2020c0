"""What it says of a body that it lies on something."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import Body

# How certain the height and the tilt of a body at rest are, and how fast one moves that is not.
_RESTING_M = 0.0005
_RESTING_RAD = 0.004
_RESTING_M_S = 0.1
_RESTING_RAD_S = 0.3

# What lies on a face has corners no higher than this above the lowest, and spread as far (standard deviation).
_FLAT_M = 0.004
_BASE_M = 0.003


def resting(body: Body, carried: bool) -> Body:
    """What rests on something is as high, and as upright, as that leaves it: no longer less certain than that.

    Args:
        body: as `hierax.nodes.tracking.spatial.SpatialNode` has it.
        carried: whether something below keeps it from falling.

    Returns:
        The same with its "support", whether it "stands" on a face there, and its "covariance" as that leaves it.
    """
    velocity, pose = body["velocity"], body["pose"]
    moves = np.abs(velocity[3:5]).max() > _RESTING_RAD_S or abs(velocity[2]) > _RESTING_M_S
    up = pose[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    if moves or not carried or not _stands(body["model"]["vertices"] @ pose[:3, :3].T):
        return {**body, "support": up if carried else np.zeros(3), "stands": False}
    level = np.linalg.svd(up[None])[2][1:]
    directions = np.zeros((3, 6))
    directions[0, :3] = up
    directions[1:, 3:] = level
    covariance = body["covariance"]
    for direction, spread in zip(directions, (_RESTING_M, _RESTING_RAD, _RESTING_RAD), strict=True):
        along = covariance @ direction
        variance = float(direction @ along)
        if variance > spread**2:
            covariance = covariance - np.outer(along, along) * ((variance - spread**2) / variance**2)
    return {**body, "covariance": covariance, "support": up, "stands": True}


def _stands(vertices: Floats) -> bool:
    """Whether a body, its vertices (n, 3) turned as it is, lies on a face, not on an edge or a corner."""
    heights = vertices[:, 2]
    lowest = vertices[heights < heights.min() + _FLAT_M, :2]
    spread = lowest - lowest.mean(axis=0)
    return len(lowest) > 2 and float(np.linalg.eigvalsh(spread.T @ spread / len(lowest))[0]) > _BASE_M**2
