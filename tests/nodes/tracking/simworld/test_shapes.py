"""Shapes: closed surfaces that look outwards, whose faces, parts and meshes are of one body."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose
from hierax.nodes.tracking.simworld.shapes import Face, Shape, Thing, angle_piece, box, cube, regular, wedge

SHAPES = {
    "cube": (cube(0.05), 0.05**3),
    "box": (box((0.04, 0.06, 0.1)), 0.04 * 0.06 * 0.1),
    "wedge": (wedge(0.08, 0.05, 0.06, 0.3), 0.08 * 0.05 / 2 * 0.06),
    "angle piece": (angle_piece(0.08, 0.07, 0.02, 0.05), (0.08 * 0.02 + 0.02 * 0.05) * 0.05),
    "rod": (regular(8, 0.01, 0.3), 8 / 2 * np.sin(np.pi / 4) * 0.01**2 * 0.3),
}


def volume(vertices: Floats, faces: Floats) -> float:
    corners = vertices[faces]
    return float(np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6)


@pytest.mark.parametrize("name", SHAPES)
def test_the_mesh_is_closed_and_holds_the_volume(name: str) -> None:
    shape, expected = SHAPES[name]
    assert volume(shape.mesh.vertices, shape.mesh.faces) == pytest.approx(expected)
    sides = np.concatenate([shape.mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]).tolist()
    assert sorted(sides) == sorted([b, a] for a, b in sides)


def test_a_normal_is_to_the_bit_that_of_numpy() -> None:
    for corner, right, up in np.random.default_rng(7).normal(size=(200, 3, 3)):
        expected = np.cross(right, up)
        x, y, z = expected
        # What adds up squares for a norm of numpy's differs in the last bit from one processor to another.
        np.testing.assert_array_equal(Face(corner, right, up).normal, expected / np.sqrt(x * x + y * y + z * z))


def areas(shape: Shape) -> tuple[Floats, float]:
    """The sum of the faces' area vectors, nothing for a closed body that looks outwards, and their area."""
    vectors = []
    for face in shape.sides:
        whole = np.cross(face.right, face.up)
        shares = [1.0]
        if face.cells:
            shares = []
            for cell in face.cells:
                following = np.roll(cell, -1, axis=0)
                shares.append(float(0.5 * (cell[:, 0] * following[:, 1] - cell[:, 1] * following[:, 0]).sum()))
            assert min(shares) > 0.0
        vectors.append(sum(shares) * whole)
    return np.sum(vectors, axis=0), float(np.linalg.norm(vectors, axis=1).sum())


@pytest.mark.parametrize("name", SHAPES)
def test_faces_are_those_of_the_mesh(name: str) -> None:
    shape, _ = SHAPES[name]
    total, area = areas(shape)
    corners = shape.mesh.vertices[shape.mesh.faces]
    triangles = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(total, 0.0, atol=1e-12)
    assert area == pytest.approx(np.linalg.norm(triangles, axis=1).sum())
    for face in shape.sides:
        heights = (shape.mesh.vertices - face.corner) @ face.normal
        assert np.isclose(heights, 0.0, atol=1e-12).sum() >= 3


def test_a_thing_is_where_its_pose_is() -> None:
    pose = make_pose(exp_so3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3]))
    thing, cubic = (Thing(pose, shape, (1, 2, 3)) for shape in (box((0.05, 0.05, 0.05)), cube(0.05)))
    for body in (thing, cubic):
        (corners,) = body.parts()
        np.testing.assert_allclose(corners.mean(axis=0), pose[:3, 3], atol=1e-12)
        for face in body.faces():
            np.testing.assert_allclose((pose[:3, 3] - face.corner) @ face.normal, -0.025, atol=1e-12)
    order = [np.lexsort(body.parts()[0].round(9).T) for body in (thing, cubic)]
    np.testing.assert_allclose(thing.parts()[0][order[0]], cubic.parts()[0][order[1]])
