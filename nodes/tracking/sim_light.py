"""Light and soft shadows of the simulated scene.

A lamp shaped like a disc stands far away. Its light is the mean of that of points on the
disc; from each of them a cube, being convex, throws a convex polygon of shadow on a plane.
So shadows are sharp where things touch and get softer with distance, as they should: a
shadow that is merely blurred darkens the table on the lit side of a cube too, and every
edge there would seem to be half a millimetre farther out than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.geometry import Array, Floats, transform

cv2.setNumThreads(1)

LIGHT = np.array([-0.42, -0.38, 1.05]) / np.linalg.norm([-0.42, -0.38, 1.05])
"""From the scene towards the middle of the lamp, world frame."""

LAMP_RADIUS = 0.07
LAMP_POINTS = 9
"""The lamp is a disc, of this radius at distance 1, and shadows are the mean of those that points of it throw."""

AMBIENT = 0.36
DIFFUSE = 0.78

_EDGES = [(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)]


class Cube(NamedTuple):
    """A cube to draw.

    Attributes:
        pose: world_from_object, 4x4, origin at the cube's centre.
        side_m: length of its edges.
        colour: RGB, 0 to 255.
    """

    pose: Floats
    side_m: float
    colour: tuple[int, int, int]


class Face(NamedTuple):
    """A side of a cube, seen from outside: corner + a * right + b * up, a and b from 0 to 1 (world frame, metres)."""

    corner: Floats
    right: Floats
    up: Floats

    @property
    def normal(self) -> Floats:
        """Unit vector that points outwards."""
        normal = np.cross(self.right, self.up)
        unit: Floats = normal / np.linalg.norm(normal)
        return unit


def cube_corners(side_m: float) -> Floats:
    """The corners of a cube in its own frame, (8, 3)."""
    return np.array(list(product((-1.0, 1.0), repeat=3))) * side_m / 2


def light_on(face: Face, cubes: Sequence[Cube], size: tuple[int, int], homography: Floats) -> Array:
    """How bright a white face is, shadows included.

    Args:
        face: the face.
        cubes: what may throw a shadow on it.
        size: width and height of the result.
        homography: from the face's coordinates to pixels of the result, all of them in front of the camera.

    Returns:
        float32 (h, w).
    """
    slope = max(0.0, float(LIGHT @ face.normal))
    light = np.full((size[1], size[0]), AMBIENT + DIFFUSE * slope, np.float32)
    thrown = [shadows(transform(cube.pose, cube_corners(cube.side_m)), face) for cube in cubes]
    thrown = [polygons for polygons in thrown if polygons]
    if not thrown:
        return light
    share = np.float32(DIFFUSE * slope / LAMP_POINTS)
    for polygons in zip(*thrown, strict=True):
        dark = np.zeros_like(light)
        for polygon in polygons:
            pixels = np.column_stack((polygon, np.ones(len(polygon)))) @ homography.T
            _fill(dark, pixels[:, :2] / pixels[:, 2:])
        light -= share * dark
    return light


def shadows(corners: Floats, face: Face) -> list[Floats]:
    """Where a cube keeps the lamp's light from a face's plane.

    Args:
        corners: of the cube, (8, 3), world frame, in the order of `cube_corners`.
        face: whose plane it falls on.

    Returns:
        For each point of the lamp a convex polygon (n, 2) in the face's coordinates a and
        b; none where nothing of the cube is between the plane and the light, or where the
        face is out of the shadow.
    """
    normal = face.normal
    heights = (corners - face.corner) @ normal
    if float((_lamp() @ normal).min()) <= 1e-3 or heights.max() <= 1e-4:
        return []
    points = [corners[heights >= 0]]
    for first, second in _EDGES:
        if (heights[first] < 0) != (heights[second] < 0):
            part = heights[first] / (heights[first] - heights[second])
            points.append((corners[first] + part * (corners[second] - corners[first]))[None])
    above = np.concatenate(points) - face.corner
    plane = np.stack((face.right / (face.right @ face.right), face.up / (face.up @ face.up)), axis=1)
    lifts = above @ normal
    fallen = [(above - np.outer(lifts / (light @ normal), light)) @ plane for light in _lamp()]
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


@lru_cache(maxsize=1)
def _lamp() -> Floats:
    """Directions (n, 3) to points of the lamp, evenly spread over its disc."""
    across = np.cross(LIGHT, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    down = np.cross(LIGHT, across)
    index = np.arange(LAMP_POINTS)
    radius = LAMP_RADIUS * np.sqrt((index + 0.5) / LAMP_POINTS)
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    lamp: Floats = LIGHT + np.outer(radius * np.cos(turn), across) + np.outer(radius * np.sin(turn), down)
    return lamp
