"""Bodies that are not as they were drawn: edges that are worn round, and convex ones of which sides lie elsewhere,
edges are bevelled, or the size is another."""

from itertools import combinations, pairwise

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, unit
from hierax.nodes.tracking.model.controls import Indices
from hierax.nodes.tracking.model.mesh import Mesh, triangulated
from hierax.nodes.tracking.simworld.shapes import Face, Shape

SIDES_M = 0.002  # how far a side lies beside where it was drawn, at most
BEVEL_M = 0.003  # how much of its two sides a bevel takes away, at most
SCALE = 0.01  # by how much the whole is larger or smaller, at most
RADIUS_M = 0.001  # of the edges of a body that is as its model, at most
_LEAST_RADIUS_M = 0.00002  # smaller ones cannot be told from sharp ones
_STRIPS = 3  # plane strips that a round edge is drawn as
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
        side, order = _side(corners[rows], normal)
        sides.append(side)
        polygons.append(rows[order].tolist())
    return Shape(tuple(sides), (corners,), Mesh(corners, triangulated(polygons)))


def rounded(shape: Shape, radius_m: float) -> Shape:
    """What is seen of a prism (of `extruded`) whose outer edges are worn round; its mesh stays the prism's. An edge is
    a cylinder of so many plane strips that touch it, a corner a part of a ball."""
    if radius_m < _LEAST_RADIUS_M:
        return shape
    vertices = shape.mesh.vertices
    outline, low, high = vertices[: len(vertices) // 2, :2], vertices[0, 2], vertices[-1, 2]
    owners, ways, reach = _ways_around(outline)
    core = outline - radius_m * reach
    bends = np.linspace(0.0, np.pi / 2.0, _STRIPS + 1)
    levels = [(low + radius_m * (1.0 - np.cos(bend)), radius_m * np.sin(bend)) for bend in bends]
    levels += [(low + high - level, wide) for level, wide in reversed(levels)]
    rings = np.stack([_at_level(core[owners] + wide * ways, level) for level, wide in levels])
    steps = list(pairwise([*range(len(owners)), 0]))
    quads = [(lower[at], lower[to], upper[to], upper[at]) for lower, upper in pairwise(rings) for at, to in steps]
    strips = filter(None, (_strip(np.stack(quad)) for quad in quads))
    parts = [part[: len(part) // 2, :2] for part in shape.convex]
    pieces = [np.abs(outline[None] - part[:, None]).sum(axis=2).argmin(axis=1) for part in parts]
    ends = [(piece, level, up) for piece in pieces for level, up in ((low, -1.0), (high, 1.0))]
    caps = [_side(_at_level(core[piece], level), np.array([0.0, 0.0, up]))[0] for piece, level, up in ends]
    convex = tuple(rings[:, np.isin(owners, piece)].reshape(-1, 3) for piece in pieces)
    return shape._replace(sides=(*caps, *strips), convex=convex)


def _at_level(places: Floats, level: float) -> Floats:
    return np.column_stack((places, np.full(len(places), level)))


def _ways_around(outline: Floats) -> tuple[Indices, Floats, Floats]:
    """The way round an outline (n, 2) that rolls about outer corners: of each step the corner and the normal, and of
    each corner (n, 2) how far it lies from where lines meet that are one inwards of its sides."""
    ahead = unit(np.roll(outline, -1, axis=0) - outline)
    after = np.column_stack((ahead[:, 1], -ahead[:, 0]))
    before = np.roll(after, 1, axis=0)
    turns = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1))
    reach = (before + after) / (1.0 + np.cos(turns))[:, None]
    owners: list[int] = []
    ways: list[Floats] = []
    for at, turn in enumerate(turns):
        begin = np.arctan2(before[at, 1], before[at, 0])
        bends = begin + np.linspace(0.0, turn, _STRIPS + 1)
        own = np.column_stack((np.cos(bends), np.sin(bends))) if turn > 0.0 else reach[at : at + 1]
        owners += [at] * len(own)
        ways.append(own)
    return np.array(owners), np.concatenate(ways), reach


def _strip(corners: Floats) -> Face | None:
    """A plane quadrilateral, counter-clockwise from outside; None where nothing is left of it."""
    corners = corners[np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) > _ON_M]
    if len(corners) < 3:
        return None
    return _side(corners, unit(np.cross(corners[1] - corners[0], corners[2] - corners[0])[None])[0])[0]


def _side(corners: Floats, normal: Floats) -> tuple[Face, Indices]:
    """The side that is the hull of corners (n, 3) in a plane, and their order around it."""
    right = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])[None])[0]
    across = np.stack((right, np.cross(normal, right)))
    flat = (corners - corners.mean(axis=0)) @ across.T
    order = np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))
    low, size = flat.min(axis=0), np.ptp(flat, axis=0)
    start = corners.mean(axis=0) + low @ across
    return Face(start, size[0] * across[0], size[1] * across[1], ((flat[order] - low) / size,)), order


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
