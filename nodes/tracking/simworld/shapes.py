"""Shapes of the simulated pictures: plane faces, which are drawn, and convex parts, which throw shadows."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from math import sqrt
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, invert, transform
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh


class Face(NamedTuple):
    """A plane side of a body, seen from outside: corner + a * right + b * up, metres."""

    corner: Floats  # corner, right, up: (3,); a and b go from 0 to 1
    right: Floats
    up: Floats
    # convex polygons (n, 2) of a and b, counter-clockwise, that the side consists of; none for the whole parallelogram
    cells: tuple[Floats, ...] = ()

    @property
    def normal(self) -> Floats:
        """Unit vector that points outwards."""
        (a, b, c), (x, y, z) = self.right.tolist(), self.up.tolist()
        d, e, f = b * z - c * y, c * x - a * z, a * y - b * x  # to the bit np.cross, which takes far longer
        length = sqrt(d * d + e * e + f * f)
        return np.array((d / length, e / length, f / length))

    def moved(self, pose: Floats) -> "Face":
        """The same face in the frame that the pose leads to."""
        rotation = pose[:3, :3]
        return self._replace(corner=transform(pose, self.corner), right=rotation @ self.right, up=rotation @ self.up)


class Shape(NamedTuple):
    """A body's form, in its own frame."""

    sides: tuple[Face, ...]  # its faces
    convex: tuple[Floats, ...]  # corners (n, 3) of the convex parts that it consists of
    mesh: Mesh  # its surface
    normals: Floats | None = None  # (m, 3, 3) of a curved one, which is drawn as its mesh: at each triangle's corners


class Thing(NamedTuple):
    """A body; what it tells of itself is in the world's frame."""

    pose: Floats  # world_from_object, 4x4
    shape: Shape  # its form
    colour: tuple[int, int, int]  # RGB, 0 to 255

    def curved(self) -> tuple[Floats, Floats] | None:
        """Corners and normals (m, 3, 3) of the triangles of a curved body, which has no plane sides."""
        if self.shape.normals is None:
            return None
        corners = self.shape.mesh.vertices[self.shape.mesh.faces]
        return transform(self.pose, corners), self.shape.normals @ self.pose[:3, :3].T

    def faces(self) -> list[Face]:
        """All sides."""
        return [face.moved(self.pose) for face in self.shape.sides]

    def facing(self, viewpoint: Floats) -> list[Face]:
        """The sides that look towards a point (3,)."""
        own = transform(invert(self.pose), viewpoint)
        return [side.moved(self.pose) for side in self.shape.sides if side.normal @ (own - side.corner) > 0]

    def parts(self) -> list[Floats]:
        """The corners (n, 3) of the convex parts that it consists of."""
        return [transform(self.pose, corners) for corners in self.shape.convex]


def cube_corners(side_m: float) -> Floats:
    """The corners of a cube in its own frame, (8, 3)."""
    return np.array(list(product((-1.0, 1.0), repeat=3))) * side_m / 2


@lru_cache(maxsize=16)
def cube(side_m: float) -> Shape:
    """A cube around its frame's origin."""
    sides = []
    for axis, sign in product(range(3), (-1.0, 1.0)):
        normal, across, along = side_m * np.roll(np.eye(3), -axis, axis=0)
        right, up = (across, along) if sign > 0 else (along, across)
        sides.append(Face((sign * normal - right - up) / 2, right, up))
    return Shape(tuple(sides), (cube_corners(side_m),), box_mesh([side_m] * 3))


def box(size: Sequence[float]) -> Shape:
    """A box; side lengths along x, y and z in metres."""
    x, y = size[0] / 2, size[1] / 2
    return extruded([(-x, -y), (x, -y), (x, y), (-x, y)], size[2])


def wedge(width_m: float, depth_m: float, length_m: float, ridge: float = 0.5) -> Shape:
    """A triangular prism, its triangle in the plane of x and y, from z = -length_m / 2 on; `ridge` is 0.1 to 0.9."""
    x, y = width_m / 2, depth_m / 2
    return extruded([(-x, -y), (x, -y), ((2.0 * ridge - 1.0) * x, y)], length_m)


def angle_piece(width_m: float, depth_m: float, thickness_m: float, length_m: float) -> Shape:
    """A body whose section in the plane of x and y is an L."""
    x, y, t = width_m / 2, depth_m / 2, thickness_m
    outline = [(-x, -y), (x, -y), (x, t - y), (t - x, t - y), (t - x, y), (-x, y)]
    return extruded(outline, length_m, cells=[(0, 1, 2, 3), (0, 3, 4, 5)])


def regular(corners: int, radius_m: float, length_m: float) -> Shape:
    """A prism over a regular polygon in the plane of x and y."""
    turns = 2.0 * np.pi * np.arange(corners) / corners
    return extruded(radius_m * np.column_stack((np.cos(turns), np.sin(turns))), length_m)


def extruded(
    outline: Floats | Sequence[tuple[float, float]], length_m: float, cells: Sequence[Sequence[int]] = ()
) -> Shape:
    """A prism over a polygon in the plane of x and y, its corners counter-clockwise, from z = -length_m / 2 to length_m
    / 2. Where the outline is not convex, `cells` are the convex polygons, by corners, of which it consists."""
    corners = np.asarray(outline, dtype=np.float64)
    count = len(corners)
    pieces = [list(cell) for cell in cells] or [list(range(count))]
    low = np.column_stack((corners, np.full(count, -length_m / 2)))
    vertices = np.concatenate((low, low + np.array([0.0, 0.0, length_m])))
    origin, size = corners.min(axis=0), np.ptp(corners, axis=0)
    within = [(corners[piece] - origin) / size for piece in pieces]
    width, depth, height = np.diag([*size, length_m])
    start = np.array([*origin, -length_m / 2])
    top = Face(start + height, width, depth, tuple(within))
    bottom = Face(start, depth, width, tuple(cell[::-1, ::-1] for cell in within))
    following = [(at + 1) % count for at in range(count)]
    sides = [Face(low[at], low[to] - low[at], height) for at, to in enumerate(following)]
    caps = [(piece[0], piece[at], piece[at + 1]) for piece in pieces for at in range(1, len(piece) - 1)]
    faces = [(a + count, b + count, c + count) for a, b, c in caps] + [(c, b, a) for a, b, c in caps]
    for at, to in enumerate(following):
        faces += [(at, to, to + count), (at, to + count, at + count)]
    convex = tuple(vertices[[*piece, *(at + count for at in piece)]] for piece in pieces)
    return Shape((top, bottom, *sides), convex, Mesh(vertices, np.array(faces, dtype=np.int32)))
