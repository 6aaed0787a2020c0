"""Light and soft shadows of the simulated scene.

A lamp shaped like a disc stands far away. Its light is the mean of that of points on the disc; from each of them a
convex part of a body throws a convex polygon of shadow on a plane. So shadows are sharp where things touch and get
softer with distance, as they should: a shadow that is merely blurred darkens the table on the lit side of a body too,
and every edge there would seem to be half a millimetre farther out than it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, copysign, floor, hypot

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, Size
from hierax.nodes.tracking.simworld.shapes import Face

Window = tuple[int, int, int, int]  # pixels of a picture: left, top, right, bottom, the ends excluded
LEAST_M = 1e-4  # what rises less over a face throws no shadow on it
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


def shaded(
    face: Face, parts: Sequence[Floats], size: Size, homography: Floats, lamp: Lamp = LAMP
) -> tuple[float, Window, Array]:
    """How bright a white face is out of all shadows; a window of pixels outside of which it is so; and how bright it is
    inside, float32 (h, w). The homography leads from the face's coordinates to pixels, all of them in front of the
    camera. Of the convex parts, corners (n, 3) in the world's frame, that may throw a shadow on it, its own may be one.
    """
    normal = face.normal
    slope = max(0.0, float(lamp.direction @ normal))
    bright = lamp.ambient + lamp.diffuse * slope
    over = [corners for corners in parts if ((corners - face.corner) @ normal).max() > LEAST_M] if slope else []
    thrown = [[_in_pixels(polygon, homography) for polygon in shadows(corners, face, lamp)] for corners in over]
    thrown = [polygons for polygons in thrown if polygons]
    every = [polygon for polygons in thrown for polygon in polygons]
    left, top, right, bottom = 0, 0, 0, 0
    if every:
        corners = np.concatenate(every)
        left, top = (int(x) for x in np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0))
        right, bottom = (int(x) for x in np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, size))
    light = np.full((max(bottom - top, 0), max(right - left, 0)), bright, np.float32)
    dark, share = np.empty_like(light), np.float32(lamp.diffuse * slope / LAMP_POINTS)
    for polygons in zip(*thrown, strict=True) if light.size else ():
        dark.fill(0.0)
        for polygon in polygons:
            _fill(dark, (polygon - (left, top)).tolist())
        dark *= share
        light -= dark
    return bright, (left, top, left + light.shape[1], top + light.shape[0]), light


def _in_pixels(polygon: Floats, homography: Floats) -> Floats:
    pixels = polygon @ homography[:, :2].T + homography[:, 2]
    return np.asarray(pixels[:, :2] / pixels[:, 2:])


def shadows(corners: Floats, face: Face, lamp: Lamp = LAMP) -> list[Floats]:
    """Where a convex part (corners (n, 3), world frame) keeps the lamp's light from a face's plane: for each point of
    the lamp a convex polygon (n, 2) in the face's coordinates a and b; none where nothing of the part is between the
    plane and the light, or where the face is out of the shadow."""
    normal = face.normal
    heights = (corners - face.corner) @ normal
    rays = _rays(lamp)
    slopes = rays @ normal
    if float(slopes.min()) <= 1e-3 or heights.max() <= LEAST_M:
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
    fallen = (above @ plane)[None] - ((above @ normal) / slopes[:, None])[..., None] * (rays @ plane)[:, None]
    if (fallen.max(axis=(0, 1)) < 0).any() or (fallen.min(axis=(0, 1)) > 1).any():
        return []
    return [cv2.convexHull(polygon)[:, 0].astype(np.float64) for polygon in fallen.astype(np.float32)]


def _fill(mask: Array, polygon: Sequence[tuple[float, float]]) -> None:
    """Raise a mask to how far a convex polygon covers each pixel, 0 to 1; OpenCV's own filling reaches too far."""
    xs, ys = zip(*polygon, strict=True)
    left, right = max(floor(min(xs)) - 1, 0), min(ceil(max(xs)) + 2, mask.shape[1])
    top, bottom = max(floor(min(ys)) - 1, 0), min(ceil(max(ys)) + 2, mask.shape[0])
    if left >= right or top >= bottom:
        return
    sides = [(x, y, p - x, q - y) for (x, y), (p, q) in zip(polygon, (*polygon[1:], polygon[0]), strict=True)]
    winding = copysign(1.0, sum(x * dy - y * dx for x, y, dx, dy in sides))
    within = []  # by side, how far inside of it a pixel is: a constant, less a share of the column, plus one of the row
    for x, y, dx, dy in sides:
        length = winding * hypot(dx, dy)
        if abs(length) > 1e-6:
            dx, dy = dx / length, dy / length
            within.append((x * dy - y * dx + 0.5, dy, dx))
    if not within:
        return
    constant, by_column, by_row = np.array(within, np.float32).T[:, :, None]
    along = constant - by_column * np.arange(left, right, dtype=np.float32)
    down = by_row * np.arange(top, bottom, dtype=np.float32)
    inside = along[0] + down[0][:, None]
    other = np.empty_like(inside)
    for columns, rows in zip(along[1:], down[1:], strict=True):
        np.minimum(inside, np.add(columns, rows[:, None], out=other), out=inside)
    np.minimum(inside, np.float32(1.0), out=inside)
    window = mask[top:bottom, left:right]
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
