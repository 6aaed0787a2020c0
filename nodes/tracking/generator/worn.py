"""Convex bodies that are not as they were drawn: sides that lie elsewhere, bevelled edges, another size."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, unit
from hierax.nodes.tracking.model.mesh import Mesh, triangulated
from hierax.nodes.tracking.simworld.shapes import Face, Shape

SIDES_M = 0.002  # how far a side lies beside where it was drawn, at most
BEVEL_M = 0.003  # how much of its two sides a bevel takes away, at most
SCALE = 0.01  # by how much the whole is larger or smaller, at most
_ON_M = 1e-7


def worn(shape: Shape, rng: np.random.Generator) -> Shape:
    """What was made after a convex shape's drawing: in the same frame, but none of its edges where it was drawn."""
    normals = np.stack([side.normal for side in shape.sides])
    offsets = np.array([side.normal @ side.corner for side in shape.sides])
    moved = (1.0 + rng.uniform(-SCALE, SCALE)) * offsets + rng.uniform(-SIDES_M, SIDES_M, len(offsets))
    corners, on = _corners(normals, moved)
    bevel = rng.uniform(0.0, BEVEL_M)
    planes, heights = [*normals], [*moved]
    for one, two in combinations(range(len(normals)), 2):
        shared = on[:, one] & on[:, two]
        if shared.sum() < 2:
            continue
        across = normals[one] + normals[two]
        cut = bevel * rng.uniform(0.6, 1.0) * np.sqrt(1.0 - (normals[one] @ normals[two]) ** 2)
        planes.append(across / np.linalg.norm(across))
        heights.append(float(planes[-1] @ corners[shared][0]) - cut / np.linalg.norm(across))
    return convex_shape(np.stack(planes), np.array(heights))


def convex_shape(normals: Floats, offsets: Floats) -> Shape:
    """The body of all points x with ``normals @ x <= offsets``; a plane that nothing of it lies in falls away;
    normals: (n, 3) unit vectors; offsets: (n,) metres."""
    corners, on = _corners(normals, offsets)
    sides, polygons = [], []
    for normal, mine in zip(normals, on.T, strict=True):
        rows = np.nonzero(mine)[0]
        if len(rows) < 3:
            continue
        right = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])[None])[0]
        flat = (corners[rows] - corners[rows].mean(axis=0)) @ np.stack((right, np.cross(normal, right)), axis=1)
        order = np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))
        low, size = flat.min(axis=0), np.ptp(flat, axis=0)
        across = np.stack((right, np.cross(normal, right)))
        start = corners[rows].mean(axis=0) + low @ across
        sides.append(Face(start, size[0] * across[0], size[1] * across[1], ((flat[order] - low) / size,)))
        polygons.append(rows[order].tolist())
    return Shape(tuple(sides), (corners,), Mesh(corners, triangulated(polygons)))


def _corners(normals: Floats, offsets: Floats) -> tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """(n, 3) where three planes meet and no other cuts them off, and (n, planes) which of the planes each lies on."""
    triples = np.array(list(combinations(range(len(normals)), 3)))
    matrices = normals[triples]
    meeting = np.abs(np.linalg.det(matrices)) > 1e-6
    points = np.linalg.solve(matrices[meeting], offsets[triples[meeting], None])[..., 0]
    points = points[(points @ normals.T <= offsets + _ON_M).all(axis=1)]
    _, first = np.unique(np.round(points / (10.0 * _ON_M)), axis=0, return_index=True)
    corners: Floats = points[np.sort(first)]
    return corners, np.abs(corners @ normals.T - offsets) < 10.0 * _ON_M
