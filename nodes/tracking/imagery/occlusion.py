"""The chance that points on one object are hidden by another, both at uncertain poses.

A point is hidden where it lies inside the other's outline in the image, and behind it. Both are uncertain: the outline
by what both poses' errors move it and the point against each other, across the outline; the order in depth likewise,
along the ray. Solid bodies do not run into each other: whatever is nearer than the middle of the other body, along the
ray, lies before it, and touches it at most."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.imagery.layers import Layer
from hierax.nodes.tracking.math.batched import hat_many, only, pixels_along
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, project, rays, transform


class Placed(NamedTuple):
    """An object as it is expected."""

    pose: Floats  # camera_from_object
    covariance: Floats  # (6, 6) of the pose's error, twist in the object's frame
    layer: Layer | None  # the object drawn alone; None where it is not in the image


class _Points(NamedTuple):
    """Points of all objects: in the camera's frame (n, 3), pixels (n, 2), covariance (n, 3, 3) of where they are in
    the camera's frame, m², and which object (n,) each is on."""

    seen: Floats
    pixels: Floats
    errors: Floats
    owners: NDArray[np.intp]


def chances_seen(points: Sequence[Floats], placed: Sequence[Placed], intrinsics: Array) -> list[NDArray[np.float32]]:
    """The chance of each point on each object, (n, 3) metres in its frame, before the camera, that no other object
    hides it; placed: the objects, in the same order; intrinsics: (4,) fx, fy, cx, cy in pixels."""
    counts = [len(own) for own in points]
    if len(placed) < 2 or not sum(counts):
        return [np.ones(count, dtype=np.float32) for count in counts]
    seen = np.concatenate([transform(item.pose, own) for own, item in zip(points, placed, strict=True)])
    errors = [_errors(own, item) for own, item in zip(points, placed, strict=True)]
    owners = np.repeat(np.arange(len(counts)), counts)
    every = _Points(seen, project(seen, intrinsics), np.concatenate(errors), owners)
    chances = np.ones(len(seen))
    for number, item in enumerate(placed):
        if item.layer is None or not item.layer.inverse.any():
            continue
        near = np.nonzero((owners != number) & _may_be_hidden(every, item, item.layer))[0]
        if len(near):
            chances[near] *= 1.0 - _hidden(only(every, near), item, item.layer, intrinsics)
    return np.split(chances.astype(np.float32), np.cumsum(counts)[:-1])


def _errors(points: Floats, item: Placed) -> Floats:
    """The covariance (n, 3, 3) of where points (n, 3) of an object are, in the camera's frame."""
    shifts = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    # A turn by r moves a point p by r × p.
    moves = item.pose[:3, :3] @ np.concatenate((shifts, hat_many(points).transpose(0, 2, 1)), axis=2)
    return np.asarray(moves @ item.covariance @ moves.transpose(0, 2, 1))


def _may_be_hidden(points: _Points, item: Placed, layer: Layer) -> NDArray[np.bool_]:
    """Which of the points are near enough to the object in the image, and not before all of it."""
    window = layer.window
    low = np.array([window.left, window.top]) - (const.REACH_OUTSIDE_PX - 3.0)
    high = np.array([window.right, window.bottom]) + (const.REACH_OUTSIDE_PX - 4.0)
    near = ((points.pixels > low) & (points.pixels < high)).all(axis=1)
    nearest = 1.0 / float(layer.inverse.max())
    centre = float(np.trace(item.covariance[:3, :3]))
    spread = np.sqrt(points.errors[:, 2, 2] + centre + const.OUTLINE_M**2)
    behind: NDArray[np.bool_] = points.seen[:, 2] + const.HIDDEN_SIGMAS * spread > nearest
    return near & behind


def _hidden(points: _Points, item: Placed, layer: Layer, intrinsics: Array) -> Floats:
    """The chance (n,) that the object hides each of the points."""
    corner = layer.window.corner
    inside, normals = _to_outline(layer, points.pixels - corner + const.REACH_OUTSIDE_PX)
    outline = points.pixels - inside[:, None] * normals
    deep = np.where(inside[:, None] > const.INSIDE_PX, points.pixels, outline + const.INSIDE_PX * normals)
    front, back = _depths(layer, deep, float(item.pose[2, 3]))
    # What the outline's uncertainty is that of: the point on it, at about the depth beside it.
    touched = rays(outline, intrinsics) * front[:, None]
    errors = points.errors + _errors(transform(invert(item.pose), touched), item)
    towards = pixels_along(normals, points.seen, intrinsics)
    across = np.einsum("ni,nij,nj->n", towards, errors, towards) + const.OUTLINE_PX**2
    along = errors[:, 2, 2] + const.OUTLINE_M**2
    behind = (points.seen[:, 2] - 0.5 * (front + back)) / np.sqrt(along)
    return _normal_cdf(inside / np.sqrt(across)) * _normal_cdf(behind)


def _to_outline(layer: Layer, at: Floats) -> tuple[Floats, Floats]:
    """Of places (n, 2) in the layer's window with `_REACH_PX` around it: pixels (n,) to the object's outline, positive
    inside, and unit normals (n, 2) that point inwards."""
    mask = (layer.inverse > 0.0).view(np.uint8)
    # Around the object its window is empty, but where the image ends: there the object goes on.
    reach = const.REACH_OUTSIDE_PX
    padded = cv2.copyMakeBorder(mask, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    whole = np.rint(at).astype(np.intp)
    (left, top), (right, bottom) = whole.min(axis=0) - 2, whole.max(axis=0) + 3
    # The nearest outline may lie outside of what the points span, but then by no more than the reach.
    left, top = max(int(left) - reach, 0), max(int(top) - reach, 0)
    padded = np.ascontiguousarray(padded[top : int(bottom) + reach, left : int(right) + reach])
    inner = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_3)
    outer = cv2.distanceTransform(1 - padded, cv2.DIST_L2, cv2.DIST_MASK_3)
    distance = np.where(padded > 0, inner - 0.5, 0.5 - outer).astype(np.float64)
    np.clip(distance, -2.0 * reach, 2.0 * reach, out=distance)
    column, row = whole[:, 0] - left, whole[:, 1] - top
    slope = np.stack(
        (distance[row, column + 2] - distance[row, column - 2], distance[row + 2, column] - distance[row - 2, column]),
        axis=1,
    )
    normals = slope / np.maximum(np.sqrt(np.sum(slope * slope, axis=1, keepdims=True)), 1e-6)
    return distance[row, column] + np.sum((at - whole) * normals, axis=1), normals


def _depths(layer: Layer, pixels: Floats, otherwise: float) -> tuple[Floats, Floats]:
    """Depths at which the rays through pixels (n, 2) enter the object and leave its bounding box."""
    height, width = layer.inverse.shape
    column, row = np.rint(pixels - layer.window.corner).astype(np.intp).T
    column, row = column.clip(0, width - 1), row.clip(0, height - 1)
    first, last = layer.inverse[row, column], layer.leaving(pixels)
    there = (first > 0.0) & (last > 0.0)
    entered = np.divide(1.0, first, out=np.full(len(first), otherwise), where=there)
    left = np.divide(1.0, last, out=np.full(len(last), otherwise), where=there)
    return entered, np.maximum(entered, left)


def _normal_cdf(deviations: Floats) -> Floats:
    """The normal distribution's, by the logistic function to within 0.01."""
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * deviations.clip(-30.0, 30.0))))
