"""Light and soft shadows of the simulated scene.

A lamp shaped like a disc stands far away. Its light is the mean of that of points on the disc; from each of them a
convex part of a body throws a convex polygon of shadow on a plane. So shadows are sharp where things touch and get
softer with distance, as they should: a shadow that is merely blurred darkens the table on the lit side of a body too,
and every edge there would seem to be half a millimetre farther out than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, Size
from hierax.nodes.tracking.simworld.shapes import Face

LAMP_POINTS = 9  # shadows are the mean of those that so many points of a lamp throw


@dataclass(frozen=True)
class Lamp:
    """A disc that shines from far away, and the light that comes from everywhere."""

    # from the scene to the disc's middle, world frame; made a unit vector
    towards: tuple[float, float, float] = (-0.42, -0.38, 1.05)
    radius: float = 0.07  # of the disc, at distance 1: how soft shadows are
    ambient: float = 0.36  # how bright a white face is in the shadow
    diffuse: float = 0.78  # how much brighter it is where it looks into the lamp

    @property
    def direction(self) -> Floats:
        """The unit vector towards its middle."""
        return np.asarray(np.array(self.towards) / np.linalg.norm(self.towards))


LAMP = Lamp()


def light_on(face: Face, parts: Sequence[Floats], size: Size, homography: Floats, lamp: Lamp = LAMP) -> Array:
    """How bright a white face is, shadows included, float32 (h, w), with a homography from the face's coordinates to
    pixels of the result, all of them in front of the camera. Of the convex parts, corners (n, 3) in the world's frame,
    that may throw a shadow on it, its own may be one."""
    slope = max(0.0, float(lamp.direction @ face.normal))
    light = np.full((size[1], size[0]), lamp.ambient + lamp.diffuse * slope, np.float32)
    thrown = [shadows(corners, face, lamp) for corners in parts]
    thrown = [polygons for polygons in thrown if polygons]
    if not thrown:
        return light
    share = np.float32(lamp.diffuse * slope / LAMP_POINTS)
    for polygons in zip(*thrown, strict=True):
        dark = np.zeros_like(light)
        for polygon in polygons:
            pixels = np.column_stack((polygon, np.ones(len(polygon)))) @ homography.T
            _fill(dark, pixels[:, :2] / pixels[:, 2:])
        light -= share * dark
    return light


def shadows(corners: Floats, face: Face, lamp: Lamp = LAMP) -> list[Floats]:
    """Where a convex part (corners (n, 3), world frame) keeps the lamp's light from a face's plane: for each point of
    the lamp a convex polygon (n, 2) in the face's coordinates a and b; none where nothing of the part is between the
    plane and the light, or where the face is out of the shadow."""
    normal = face.normal
    heights = (corners - face.corner) @ normal
    rays = _rays(lamp)
    if float((rays @ normal).min()) <= 1e-3 or heights.max() <= 1e-4:
        return []
    points = [corners[heights >= 0]]
    below = corners[heights < 0]
    if len(below):
        # Of the segments between what is above and what is below, the hull keeps the part's edges.
        over, under = heights[heights >= 0][:, None], heights[heights < 0][None, :]
        share = (over / (over - under))[..., None]
        points.append((points[0][:, None] + share * (below[None, :] - points[0][:, None])).reshape(-1, 3))
    above = np.concatenate(points) - face.corner
    plane = np.stack((face.right / (face.right @ face.right), face.up / (face.up @ face.up)), axis=1)
    lifts = above @ normal
    fallen = [(above - np.outer(lifts / (light @ normal), light)) @ plane for light in rays]
    everywhere = np.concatenate(fallen)
    if (everywhere.max(axis=0) < 0).any() or (everywhere.min(axis=0) > 1).any():
        return []
    return [cv2.convexHull(polygon.astype(np.float32))[:, 0].astype(np.float64) for polygon in fallen]


def _fill(mask: Array, polygon: Floats) -> None:
    """Raise a mask to how far a convex polygon covers each pixel, 0 to 1; OpenCV's own filling reaches too far."""
    low = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(polygon.max(axis=0)).astype(int) + 2, (mask.shape[1], mask.shape[0]))
    if (low >= high).any():
        return
    u, v = (np.arange(low[axis], high[axis], dtype=np.float32) for axis in (0, 1))
    sides = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(sides, axis=1)
    kept = lengths > 1e-6
    corners, sides = polygon[kept], sides[kept] / lengths[kept, None]
    following = np.roll(sides, -1, axis=0)
    winding = np.sign((sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]).sum())
    inside = np.ones((len(v), len(u)), np.float32)
    for (x, y), (dx, dy) in zip(corners, winding * sides, strict=True):
        across = (x * dy - y * dx + 0.5) - np.float32(dy) * u
        np.minimum(inside, across.astype(np.float32)[None, :] + (np.float32(dx) * v)[:, None], out=inside)
    window = mask[low[1] : high[1], low[0] : high[0]]
    np.maximum(window, inside, out=window)


@lru_cache(maxsize=16)
def _rays(lamp: Lamp) -> Floats:
    """Directions (n, 3) to points of the lamp, evenly spread over its disc."""
    middle = lamp.direction
    across = np.cross(middle, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    down = np.cross(middle, across)
    index = np.arange(LAMP_POINTS)
    radius = lamp.radius * np.sqrt((index + 0.5) / LAMP_POINTS)
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    return np.asarray(middle + np.outer(radius * np.cos(turn), across) + np.outer(radius * np.sin(turn), down))
