"""Meshes."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.tracking.model.mesh import Mesh, box_mesh, triangulated


def volume(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def test_a_box_is_closed_and_faces_outwards() -> None:
    mesh = box_mesh((0.1, 0.2, 0.3))
    assert volume(mesh) == pytest.approx(0.006)
    assert np.allclose(np.ptp(mesh.vertices, axis=0), (0.1, 0.2, 0.3))
    edges = {(int(a), int(b)) for face in mesh.faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    assert all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize("size", [(0.1, 0.2), (0.1, 0.2, 0.0), (0.1, -1.0, 1.0), (0.1, 0.2, float("nan"))])
def test_a_box_needs_three_lengths(size: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="three positive lengths"):
        box_mesh(size)


def test_polygons_become_fans() -> None:
    assert triangulated([[4, 5, 6, 7], [1, 2], [0, 1, 2]]).tolist() == [[4, 5, 6], [4, 6, 7], [0, 1, 2]]
