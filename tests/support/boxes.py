"""Exact images of boxes by ray casting: what rendering, edges and matching are checked against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

INTRINSICS = np.array([525.0, 530.0, 313.06, 223.59])
SIZE = (640, 480)


class Box(NamedTuple):
    """A box of side lengths `size` (metres) around the origin of its frame, at camera_from_object `pose`."""

    label: int
    size: tuple[float, float, float]
    pose: np.ndarray[Any, Any]


class Cast(NamedTuple):
    """Of each pixel: depth (0 where nothing is), label, and which of six faces (0 to 5) is seen."""

    depth: np.ndarray[Any, Any]
    labels: np.ndarray[Any, Any]
    faces: np.ndarray[Any, Any]


def cast(boxes: Sequence[Box], intrinsics: np.ndarray[Any, Any] = INTRINSICS, size: tuple[int, int] = SIZE) -> Cast:
    """Cast a ray through every pixel centre."""
    width, height = size
    fx, fy, cx, cy = intrinsics
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones((height, width))], axis=-1)
    depth = np.full((height, width), np.inf)
    labels = np.zeros((height, width), dtype=np.uint8)
    faces = np.zeros((height, width), dtype=np.uint8)
    for box in boxes:
        part = _around(box, intrinsics, size)
        rotation, origin = box.pose[:3, :3], -box.pose[:3, :3].T @ box.pose[:3, 3]
        inside = rays[part] @ rotation
        half = np.asarray(box.size) / 2.0
        one, two = (-half - origin) / inside, (half - origin) / inside
        enter = np.minimum(one, two)
        first, last = enter.max(axis=-1), np.maximum(one, two).min(axis=-1)
        seen = (first < last) & (first > 0) & (first < depth[part])
        axis = enter.argmax(axis=-1)
        sign = np.take_along_axis(inside, axis[..., None], axis=-1)[..., 0] > 0
        depth[part][seen] = first[seen]
        labels[part][seen] = box.label
        faces[part][seen] = (2 * axis + sign)[seen]
    return Cast(np.where(np.isfinite(depth), depth, 0.0), labels, faces)


def _around(box: Box, intrinsics: np.ndarray[Any, Any], size: tuple[int, int]) -> tuple[slice, slice]:
    """The rows and columns that a box is seen in at most; all of them where some of it is beside the camera."""
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    corners = signs * box.size @ box.pose[:3, :3].T + box.pose[:3, 3]
    if corners[:, 2].min() <= 0.0:
        return slice(None), slice(None)
    pixels = corners[:, :2] / corners[:, 2:] * intrinsics[:2] + intrinsics[2:]
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int), 0, size)
    high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 1, 0, size)
    return slice(low[1], high[1]), slice(low[0], high[0])


def photograph(
    boxes: Sequence[Box], noise: float, rng: np.random.Generator, behind: np.ndarray[Any, Any] | None = None
) -> np.ndarray[Any, Any]:
    """A gray image of boxes whose faces have different shades, area-sampled 3 × 3, with noise; behind: (h, w) grey
    levels of what is behind them."""
    factor = 3
    fx, fy, cx, cy = INTRINSICS
    fine = np.array([fx * factor, fy * factor, factor * (cx + 0.5) - 0.5, factor * (cy + 0.5) - 0.5])
    width, height = SIZE
    seen = cast(boxes, fine, (width * factor, height * factor))
    shades = np.array([60.0, 90.0, 130.0, 160.0, 200.0, 230.0])
    ground = 110.0 if behind is None else behind.repeat(factor, axis=0).repeat(factor, axis=1)
    shade = np.where(seen.labels > 0, shades[(seen.faces + seen.labels) % 6], ground)
    image = shade.reshape(height, factor, width, factor).mean(axis=(1, 3))
    return np.clip(image + noise * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)
