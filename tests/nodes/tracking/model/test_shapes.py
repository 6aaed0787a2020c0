"""What of a mesh is an edge, however it is wound and cut into triangles."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import cylinder, divided, ell, sphere

from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import Shape, shape_of

BOX = box_mesh((0.1, 0.06, 0.04))


def ends(shape: Shape) -> set[tuple[tuple[float, ...], ...]]:
    """The edges by where they begin and end."""
    return {tuple(sorted(map(tuple, np.round(shape.vertices[edge], 6).tolist()))) for edge in shape.edges}


def test_a_box_has_twelve_edges_and_six_sides() -> None:
    shape = shape_of(*BOX)
    assert (shape.convex, shape.closed.all(), len(shape.smooth)) == (True, True, 0)
    assert sorted(shape.chains) == list(range(12))
    assert len(np.unique(shape.patches)) == 6
    along = np.diff(shape.vertices[shape.edges], axis=1)
    for side in range(2):
        inwards, normals = shape.inwards[:, side], shape.normals[shape.edge_faces[:, side]]
        assert np.linalg.norm(inwards, axis=1) == pytest.approx(1.0)
        assert np.abs(np.sum(inwards * along[:, 0], axis=1)).max() < 1e-12
        assert np.abs(np.sum(inwards * normals, axis=1)).max() < 1e-12
        # A little way in is still on the box.
        inner = shape.vertices[shape.edges].mean(axis=1) + 0.01 * inwards
        assert (np.abs(inner) <= np.array([0.05, 0.03, 0.02]) + 1e-9).all()


@pytest.mark.parametrize("seed", range(3))
def test_winding_and_doubled_vertices_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = divided(*BOX)
    turned = rng.random(len(faces)) < 0.5
    faces[turned] = faces[turned][:, ::-1]
    shape = shape_of(vertices, faces)
    assert (shape.convex, shape.closed.all()) == (True, True)
    # The pieces of an edge are one chain, in its order.
    assert len(shape.edges) == 24
    for chain in range(12):
        pieces = shape.vertices[shape.edges[shape.chains == chain]]
        assert np.array_equal(pieces[0, 1], pieces[1, 0])
        assert np.linalg.norm(pieces[1, 1] - pieces[0, 0]) == pytest.approx(
            np.linalg.norm(pieces[0, 1] - pieces[0, 0]) + np.linalg.norm(pieces[1, 1] - pieces[1, 0])
        )
    centres = shape.vertices[shape.faces].mean(axis=1)
    assert (np.sum(shape.normals * centres, axis=1) > 0).all()


def test_an_open_box_has_edges_where_it_ends() -> None:
    shape = shape_of(BOX.vertices, BOX.faces[:-2])
    assert not shape.closed.any()
    assert not shape.convex
    assert ends(shape) == ends(shape_of(*BOX))
    assert (shape.edge_faces[:, 1] < 0).sum() == 4
    assert np.array_equal(np.linalg.norm(shape.inwards[:, 1], axis=1) > 0.5, shape.edge_faces[:, 1] >= 0)


def test_where_three_sheets_meet_one_ends_on_the_two_others() -> None:
    vertices = np.array([[0, 0, 0], [0, 0, 1.0], [1, 0, 0], [-1, 0.5, 0], [-1, -0.5, 0]])
    shape = shape_of(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    assert not shape.closed.any()
    assert len(shape.edges) == 8
    assert len(ends(shape)) == 7
    assert sorted(shape.edge_faces.ravel()) == [-1] * 7 + [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_an_ell_is_closed_but_hides_itself() -> None:
    shape = shape_of(*ell())
    assert shape.closed.all()
    assert not shape.convex
    assert len(shape.edges) == 18
    assert len(np.unique(shape.patches)) == 8


def test_a_cylinder_is_smooth_beside_its_rims() -> None:
    shape = shape_of(*cylinder(0.03, 0.08, 40))
    assert shape.convex
    assert len(shape.edges) == 80
    # Each rim in arcs of at most 45 degrees, its pieces one behind the other.
    assert len(np.unique(shape.chains)) == 14
    for chain in np.unique(shape.chains):
        pieces = shape.vertices[shape.edges[shape.chains == chain]]
        assert np.array_equal(pieces[1:, 0], pieces[:-1, 1])
        along = pieces[:, 1] - pieces[:, 0]
        assert (along @ along[0]).min() > 0.7 * along[0] @ along[0]
    assert len(np.unique(shape.patches)) == 3
    assert len(shape.smooth) == 80
    assert np.array_equal(shape.corners[shape.smooth_corners], shape.vertices[shape.faces[shape.smooth]])
    radial = shape.corners * (1.0, 1.0, 0.0) / 0.03
    assert np.sum(radial * shape.corner_normals, axis=1).min() > np.cos(0.08)


def test_a_sphere_has_no_edges() -> None:
    shape = shape_of(*sphere(0.05, 40, 40))
    assert shape.convex
    assert len(shape.edges) == 0
    assert len(shape.smooth) == len(shape.faces)
    assert np.sum(shape.corners * shape.corner_normals, axis=1) == pytest.approx(0.05, rel=1e-3)
