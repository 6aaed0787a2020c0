"""How far control points stand from other edges beside them: edges that are near one another move one another's peaks.

Blurred, two parallel edges a few pixels apart are one peak, or two that are pulled together: so it is beside a face
that is seen nearly edge-on, or where two objects meet. What is matched there says little, and both edges would
claim the same one in the image.
"""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.constants import PARALLEL
from hierax.nodes.tracking.math.batched import pixels_of, placed
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats
from hierax.nodes.tracking.model.controls import Controls

# Parallel edges that far apart have peaks of their own: three standard deviations of the lens's blur and ours.
_APART_PX = 3.0

_BEYOND_PX = 4.0  # how far beyond its last control points an edge goes on

# Edges that are as near as this, and in depth by this share of it, are one that is listed twice.
_SAME_PX = 0.7
_SAME_DEPTH = 0.005


def apartness(controls: Controls, poses: Floats, intrinsics: Array) -> Floats:
    """(n,) 0 to 1 of each control point how far its edge stands alone where some poses put it.

    Args:
        controls: of all objects; poses: (m, 4, 4) camera_from_object; intrinsics: (4,) fx, fy, cx, cy in pixels.
    """
    if not len(controls.owners):
        return np.zeros(0)
    seen = placed(poses, controls.owners, controls.points)
    depth, pixels = np.maximum(seen[:, 2], NEAREST_M), pixels_of(seen, intrinsics)
    first = np.nonzero(np.diff(controls.numbers, prepend=-1))[0]
    last = np.append(first[1:], len(pixels)) - 1
    # Each edge as the line from its first control point to its last.
    length = np.hypot(*(pixels[last] - pixels[first]).T)
    along = (pixels[last] - pixels[first]) / np.maximum(length, 1e-9)[:, None]
    own = np.repeat(np.arange(len(first)), last - first + 1)
    away = pixels[:, None] - pixels[first]
    place = away[..., 0] * along[:, 0] + away[..., 1] * along[:, 1]
    distance = np.abs(away[..., 0] * along[:, 1] - away[..., 1] * along[:, 0])
    beside = (place > -_BEYOND_PX) & (place < length + _BEYOND_PX) & (distance < _APART_PX)
    beside &= (np.abs(along @ along.T) > PARALLEL)[own]
    beside[np.arange(len(own)), own] = False
    rows, edges = np.nonzero(beside)
    there = depth[first] + (depth[last] - depth[first]) * np.clip(place / np.maximum(length, 1e-9), 0.0, 1.0)
    same = (distance[rows, edges] < _SAME_PX) & (np.abs(there[rows, edges] / depth[rows] - 1.0) < _SAME_DEPTH)
    seen_there = np.add.reduceat(controls.visible, first) / (last - first + 1)
    pull = seen_there[edges] * (1.0 - (distance[rows, edges] / _APART_PX) ** 2)
    pulled = np.zeros(len(own))
    np.maximum.at(pulled, rows, np.where(same, 0.0, pull))
    apart: Floats = 1.0 - np.clip(pulled, 0.0, 1.0)
    return apart
