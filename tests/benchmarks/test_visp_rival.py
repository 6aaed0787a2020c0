"""What the rival is given: models of plane faces, and a list of frames. The rival itself is not run."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from cad import read_cao

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.nodes.tracking.math.geometry import invert
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.simworld.shapes import angle_piece, box, wedge

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "visp_rival" / "compare.py"


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("visp_rival_compare", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


compare = load()


@pytest.mark.parametrize(
    ("mesh", "corners"),
    [
        (box((0.1, 0.2, 0.3)).mesh, [4] * 6),
        (wedge(0.1, 0.1, 0.1).mesh, [3, 3, 4, 4, 4]),
        (angle_piece(0.1, 0.1, 0.03, 0.1).mesh, [4] * 6 + [6, 6]),
    ],
)
def test_a_mesh_becomes_its_plane_faces(mesh: Mesh, corners: list[int], tmp_path: Path) -> None:
    faces = compare.plane_faces(mesh)
    assert sorted(len(face) for face in faces) == corners
    compare.write_cao(tmp_path / "model.cao", mesh)
    again = read_cao(tmp_path / "model.cao")
    areas = []
    for each in (mesh, again):
        points = each.vertices[each.faces]
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-9)
        areas.append(np.linalg.norm(normals, axis=1).sum())
    assert areas[0] == pytest.approx(areas[1])


def test_a_plane_part_with_a_hole_is_refused() -> None:
    outer = np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    vertices = np.concatenate((outer, outer / 2))
    ring = [(at, (at + 1) % 4, 4 + at) for at in range(4)] + [
        ((at + 1) % 4, 4 + (at + 1) % 4, 4 + at) for at in range(4)
    ]
    with pytest.raises(DataError, match="holes"):
        compare.plane_faces(Mesh(vertices, np.array(ring, dtype=np.int32)))


def test_the_list_has_objects_and_frames(tmp_path: Path) -> None:
    scene = BopScene(write_scene(tmp_path, "tower", 0, frames=2))
    words = [line.split() for line in compare.write_list(scene, tmp_path).read_text().splitlines()]
    assert [row[0] for row in words] == ["camera", *["object"] * 6, "frame", "frame"]
    np.testing.assert_allclose(np.array(words[1][3:], float).reshape(4, 4), scene.first_objects()[0].pose, atol=1e-9)
    np.testing.assert_allclose(np.array(words[-1][3:], float).reshape(4, 4), invert(scene.frames[1].camera), atol=1e-9)
    assert Path(words[-1][2]).read_bytes().startswith(b"P5")
