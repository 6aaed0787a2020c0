"""Light and soft shadows of the simulated scene.

A lamp shaped like a disc stands far away. Its light is the mean of that of points on the disc; from each of them a
convex part of a body throws a convex polygon of shadow on a plane. So shadows are sharp where things touch and get
softer with distance, as they should: a shadow that is merely blurred darkens the table on the lit side of a body too,
and every edge there would seem to be half a millimetre farther out than it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import copysign, hypot

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, Size
from hierax.nodes.tracking.simworld.shapes import Face

Window = tuple[int, int, int, int]  # pixels of a picture: left, top, right, bottom, the ends excluded
LEAST_M = 1e-4  # what rises less over a face throws no shadow on it
LAMP_POINTS = 9  # shadows are the mean of those that so many points of a lamp throw

_GRAZING = 1e-3  # light that comes more nearly along a face throws no shadows on it
_FULL = 255  # a pixel that a shadow covers
_SHIFT = 8  # bits of a pixel's fraction, in polygons for OpenCV
_REACH_PX = 0.66  # so much farther out than a polygon's sides OpenCV's smooth filling has its middle; 0.60 to 0.69
_LEAST_PX = 1e-3  # shorter sides have no direction
_ACUTE = 0.3  # one and the cosine of how far a corner turns: what turns more is cut short
_FARTHEST_PX = float(1 << 20)


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
    slope = max(0.0, float(lamp.direction @ face.normal))
    bright = lamp.ambient + lamp.diffuse * slope
    thrown = [shadows(corners, face, lamp) for corners in parts] if slope else []
    thrown = [_in_pixels(polygons, homography) for polygons in thrown if polygons]
    every = [polygon for polygons in thrown for polygon in polygons]
    left, top, right, bottom = 0, 0, 0, 0
    if every:
        corners = np.concatenate(every)
        left, top = (int(x) for x in np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0))
        right, bottom = (int(x) for x in np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, size))
    shape = (max(bottom - top, 0), max(right - left, 0))
    light, dark = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    for polygons in zip(*thrown, strict=True) if light.size else ():
        dark.fill(0)
        for polygon in polygons:
            _fill(dark, polygon - (left, top))
        cv2.accumulate(dark, light)
    light *= np.float32(-lamp.diffuse * slope / (LAMP_POINTS * _FULL))
    light += np.float32(bright)
    return bright, (left, top, left + shape[1], top + shape[0]), light


def _in_pixels(polygons: Sequence[Floats], homography: Floats) -> list[Floats]:
    pixels = np.concatenate(polygons) @ homography[:, :2].T + homography[:, 2]
    ends = np.cumsum([len(polygon) for polygon in polygons])[:-1]
    return np.split(pixels[:, :2] / pixels[:, 2:], ends)


def shadows(corners: Floats, face: Face, lamp: Lamp = LAMP) -> list[Floats]:
    """Where a convex part (corners (n, 3), world frame) keeps the lamp's light from a face's plane: for each point of
    the lamp a convex polygon (n, 2) in the face's coordinates a and b; none where nothing of the part is between the
    plane and the light, or where the face is out of the shadow."""
    away = corners - face.corner
    heights = away @ face.normal
    if heights.max() <= LEAST_M:
        return []
    rays = _rays(lamp)
    slopes = rays @ face.normal
    if slopes.min() <= _GRAZING:
        return []
    plane = np.stack((face.right / (face.right @ face.right), face.up / (face.up @ face.up)), axis=1)
    drift = (rays @ plane) / slopes[:, None]  # by how much a shadow moves for each metre that something is higher
    places = away @ plane
    fallen = places - np.maximum(heights, 0.0)[:, None] * drift[:, None]
    # What the plane cuts lies between places that have not drifted.
    highest = np.maximum(fallen.max(axis=(0, 1)), places.max(axis=0))
    lowest = np.minimum(fallen.min(axis=(0, 1)), places.min(axis=0))
    if (highest < 0).any() or (lowest > 1).any():
        return []
    if heights.min() < 0.0:
        fallen = np.concatenate((fallen[:, heights >= 0], _cut(places, heights)), axis=1)
    return [cv2.convexHull(polygon)[:, 0].astype(np.float64) for polygon in np.ascontiguousarray(fallen, np.float32)]


def _cut(places: Floats, heights: Floats) -> Floats:
    """Where a plane cuts the lines between corners above and below it, of which the hull keeps a part's edges, by their
    places (n, 2) in the plane: the same for each point of the lamp, (points, m, 2)."""
    is_over = heights >= 0
    over, under = heights[is_over][:, None], heights[~is_over][None, :]
    share = (over / (over - under))[..., None]
    above, below = places[is_over][:, None], places[~is_over][None, :]
    cut = (above + share * (below - above)).reshape(-1, 2)
    return np.broadcast_to(cut, (LAMP_POINTS, *cut.shape))


def _fill(mask: Array, polygon: Floats) -> None:
    """Raise a mask, uint8, to how far a convex polygon (n, 2) covers each pixel, 0 to `_FULL`."""
    inner = _shrunk(polygon.tolist(), _REACH_PX)
    if inner:
        fixed = np.array([(_fixed(x), _fixed(y)) for x, y in inner], np.int32)
        cv2.fillConvexPoly(mask, fixed, _FULL, cv2.LINE_AA, _SHIFT)


def _fixed(place_px: float) -> int:
    return round(min(max(place_px, -_FARTHEST_PX), _FARTHEST_PX) * (1 << _SHIFT))


def _shrunk(polygon: Sequence[Sequence[float]], by_px: float) -> list[tuple[float, float]]:
    """A convex polygon whose sides are so much farther in, but for very acute corners; without corners, where nothing
    is left of it. It has so few that numpy would take five times as long."""
    sides = [(x, y, p - x, q - y) for (x, y), (p, q) in zip(polygon, (*polygon[1:], polygon[0]), strict=True)]
    units = [(x, y, dx / s, dy / s) for x, y, dx, dy in sides if (s := hypot(dx, dy)) > _LEAST_PX]
    by_px = copysign(by_px, sum(x * dy - y * dx for x, y, dx, dy in sides))
    inner: list[tuple[float, float]] = []
    for (_, _, ex, ey), (x, y, dx, dy) in zip((*units[-1:], *units[:-1]), units, strict=True):
        by = by_px / max(1.0 + ex * dx + ey * dy, _ACUTE)
        inner.append((x - by * (ey + dy), y + by * (ex + dx)))
    after = (*inner[1:], *inner[:1])
    area = sum(x * q - y * p for (x, y), (p, q) in zip(inner, after, strict=True))
    return inner if area * by_px > 0.0 else []


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
