"""Outlines of smooth surfaces: where the normal is at right angles to the ray, in unbroken chains."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import cylinder, sphere

from hierax.nodes.tracking.imagery.edges import outline_of
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of


def torus(ring: float, tube: float, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    phi, theta = np.meshgrid(
        2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    radius = ring + tube * np.cos(theta)
    vertices = np.stack((radius * np.cos(phi), radius * np.sin(phi), tube * np.sin(theta)), axis=-1).reshape(-1, 3)
    a = np.arange(rows * columns).reshape(rows, columns)
    b, c = np.roll(a, -1, axis=0), np.roll(np.roll(a, -1, axis=0), -1, axis=1)
    d = np.roll(a, -1, axis=1)
    return vertices, np.concatenate((np.stack((a, b, c), -1).reshape(-1, 3), np.stack((a, c, d), -1).reshape(-1, 3)))


@pytest.mark.parametrize("seed", range(4))
def test_a_sphere_has_one_ring(seed: int) -> None:
    viewpoint = np.random.default_rng(seed).normal(size=3)
    viewpoint *= 0.4 / np.linalg.norm(viewpoint)
    found = outline_of(shape_of(*sphere(0.05, 50, 50)), viewpoint)
    assert (found.chains == 0).all()
    assert found.ends[1:, 0] == pytest.approx(found.ends[:-1, 1], abs=1e-12)
    assert found.ends[0, 0] == pytest.approx(found.ends[-1, 1], abs=1e-12)
    across = np.sum((viewpoint - found.ends[:, 0]) * found.outwards, axis=1) / 0.4
    assert np.abs(across).max() < 0.01
    # It goes once around: its length is that of the circle on which tangents touch.
    length = np.linalg.norm(found.ends[:, 1] - found.ends[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * np.pi * 0.05 * np.sqrt(1 - (0.05 / 0.4) ** 2), rel=0.02)


def test_a_torus_has_two_rings() -> None:
    found = outline_of(shape_of(*torus(0.04, 0.015, 60, 30)), np.array([0.1, 0.05, 0.4]))
    assert set(found.chains) == {0, 1}
    mean = [np.linalg.norm(found.ends[found.chains == chain, 0, :2], axis=1).mean() for chain in (0, 1)]
    assert sorted(mean) == pytest.approx([0.025, 0.055], abs=0.003)
    for chain in (0, 1):
        ends = found.ends[found.chains == chain]
        assert ends[1:, 0] == pytest.approx(ends[:-1, 1], abs=1e-12)


def test_a_cylinder_has_two_open_chains() -> None:
    shape = shape_of(*cylinder(0.03, 0.08, 40))
    found = outline_of(shape, np.array([0.4, 0.1, 0.3]))
    assert set(found.chains) == {0, 1}
    for chain in (0, 1):
        ends = found.ends[found.chains == chain]
        assert sorted((ends[0, 0, 2], ends[-1, 1, 2])) == pytest.approx([-0.04, 0.04])
    # From above the lid the side is not seen to turn away.
    assert len(outline_of(shape, np.array([0.0, 0.0, 0.5])).ends) == 0


def test_a_box_has_none() -> None:
    assert len(outline_of(shape_of(*box_mesh((0.1, 0.06, 0.04))), np.array([0.3, 0.2, 0.4])).ends) == 0
