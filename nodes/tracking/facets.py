"""The planar facets of an object in a segmented depth image.

What a plane looks like in inverse depth w = 1/z is affine in the pixel: w = a·u + b·v + c.
So the Laplacian of w vanishes inside a planar facet. Facets are grown from there; each
pixel then belongs to the facet whose plane predicts it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.geometry import Array, Floats, rays

cv2.setNumThreads(1)

_FLAT = 2e-5
"""Largest Laplacian inside a facet, relative to w: ten times the renderer's rounding."""

_ON_PLANE = 4e-5
"""How far a facet's pixel may be from its plane, relative to w."""

_FACET_PX = 12
_FACETS_MAX = 48


class Patch(NamedTuple):
    """The part of the images around one object; its first pixel stands at `left`, `top` in the image."""

    inverse: Floats
    labels: Array
    mine: NDArray[np.bool_]
    left: int
    top: int

    @property
    def corner(self) -> Floats:
        """Where the patch begins in the image, pixels."""
        return np.array([self.left, self.top], dtype=np.float64)


class Facets(NamedTuple):
    """Facets of one object: a number per pixel (0 where none, counted from 1) and (n, 3) planes a, b, c."""

    numbers: NDArray[np.int32]
    planes: Floats


def patch_of(depth: Array, labels: Array, label: int) -> Patch | None:
    left, top, width, height = cv2.boundingRect((labels == label).view(np.uint8))
    if width == 0:
        return None
    right, bottom = min(left + width + 1, labels.shape[1]), min(top + height + 1, labels.shape[0])
    left, top = max(left - 1, 0), max(top - 1, 0)
    view = np.s_[top:bottom, left:right]
    near = depth[view].astype(np.float64)
    inverse = np.divide(1.0, near, out=np.zeros_like(near), where=near > 0)
    return Patch(inverse, labels[view], labels[view] == label, left, top)


def facets_of(patch: Patch) -> Facets:
    """Planar parts of the object, each pixel to the plane that predicts it."""
    w, mine = patch.inverse, patch.mine
    flat = np.zeros_like(mine)
    core = w[1:-1, 1:-1]
    bend = np.maximum(np.abs(w[1:-1, 2:] + w[1:-1, :-2] - 2.0 * core), np.abs(w[2:, 1:-1] + w[:-2, 1:-1] - 2.0 * core))
    around = mine[1:-1, 1:-1] & mine[1:-1, 2:] & mine[1:-1, :-2] & mine[2:, 1:-1] & mine[:-2, 1:-1]
    flat[1:-1, 1:-1] = around & (bend < _FLAT * core)
    _, numbers, stats, _ = cv2.connectedComponentsWithStats(flat.view(np.uint8), connectivity=4)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    largest = 1 + np.argsort(-sizes, kind="stable")[:_FACETS_MAX]
    planes = [_plane(w, numbers == at) for at in largest if stats[at, cv2.CC_STAT_AREA] >= _FACET_PX]
    distinct = _distinct([plane for plane in planes if plane is not None])
    return _assign(patch, distinct)


def _plane(w: Floats, where: NDArray[np.bool_]) -> Floats | None:
    """a, b, c of w = a·u + b·v + c over the pixels; None where they are not in one plane."""
    rows, columns = np.nonzero(where)
    design = np.stack((columns, rows, np.ones_like(rows)), axis=1).astype(np.float64)
    values = w[rows, columns]
    middle = design.mean(axis=0) * (1.0, 1.0, 0.0)
    plane: Floats = np.linalg.lstsq(design - middle, values, rcond=None)[0]
    off = np.abs((design - middle) @ plane - values).max()
    plane[2] -= plane[:2] @ middle[:2]
    return plane if off < _ON_PLANE * values.mean() else None


def _distinct(planes: list[Floats]) -> Floats:
    """Without the doubles of a facet that something cuts in two."""
    kept: list[Floats] = []
    for plane in planes:
        scale = abs(plane[2]) + 1e-9
        if all(np.abs(plane - other) @ (200.0, 200.0, 1.0) > 10 * _ON_PLANE * scale for other in kept):
            kept.append(plane)
    return np.array(kept).reshape(-1, 3)


def _assign(patch: Patch, planes: Floats) -> Facets:
    numbers = np.zeros(patch.mine.shape, dtype=np.int32)
    rows, columns = np.nonzero(patch.mine)
    if not len(planes):
        numbers[rows, columns] = 1
        return Facets(numbers, planes)
    values = patch.inverse[rows, columns]
    best = np.full(len(rows), np.inf)
    owner = np.full(len(rows), len(planes) + 1, dtype=np.int32)
    for number, plane in enumerate(planes, start=1):
        off = np.abs(plane[0] * columns + plane[1] * rows + plane[2] - values)
        better = (off < best) & (off < _ON_PLANE * values)
        best[better] = off[better]
        owner[better] = number
    # What no plane predicts (a curved surface) is one more facet, which has no plane.
    numbers[rows, columns] = owner
    return Facets(numbers, planes)


def predicted(facets: Facets, numbers: NDArray[np.int32], points: Floats, otherwise: Floats) -> Floats:
    """Inverse depth of the facets at points; of facets without a plane, `otherwise`."""
    if not len(facets.planes):
        return otherwise
    curved = numbers > len(facets.planes)
    planes = facets.planes[np.where(curved, 0, numbers - 1)]
    values = planes[:, 0] * points[:, 0] + planes[:, 1] * points[:, 1] + planes[:, 2]
    return np.where(curved, otherwise, values)


def _normals(planes: Floats, intrinsics: Array, patch: Patch) -> Floats:
    """Unit normals (n, 3) of planes of the patch in the camera's frame, pointing away from the camera."""
    fx, fy, cx, cy = (float(part) for part in intrinsics)
    a, b, c = planes.T
    normals = np.stack((a * fx, b * fy, a * (cx - patch.left) + b * (cy - patch.top) + c), axis=1)
    unit: Floats = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def angle_between(planes: Floats, intrinsics: Array, patch: Patch) -> float:
    """The angle between the normals of two facets, radians."""
    first, second = _normals(planes, intrinsics, patch)
    return float(np.arccos(np.clip(first @ second, -1.0, 1.0)))


def facing(plane: Floats, points: Floats, intrinsics: Array, patch: Patch) -> float:
    """The sine of the angle at which a facet is seen around the middle of points: 1 from straight above."""
    ray = rays(points.mean(axis=0) + patch.corner, intrinsics)
    return float(_normals(plane[None], intrinsics, patch)[0] @ ray / np.linalg.norm(ray))
