"""Curved things for generated scenes: turned ones, a torus, a mug, and what pybullet's data set has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hierax.nodes.tracking.generator.things import Item
from hierax.nodes.tracking.math.geometry import Floats, unit
from hierax.nodes.tracking.model.files import read_mesh
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.simworld.shapes import Shape

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


def found_thing(name: str, colour: tuple[int, int, int]) -> Item:
    """One of `FOUND`, upright as its file has it or lying flat."""
    import pybullet_data

    mesh = read_mesh(Path(pybullet_data.getDataPath()) / name, 1.0)
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used]
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    vertices = (vertices - low - size / 2.0) * (FOUND[name] / size.max())
    made = smooth_shape(Mesh(vertices, faces.reshape(-1, 3).astype(np.int32)), [vertices])
    upright = np.eye(3) if name in _UPRIGHT else np.roll(np.eye(3), 2 - int(size.argmin()), axis=0)
    return Item(made, upright, colour)


_UPRIGHT = ("objects/mug.obj", "lego/lego.obj", "duck.obj")


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
