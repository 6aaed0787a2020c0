"""Bodies in a picture: plane faces, and curved surfaces as meshes.

Of a plane the inverse of the depth and the face's own coordinates times that are affine in the pixel: a face is drawn
by three affine functions and a depth test."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.math.geometry import Array, Floats, Size, invert, project, transform, unit
from hierax.nodes.tracking.simworld.light import Window
from hierax.nodes.tracking.simworld.shapes import Face, Thing

_NEAREST_SAMPLED_M = 1e-3  # a face with a corner nearer to the camera is not drawn


class Drawn(NamedTuple):
    """A side of a body, or its curved surface, at the samples of a window, were it alone."""

    face: Face | None  # None: a curved surface
    window: Window  # the pixels that it may touch
    nearness: Array  # float32 (h, w), the inverse of the depth in 1/m; 0 where it is not
    # of a face (3, 3), from (column, row, 1) of a sample to its coordinates (a, b, 1), times the nearness; of a curved
    # surface float32 (h, w, 3), its normal
    at: Array


def homography(face: Face, camera: Floats, intrinsics: Array) -> Floats:
    """From a face's coordinates (a, b, 1) to pixels, times the depth, by world_from_camera and fx, fy, cx, cy."""
    from_world = invert(camera)
    rotation = from_world[:3, :3]
    columns = (rotation @ face.right, rotation @ face.up, transform(from_world, face.corner))
    return lens_matrix(intrinsics) @ np.stack(columns, axis=1)


def drawn_face(face: Face, camera: Floats, intrinsics: Array, size: Size, samples: int) -> Drawn | None:
    """A face in the world's frame, as `drawn` has it; None where it is out of the picture, or too near to it."""
    to_pixels = homography(face, camera, intrinsics)
    corners = to_pixels @ np.array([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    if corners[2].min() < _NEAREST_SAMPLED_M:
        return None
    pixels = corners[:2] / corners[2]
    left, top = (int(x) for x in np.maximum(np.floor(pixels.min(axis=1)), 0))
    right, bottom = (int(x) for x in np.minimum(np.ceil(pixels.max(axis=1)) + 1, size))
    if left >= right or top >= bottom:
        return None
    step = 1.0 / samples
    first = step / 2 - 0.5
    at = np.linalg.inv(to_pixels) @ np.array([[step, 0.0, left + first], [0.0, step, top + first], [0.0, 0.0, 1.0]])
    u, v = (np.arange(count * samples, dtype=np.float32) for count in (right - left, bottom - top))
    a, b, nearness = ((row[0] * u)[None, :] + (row[1] * v + row[2])[:, None] for row in at.astype(np.float32))
    if not face.cells:
        least = np.minimum(a, b)
        for each in (a, b):
            np.minimum(least, np.subtract(nearness, each, out=each), out=least)
        nearness *= least >= 0
        return Drawn(face, (left, top, right, bottom), nearness, at)
    inside = np.zeros(a.shape, bool)
    for cell in face.cells:
        within = nearness > 0
        for (x, y), (dx, dy) in zip(cell, np.roll(cell, -1, axis=0) - cell, strict=True):
            within &= np.float32(dx) * (b - np.float32(y) * nearness) >= np.float32(dy) * (a - np.float32(x) * nearness)
        inside |= within
    return Drawn(face, (left, top, right, bottom), nearness * inside, at)


def drawn_mesh(
    curved: tuple[Floats, Floats], camera: Floats, intrinsics: Array, size: Size, samples: int
) -> Drawn | None:
    """A closed surface of triangles, as `drawn` has it, given as by `Thing.curved`; None
    where it is out of the picture, or too near to it."""
    corners, normals = curved
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
    return Drawn(None, (int(low[0]), int(low[1]), int(high[0]), int(high[1])), shown, facing)


def drawn(body: Thing, camera: Floats, intrinsics: Array, size: Size, samples: int) -> list[Drawn]:
    """What of a body looks at the camera (world_from_camera; fx, fy, cx, cy in pixels) and may be in the picture
    (width, height), with so many samples per pixel along each axis."""
    curved, view = body.curved(), (camera, intrinsics, size, samples)
    found = [drawn_face(face, *view) for face in body.facing(camera[:3, 3])]
    if curved:
        found.append(drawn_mesh(curved, *view))
    return [each for each in found if each is not None]


def visible_shares(bodies: Sequence[Thing], camera: Floats, intrinsics: Array, size: Size) -> Floats:
    """Of each body the share of its silhouette that is seen: in the picture, and behind no other body; as for
    `drawn`. Returns: (n,) from 0 to 1; sampled once a pixel."""
    width, height = size
    # The silhouette is counted in a picture three times as large: what is cut off by the edge is hidden.
    wide = np.asarray(intrinsics) + np.array([0.0, 0.0, width, height])
    nearest = np.zeros((3 * height, 3 * width), np.float32)
    owner = np.full(nearest.shape, -1)
    alone = np.zeros(len(bodies))
    for index, body in enumerate(bodies):
        own = np.zeros_like(nearest)
        for each in drawn(body, camera, wide, (3 * width, 3 * height), 1):
            left, top, right, bottom = each.window
            part = own[top:bottom, left:right]
            np.maximum(part, each.nearness, out=part)
        alone[index] = np.count_nonzero(own)
        owner[own > nearest] = index
        np.maximum(nearest, own, out=nearest)
    middle = owner[height : 2 * height, width : 2 * width]
    seen = np.array([np.count_nonzero(middle == index) for index in range(len(bodies))])
    return np.asarray(seen / np.maximum(alone, 1.0))
