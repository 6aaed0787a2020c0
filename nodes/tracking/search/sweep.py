"""Where an object may be of which nothing is known: poses all over the image, judged by maps of the image's edges.

For each direction that an edge can have there is a map of the image: by how many nats a control point of that direction
speaks for a pose that puts it there, by how far the nearest edge of that direction is and how many there are around.
It is the likelihood of `hierax.nodes.tracking.estimation.likelihood`, coarse: a pose costs as many look-ups as it has
control points. The best poses are looked at more closely, then aligned.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.estimation.likelihood import ALIKE, FOUND, LEAST_CLUTTER
from hierax.nodes.tracking.estimation.profiles import Image, Singles, grey_levels
from hierax.nodes.tracking.math.batched import only
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3
from hierax.nodes.tracking.schema import ControlPoints, Sweep

cv2.setNumThreads(1)

_DIRECTIONS = 8
_SHRUNK = 2  # maps are smaller than the image by this
_CONTRAST = 2.0  # smallest slope that counts as an edge, grey levels per pixel of a map
_COARSE_PX, _NEAR_PX = 2.2, 1.1  # standard deviations of where an edge is, pixels of a map
_AROUND_PX = 31  # clutter is counted in windows of that width
_KEPT, _BEST = 240, 32  # poses that are looked at more closely, and that are given
_APART_PX, _APART_RAD = 14.0, 0.2  # poses nearer than that, from one to the next, are one
_TRY_PX, _TRY_RAD = 5.0, 0.09  # steps of the closer look


class Maps(NamedTuple):
    """(d, h, w) nats, by direction; the last row and column are what is not in the image: 0."""

    coarse: Singles
    near: Singles


class Proposed(NamedTuple):
    """Poses of one object."""

    poses: Floats  # (n, 4, 4) camera_from_object
    templates: NDArray[np.intp]  # (n,) which of the sweep's templates each has its control points of
    nats: Floats  # (n,)


def maps_of(image: Image, outlines: Sequence[Floats] = ()) -> Maps:
    """The maps of an image.

    Args:
        image: as `hierax.nodes.tracking.estimation.profiles.smoothed` gives it.
        outlines: pixels (n, 2) on the edges of each object that is seen: what lies within says nothing of others.
    """
    height, width = image.shape[0] // _SHRUNK, image.shape[1] // _SHRUNK
    light = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).reshape(height, width, -1)
    small = grey_levels(light)
    across, down = (cv2.Sobel(small, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1)))
    across, down = across.reshape(small.shape), down.reshape(small.shape)
    size = across * across + down * down
    strongest = size.argmax(axis=2)[..., None]
    gx, gy = (np.take_along_axis(part, strongest, axis=2)[..., 0] for part in (across, down))
    edges = _thinned(gx.astype(np.float32), gy.astype(np.float32))
    turn = np.arctan2(gy, gx) % np.pi * (_DIRECTIONS / np.pi)
    coarse = np.zeros((_DIRECTIONS, height + 1, width + 1), dtype=np.float32)
    near = coarse.copy()
    for at in range(_DIRECTIONS):
        off = np.abs((turn - at + _DIRECTIONS / 2) % _DIRECTIONS - _DIRECTIONS / 2)
        chosen = edges & (off < 1.0)
        clutter = cv2.boxFilter(chosen.astype(np.float32), -1, (_AROUND_PX, _AROUND_PX))
        clutter = np.maximum(clutter, LEAST_CLUTTER)
        away = cv2.distanceTransform((~chosen).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
        for kept, spread in ((coarse, _COARSE_PX), (near, _NEAR_PX)):
            density = np.exp(-0.5 * np.minimum(away / spread, 6.0) ** 2) / (spread * np.sqrt(2.0 * np.pi))
            kept[at, :-1, :-1] = ALIKE * np.log(1.0 - FOUND + FOUND * density / clutter)
    seen = np.zeros((height + 1, width + 1), dtype=np.uint8)
    for pixels in outlines:
        cv2.fillConvexPoly(seen, cv2.convexHull(np.rint((pixels - 0.5) / _SHRUNK).astype(np.int32)), 1)
    seen = cv2.dilate(seen, np.ones((3, 3), dtype=np.uint8))
    return Maps(np.where(seen, np.float32(0.0), coarse), np.where(seen, np.float32(0.0), near))


def swept(maps: Maps, sweep: Sweep, intrinsics: Array) -> Proposed:
    """The poses of a sweep, its places seen from the camera, that the image speaks for most, the best first."""
    places, templates = sweep["places"], sweep["templates"]
    nats = np.stack([_nats(maps.coarse, places @ other["pose"], other["controls"], intrinsics) for other in templates])
    order = np.argsort(-nats, axis=None, kind="stable")[: 4 * _KEPT]
    numbers, where = np.unravel_index(order, nats.shape)
    poses = places[where] @ np.stack([templates[number]["pose"] for number in numbers])
    first = Proposed(poses, numbers, nats[numbers, where])
    kept = _apart(first, 0.5 * _APART_PX, intrinsics, _KEPT)
    return _closer(maps, sweep, only(first, np.array(kept, dtype=np.intp)), intrinsics)


def _closer(maps: Maps, sweep: Sweep, first: Proposed, intrinsics: Array) -> Proposed:
    """Each pose where it is best, a little beside and turned; the best of those."""
    upright = sweep["places"][0, :3, 2]
    level = np.array([1.0, 0.0, 0.0]) - upright[0] * upright
    level /= np.linalg.norm(level)
    ahead = np.cross(upright, level)
    ahead /= max(float(np.hypot(*ahead[:2])), 0.3)  # seen at a slant, what lies ahead is shortened
    turns = np.stack([exp_so3(turn * upright) for turn in (0.0, -_TRY_RAD, _TRY_RAD)])
    steps = np.stack([x * level + y * ahead for x in (0.0, -_TRY_PX, _TRY_PX) for y in (0.0, -_TRY_PX, _TRY_PX)])
    poses, nats = first.poses.copy(), np.full(len(first.nats), -np.inf)
    for number in np.unique(first.templates):
        rows = np.nonzero(first.templates == number)[0]
        tried = np.tile(first.poses[rows], (len(turns), len(steps), 1, 1, 1))
        tried[..., :3, :3] = turns[:, None, None] @ tried[..., :3, :3]
        metres = first.poses[rows, 2, 3] / intrinsics[0]
        tried[..., :3, 3] += metres[:, None] * steps[:, None]
        tried = tried.reshape(-1, len(rows), 4, 4)
        controls = sweep["templates"][number]["controls"]
        found = _nats(maps.near, tried.reshape(-1, 4, 4), controls, intrinsics).reshape(len(tried), len(rows))
        best = found.argmax(axis=0)
        poses[rows], nats[rows] = tried[best, np.arange(len(rows))], found.max(axis=0)
    order = np.argsort(-nats, kind="stable")
    closer = Proposed(poses[order], first.templates[order], nats[order])
    return only(closer, np.array(_apart(closer, _APART_PX, intrinsics, _BEST), dtype=np.intp))


def _nats(maps: Singles, poses: Floats, controls: ControlPoints, intrinsics: Array) -> Floats:
    """(n,) what one template's control points say of poses (n, 4, 4)."""
    points, tangents = (controls[name].astype(np.float32).T for name in ("points", "tangents"))
    if not points.size:
        return np.full(len(poses), -np.inf)
    rotations, shifts = poses[:, :3, :3].astype(np.float32), poses[:, :3, 3].astype(np.float32)
    x, y, z = (rotations[:, axis] @ points + shifts[:, axis, None] for axis in range(3))
    tx, ty, tz = (rotations[:, axis] @ tangents for axis in range(3))
    inverse = np.float32(1.0) / np.maximum(z, np.float32(0.02))
    x *= inverse
    y *= inverse
    fx, fy, cx, cy = (np.float32(part) for part in intrinsics)
    # Across the edge, not along it: the direction of the gradient.
    turn = np.arctan2(fx * (tx - x * tz), -fy * (ty - y * tz))
    direction = np.rint(turn * np.float32(_DIRECTIONS / np.pi)).astype(np.int32) % _DIRECTIONS
    _, height, width = maps.shape
    columns = np.rint((x * fx + cx - 0.5) / _SHRUNK).astype(np.int32)
    rows = np.rint((y * fy + cy - 0.5) / _SHRUNK).astype(np.int32)
    outside = (columns < 0) | (columns >= width - 1) | (rows < 0) | (rows >= height - 1)
    columns[outside], rows[outside] = width - 1, height - 1
    total: Floats = maps[direction, rows, columns].sum(axis=1).astype(np.float64)
    return total


def _thinned(gx: Singles, gy: Singles) -> NDArray[np.bool_]:
    """Where a gradient is strong, and as strong as anything before and behind it."""
    size = np.sqrt(gx * gx + gy * gy)
    padded = np.pad(size, 1)
    height, width = size.shape
    sector = np.rint(np.arctan2(gy, gx) % np.pi * (4.0 / np.pi)).astype(np.int32) % 4
    kept = size > _CONTRAST
    for number, (right, below) in enumerate(((1, 0), (1, 1), (0, 1), (-1, 1))):
        after = padded[1 + below : 1 + below + height, 1 + right : 1 + right + width]
        before = padded[1 - below : 1 - below + height, 1 - right : 1 - right + width]
        kept &= (sector != number) | ((size >= before) & (size > after))
    return np.asarray(kept)


def _apart(found: Proposed, apart_px: float, intrinsics: Array, most: int) -> list[int]:
    """Numbers of poses, best first, that are apart from all better ones."""
    flat = found.poses[:, :3, 3] * (intrinsics[0] / found.poses[:, 2, 3])[:, None]
    kept: list[int] = []
    for number in range(len(flat)):
        near = np.linalg.norm(flat[kept] - flat[number], axis=1) < apart_px
        if near.any():
            turned = np.einsum("nij,ij->n", found.poses[kept, :3, :3], found.poses[number, :3, :3])
            if (near & (turned > 1.0 + 2.0 * np.cos(_APART_RAD))).any():
                continue
        kept.append(number)
        if len(kept) == most:
            break
    return kept
