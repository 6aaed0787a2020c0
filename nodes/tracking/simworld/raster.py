"""Plane faces in a picture.

Every face is a plane, so the inverse of its depth and its own coordinates times that are
affine in the pixel: a face is drawn by three affine functions and a depth test.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, invert, lens_matrix, project, transform, unit
from hierax.nodes.tracking.simworld.shapes import Body, Face

_NEAREST_SAMPLED_M = 1e-3  # a face with a corner nearer to the camera is not drawn

Window = tuple[int, int, int, int]  # pixels of a picture: left, top, right, bottom, the ends excluded


class Covered(NamedTuple):
    """A face at the samples of a window."""

    inside: Array  # bool (h, w), whether the sample shows the face
    nearness: Array  # float32, the inverse of the depth in 1/m
    a: Array  # a, b: float32, the face's coordinates, times the nearness
    b: Array


def homography(face: Face, camera: Floats, intrinsics: Array) -> Floats:
    """From a face's coordinates (a, b, 1) to pixels, times the depth.

    Args:
        face: in the world's frame; camera: world_from_camera; intrinsics: fx, fy, cx, cy in pixels.
    """
    from_world = invert(camera)
    rotation = from_world[:3, :3]
    columns = (rotation @ face.right, rotation @ face.up, transform(from_world, face.corner))
    return lens_matrix(intrinsics) @ np.stack(columns, axis=1)


def window_of(to_pixels: Floats, width: int, height: int) -> Window | None:
    """The pixels that a face may touch; None where it is out of the picture."""
    corners = to_pixels @ np.array([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    if corners[2].min() < _NEAREST_SAMPLED_M:
        return None
    pixels = corners[:2] / corners[2]
    left, top = (int(x) for x in np.maximum(np.floor(pixels.min(axis=1)), 0))
    right, bottom = (int(x) for x in np.minimum(np.ceil(pixels.max(axis=1)) + 1, (width, height)))
    return (left, top, right, bottom) if left < right and top < bottom else None


def cover(to_pixels: Floats, cells: Sequence[Floats], window: Window, samples: int) -> Covered:
    """Where a face is seen in a window, were it alone.

    Args:
        to_pixels: its homography.
        cells: convex polygons of its coordinates, counter-clockwise; none for the unit square.
        window: which pixels; samples: per pixel, along each axis.
    """
    left, top, right, bottom = window
    step = 1.0 / samples
    first = step / 2 - 0.5
    u = (left + first + step * np.arange((right - left) * samples)).astype(np.float32)
    v = (top + first + step * np.arange((bottom - top) * samples)).astype(np.float32)
    rows = np.linalg.inv(to_pixels).astype(np.float32)
    a, b, nearness = ((row[0] * u)[None, :] + (row[1] * v + row[2])[:, None] for row in rows)
    if not cells:
        return Covered((a >= 0) & (b >= 0) & (a <= nearness) & (b <= nearness), nearness, a, b)
    inside = np.zeros(a.shape, bool)
    for cell in cells:
        within = nearness > 0
        for (x, y), (dx, dy) in zip(cell, np.roll(cell, -1, axis=0) - cell, strict=True):
            within &= np.float32(dx) * (b - np.float32(y) * nearness) >= np.float32(dy) * (a - np.float32(x) * nearness)
        inside |= within
    return Covered(inside, nearness, a, b)


def drawn_mesh(
    corners: Floats, normals: Floats, camera: Floats, intrinsics: Array, size: tuple[int, int], samples: int
) -> tuple[Window, Array, Array] | None:
    """A closed surface of triangles, were it alone.

    Args:
        corners, normals: (m, 3, 3) of triangles, world frame; camera: world_from_camera.
        intrinsics: fx, fy, cx, cy in pixels; size: width and height in pixels; samples: per pixel, along each axis.

    Returns:
        The pixels that it may touch, and at their samples the nearness (h, w) in 1/m, 0 where it is not, and the normal
        (h, w, 3); None where it is out of the picture, or too near to it.
    """
    seen = transform(invert(camera), corners)
    if seen[..., 2].min() < _NEAREST_SAMPLED_M:
        return None
    # The first sample of a pixel is half a step from the pixel's edge.
    spots = samples * (project(seen, intrinsics) + 0.5) - 0.5
    low = np.maximum(np.floor(spots.min(axis=(0, 1)) / samples).astype(int), 0)
    high = np.minimum(np.ceil(spots.max(axis=(0, 1)) / samples).astype(int) + 1, size)
    if (low >= high).any():
        return None
    width, height = (high - low) * samples
    spots -= low * samples
    sides = np.roll(spots, -1, axis=1) - spots
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    first = np.maximum(np.ceil(spots.min(axis=1)), 0).astype(int)
    counts = np.minimum(np.floor(spots.max(axis=1)).astype(int) + 1, (width, height)) - first
    # Seen from outside, with y downwards, corners go clockwise.
    ahead = np.nonzero((area < 0.0) & (counts > 0).all(axis=1))[0]
    many = counts[ahead].prod(axis=1)
    owner = np.repeat(ahead, many)
    at = np.arange(len(owner)) - np.repeat(np.cumsum(many) - many, many)
    x, y = first[owner, 0] + at % counts[owner, 0], first[owner, 1] + at // counts[owner, 0]
    to = np.stack((x, y), axis=1)[:, None] - spots[owner]
    shares = np.roll(sides[owner, :, 0] * to[..., 1] - sides[owner, :, 1] * to[..., 0], 1, axis=1) / area[owner, None]
    inside = (shares >= 0.0).all(axis=1)
    x, y, owner, shares = x[inside], y[inside], owner[inside], shares[inside] / seen[owner[inside], :, 2]
    nearness = shares.sum(axis=1)
    order = np.argsort(nearness, kind="stable")
    x, y, owner, shares = x[order], y[order], owner[order], shares[order]
    shown, facing = np.zeros((height, width), np.float32), np.zeros((height, width, 3), np.float32)
    shown[y, x] = nearness[order]
    facing[y, x] = unit(np.einsum("nk,nkd->nd", shares, normals[owner]))
    return (int(low[0]), int(low[1]), int(high[0]), int(high[1])), shown, facing


def faces_towards(body: Body, camera: Floats) -> list[Face]:
    """The sides of a body that look at the camera (world_from_camera)."""
    position = camera[:3, 3]
    return [face for face in body.faces() if face.normal @ (position - face.corner) > 0]


def visible_shares(bodies: Sequence[Body], camera: Floats, intrinsics: Array, size: tuple[int, int]) -> Floats:
    """Of each body the share of its silhouette that is seen: in the picture, and behind no other body.

    Args:
        bodies: what there is; camera: world_from_camera; intrinsics: fx, fy, cx, cy in pixels.
        size: width and height in pixels.

    Returns:
        (n,) from 0 to 1; sampled once a pixel.
    """
    width, height = size
    # The silhouette is counted in a picture three times as large: what is cut off by the edge is hidden.
    wide = np.asarray(intrinsics) + np.array([0.0, 0.0, width, height])
    nearest = np.zeros((3 * height, 3 * width), np.float32)
    owner = np.full(nearest.shape, -1)
    alone = np.zeros(len(bodies))
    for index, body in enumerate(bodies):
        own = np.zeros_like(nearest)
        if (curved := body.curved()) is not None:
            mesh = drawn_mesh(*curved, camera, wide, (3 * width, 3 * height), 1)
            if mesh is not None:
                (left, top, right, bottom), shown, _ = mesh
                own[top:bottom, left:right] = shown
        for face in faces_towards(body, camera):
            to_pixels = homography(face, camera, wide)
            window = window_of(to_pixels, 3 * width, 3 * height)
            if window is None:
                continue
            covered = cover(to_pixels, face.cells, window, 1)
            part = own[window[1] : window[3], window[0] : window[2]]
            np.maximum(part, np.where(covered.inside, covered.nearness, 0.0), out=part)
        alone[index] = np.count_nonzero(own)
        owner[own > nearest] = index
        np.maximum(nearest, own, out=nearest)
    middle = owner[height : 2 * height, width : 2 * width]
    seen = np.array([np.count_nonzero(middle == index) for index in range(len(bodies))])
    shares: Floats = seen / np.maximum(alone, 1.0)
    return shares
