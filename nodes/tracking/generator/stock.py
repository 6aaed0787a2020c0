"""Things for generated scenes: shapes of random sizes, how they can lie, and how several find room on a table.

Boxes and prisms, and curved ones: turned ones, a torus, a mug, and what pybullet's data set has."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, make_pose, unit
from hierax.nodes.tracking.model.files import read_mesh
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.simworld.shapes import Shape, Thing, angle_piece, box, wedge

# world_from_object of what lies as it was extruded, and of what has its y axis upwards.
_UPRIGHT = np.eye(3)
LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

_TRIES = 400

_SECTIONS = 96
_ARCS = 16
_SMOOTH = 0.8  # cosine of the angle up to which sides are seen as one smooth surface

# Files of pybullet's data, and how long the longest side of each is here, metres.
FOUND = {
    "objects/mug.obj": 0.11,
    "duck.obj": 0.1,
    "lego/lego.obj": 0.07,
    "torus/torus_textured.obj": 0.1,
    "soccerball.obj": 0.07,
    "teddy2_VHACD_CHs.obj": 0.11,
    "quadruped/tmotor3.obj": 0.086,
    "racecar/meshes/left_front_wheel.obj": 0.09,
    "domino/domino.obj": 0.08,
    "toys/prism.obj": 0.09,
}


class Item(NamedTuple):
    """A thing that has no place yet."""

    shape: Shape  # its form
    rest: Floats  # (3, 3) rotation in which it lies steadily
    colour: tuple[int, int, int]  # RGB, 0 to 255

    @property
    def height_m(self) -> float:
        """How high it is as it lies."""
        return float(np.ptp(self.shape.mesh.vertices @ self.rest.T, axis=0)[2])

    def placed(self, x_m: float, y_m: float, yaw_rad: float, bottom_m: float = 0.0) -> Thing:
        """The thing on a level plane, its frame's origin over (x, y)."""
        rotation = exp_so3(np.array([0.0, 0.0, yaw_rad])) @ self.rest
        lowest = float((self.shape.mesh.vertices @ rotation.T)[:, 2].min())
        return Thing(make_pose(rotation, np.array([x_m, y_m, bottom_m - lowest])), self.shape, self.colour)


def random_box(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A box with sides of 35 to 100 mm, no two alike."""
    while True:
        size = rng.uniform(0.035, 0.1, 3)
        if np.diff(np.sort(size)).min() > 0.006 and size[2] < 1.9 * size[:2].min():
            return Item(box(size.tolist()), _UPRIGHT, colour)


def small_box(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A box with sides of 22 to 45 mm, as many find room of."""
    return Item(box(rng.uniform(0.022, 0.045, 3).tolist()), _UPRIGHT, colour)


def flat_box(rng: np.random.Generator, colour: tuple[int, int, int], width_m: float) -> Item:
    """A box for a tower: about so wide, and 30 to 50 mm high."""
    return Item(box((width_m, width_m * rng.uniform(0.75, 0.92), rng.uniform(0.03, 0.05))), _UPRIGHT, colour)


def random_mesh(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A wedge or an angle piece, lying or upright."""
    width, depth, length = _sizes(rng)
    if rng.random() < 0.5:
        return Item(wedge(width, depth, length, rng.uniform(0.3, 0.7)), LYING, colour)
    lying = rng.random() < 0.5
    return Item(angle_piece(width, depth, rng.uniform(0.018, 0.028), length), LYING if lying else _UPRIGHT, colour)


def random_wedge(rng: np.random.Generator, colour: tuple[int, int, int]) -> Item:
    """A wedge, lying."""
    return Item(wedge(*_sizes(rng), rng.uniform(0.3, 0.7)), LYING, colour)


def _sizes(rng: np.random.Generator) -> tuple[float, float, float]:
    return rng.uniform(0.055, 0.095), rng.uniform(0.045, 0.075), rng.uniform(0.04, 0.09)


def colours(rng: np.random.Generator, count: int) -> list[tuple[int, int, int]]:
    """Different paints."""
    hues = (rng.uniform(0, 180) + 180.0 / count * rng.permutation(count)) % 180
    shades = np.stack((hues, rng.uniform(70, 200, count), rng.uniform(110, 230, count)), axis=1).astype(np.uint8)
    rgb = cv2.cvtColor(shades[None], cv2.COLOR_HSV2RGB)[0]
    return [(int(r), int(g), int(b)) for r, g, b in rgb]


def greys(rng: np.random.Generator, count: int, middle: float) -> list[tuple[int, int, int]]:
    """Paints that can hardly be told from one another."""
    levels = np.clip(middle + rng.uniform(-12.0, 12.0, count), 0, 255)
    tints = levels[:, None] + rng.uniform(-2.0, 2.0, (count, 3))
    return [(round(r), round(g), round(b)) for r, g, b in tints]


def scattered(
    items: Sequence[Item], rng: np.random.Generator, radius_m: float, gap_m: float, taken: Sequence[Thing] = ()
) -> list[Thing] | None:
    """Put items on the table, one after the other, at random in a disc around the origin, with some room between them
    and what is taken already; None where no room was found."""
    placed: list[Thing] = []
    prints = [footprint(thing, gap_m) for thing in taken]
    for item in items:
        for _ in range(_TRIES):
            turn, yaw = rng.uniform(-np.pi, np.pi, 2)
            reach = radius_m * np.sqrt(rng.random())
            thing = item.placed(reach * np.cos(turn), reach * np.sin(turn), yaw)
            own = footprint(thing, gap_m)
            if not any(cv2.intersectConvexConvex(own, other)[0] > 0.0 for other in prints):
                prints.append(own)
                placed.append(thing)
                break
        else:
            return None
    return placed


def stacked(items: Sequence[Item], rng: np.random.Generator, x_m: float, y_m: float) -> list[Thing]:
    """Items on top of one another, the first below, each a little off and turned."""
    tower: list[Thing] = []
    bottom, yaw = 0.0, rng.uniform(-np.pi, np.pi)
    for item in items:
        off = rng.uniform(-0.006, 0.006, 2) if tower else np.zeros(2)
        tower.append(item.placed(x_m + off[0], y_m + off[1], yaw, bottom))
        bottom += item.height_m
        yaw += rng.uniform(-0.6, 0.6)
    return tower


def footprint(thing: Thing, gap_m: float) -> Array:
    """Convex hull (n, 1, 2) of what a thing covers of the table, with half the gap around it; float32, millimetres."""
    corners = np.concatenate(thing.parts())[:, :2]
    around = 0.5 * gap_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    grown = (corners[:, None] + around[None]).reshape(-1, 2)
    return np.asarray(cv2.convexHull((1000.0 * grown).astype(np.float32)))


def found_thing(name: str, colour: tuple[int, int, int]) -> Item:
    """One of `FOUND`, upright as its file has it or lying flat."""
    import pybullet_data

    mesh = read_mesh(Path(pybullet_data.getDataPath()) / name, 1.0)
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used]
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    vertices = (vertices - low - size / 2.0) * (FOUND[name] / size.max())
    made = smooth_shape(Mesh(vertices, faces.reshape(-1, 3).astype(np.int32)), [vertices])
    upright = np.eye(3) if name in _STANDING else np.roll(np.eye(3), 2 - int(size.argmin()), axis=0)
    return Item(made, upright, colour)


_STANDING = ("objects/mug.obj", "lego/lego.obj", "duck.obj")


def turned(profile: Sequence[tuple[float, float]], parts: Sequence[tuple[int, int]] = ()) -> Shape:
    """What turning a profile about z makes: (radius, height) of its corners from the axis below, outside, to the axis
    above, metres. Between pairs of corners its outside is convex; where there are none, all of it is."""
    import trimesh

    made = trimesh.creation.revolve(np.array(profile), sections=_SECTIONS)
    turns = 2.0 * np.pi * np.arange(48) / 48
    rings = [np.column_stack((r * np.cos(turns), r * np.sin(turns), np.full(48, z))) for r, z in profile]
    convex = [np.concatenate(rings[first : last + 1]) for first, last in parts or [(0, len(rings) - 1)]]
    return smooth_shape(Mesh(np.asarray(made.vertices), made.faces.astype(np.int32)), convex)


def cylinder(radius_m: float, height_m: float) -> Shape:
    """A cylinder about z, from z = 0 on."""
    return turned([(0.0, 0.0), (radius_m, 0.0), (radius_m, height_m), (0.0, height_m)])


def bottle(radius_m: float, height_m: float) -> Shape:
    """A bottle with a round shoulder."""
    bend = np.linspace(0.0, np.pi / 2.0, _ARCS)
    neck = 0.4 * radius_m
    shoulder = [(neck + (radius_m - neck) * np.cos(at), height_m * (0.62 + 0.2 * np.sin(at))) for at in bend]
    profile = [(0.0, 0.0), (radius_m, 0.0), *shoulder, (neck, height_m), (0.0, height_m)]
    return turned(profile, [(0, len(profile) - 3), (len(profile) - 3, len(profile) - 1)])


def ball(radius_m: float) -> Shape:
    """A ball around the origin."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
    return smooth_shape(Mesh(np.asarray(made.vertices), made.faces.astype(np.int32)), [np.asarray(made.vertices)])


def torus(radius_m: float, tube_m: float) -> Shape:
    """A torus about z, lying on z = -tube_m."""
    turns = np.linspace(0.0, 2.0 * np.pi, _SECTIONS + 1)
    return tube(radius_m * np.column_stack((np.cos(turns), np.sin(turns), 0.0 * turns)), tube_m)


def mug(radius_m: float, height_m: float) -> Shape:
    """A mug with a handle, standing on z = 0."""
    wall = 0.0035
    inner = radius_m - wall
    profile = [(0.0, 0.0), (radius_m, 0.0), (radius_m, height_m), (inner, height_m), (inner, wall), (0.0, wall)]
    cup = turned(profile, [(0, 2)])
    bend = np.linspace(-np.pi / 2.0, np.pi / 2.0, 2 * _ARCS)
    reach = 0.27 * height_m
    course = np.column_stack(
        (radius_m - wall / 2.0 + reach * np.cos(bend), 0.0 * bend, height_m / 2.0 + reach * np.sin(bend))
    )
    handle = tube(course, 0.0045)
    faces = np.concatenate((cup.mesh.faces, handle.mesh.faces + len(cup.mesh.vertices)))
    mesh = Mesh(np.concatenate((cup.mesh.vertices, handle.mesh.vertices)), faces)
    assert cup.normals is not None
    assert handle.normals is not None
    return Shape((), (*cup.convex, *handle.convex), mesh, np.concatenate((cup.normals, handle.normals)))


def tube(course: Floats, radius_m: float) -> Shape:
    """A round tube along a plane course (n, 3), closed where that is a ring."""
    ring = bool(np.allclose(course[0], course[-1]))
    along = unit(np.gradient(course, axis=0))
    if ring:
        along[[0, -1]] = unit(course[1] - course[-2])
    square = np.linalg.svd(course - course.mean(axis=0))[2][2]
    turns = 2.0 * np.pi * np.arange(2 * _ARCS) / (2 * _ARCS)
    across = np.cross(square, along)
    rings = course[:, None] + radius_m * (np.cos(turns)[:, None] * across[:, None] + np.sin(turns)[:, None] * square)
    count, around = len(course), len(turns)
    at, to = np.meshgrid(np.arange(count - 1), np.arange(around), indexing="ij")
    after = (to + 1) % around
    near, far = at * around, ((at + 1) % (count - 1) if ring else at + 1) * around
    corners = [near + to, near + after, far + after, far + to]
    faces = [np.stack(corners)[[0, 1, 2]].reshape(3, -1).T, np.stack(corners)[[0, 2, 3]].reshape(3, -1).T]
    if not ring:
        fan = np.array([(0, step + 1, step) for step in range(1, around - 1)])
        faces += [fan, fan[:, ::-1] + (count - 1) * around]
    vertices = rings[: count - ring].reshape(-1, 3)
    pieces = [np.concatenate(rings[start : start + 5]) for start in range(0, count - 1, 4)]
    return smooth_shape(Mesh(vertices, np.concatenate(faces).astype(np.int32)), pieces)


def smooth_shape(mesh: Mesh, convex: Sequence[Floats]) -> Shape:
    """A shape that is drawn as its mesh, shaded as if it were round where sides meet at small angles."""
    corners = mesh.vertices[mesh.faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if float(np.einsum("nk,nk->", corners[:, 0], weighted)) < 0.0:
        mesh, weighted = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy()), -weighted
    flat = unit(weighted)
    spots = np.rint(mesh.vertices[mesh.faces].reshape(-1, 3) / 1e-6).astype(int)
    places = np.unique(spots, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(places, kind="stable")
    normals = np.empty((len(order), 3))
    for group in np.split(order, np.nonzero(np.diff(places[order]))[0] + 1):
        near = flat[group // 3] @ flat[group // 3].T > _SMOOTH
        normals[group] = near @ weighted[group // 3]
    return Shape((), tuple(convex), mesh, unit(normals).reshape(-1, 3, 3))
