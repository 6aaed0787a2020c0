"""CAO and VRML files, made up and tiny."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cad import cut, mesh_of, read_cao, read_vrml

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.math.geometry import Floats, exp_so3
from hierax.nodes.tracking.model.symmetry import found_symmetry

CAO = """# a roof
V1
4  # points
0 0 0
1 0 0
1 1 0
0 1 0  # the last
0
0
1
4 0 1 2 3 name=floor
0
0
"""

VRML = """#VRML V2.0 utf8
Transform { translation 1 0 0 children [ PointLight { on TRUE } ] }
Shape { geometry IndexedFaceSet {
coord Coordinate { point [ 0 0 0, 1 0 0, 1 1 0, 0 1 0 ] }
coordIndex [
# 3, 2, 1, 0, -1,
 0, 1, 2, 3, -1] } }
Shape { geometry IndexedLineSet { coord Coordinate { point [ 5 5 5, 6 6 6] } coordIndex [ 0, 1, -1] } }
Shape { geometry IndexedFaceSet { coord Coordinate { point [ 0 0 0, 0 1 0, 0 1 1 ] } coordIndex [ 0, 1, 2 ] } }
"""


def area(vertices: Floats, faces: Floats) -> float:
    corners = vertices[faces]
    return float(
        0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )


def test_a_cao_file_with_one_that_it_loads(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "floor.cao").write_text(CAO)
    wall = CAO.replace("V1\n", 'V1\nload("parts/floor.cao")\n').replace("1 1 0\n0 1 0", "1 0 1\n0 0 1")
    (tmp_path / "house.cao").write_text(wall)
    mesh = read_cao(tmp_path / "house.cao")
    assert len(mesh.vertices) == 6, "corners at one place are one"
    assert area(mesh.vertices, mesh.faces) == pytest.approx(2.0)


def test_a_vrml_file_has_its_face_sets(tmp_path: Path) -> None:
    (tmp_path / "house.wrl").write_text(VRML)
    mesh = read_vrml(tmp_path / "house.wrl")
    assert len(mesh.vertices) == 5
    assert len(mesh.faces) == 3
    assert area(mesh.vertices, mesh.faces) == pytest.approx(1.5)


@pytest.mark.parametrize("seed", range(4))
def test_polygons_with_inward_corners_are_cut_well(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = np.sort(rng.uniform(0, 2 * np.pi, 11))
    star = rng.uniform(0.2, 1.0, 11)[:, None] * np.column_stack((np.cos(turns), np.sin(turns)))
    flat = np.column_stack((star, np.zeros(11)))[:: rng.choice([-1, 1])]
    following = np.roll(flat, -1, axis=0)
    signed = 0.5 * (flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum()
    polygon = flat @ exp_so3(rng.standard_normal(3)).T
    triangles = np.array(cut(polygon))
    corners = flat[triangles][..., :2]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert (areas * np.sign(signed) > 0).all()
    assert areas.sum() == pytest.approx(signed)


def test_faces_without_area_are_left_out() -> None:
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])
    mesh = mesh_of(Path("x"), [flat, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])])
    assert len(mesh.faces) == 1
    with pytest.raises(DataError, match="x: no faces"):
        mesh_of(Path("x"), [np.zeros((4, 3))])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "begins with V1"),
        ("V1\n4\n0 0 0\n", "expected the sections points, lines"),
        (CAO.replace("0 0 0", "0 x 0"), "expected the sections"),
        (CAO.replace("4 0 1 2 3", "4 0 1 2 9"), "face 0: names points"),
        (CAO.replace("name=floor\n0\n", "name=floor\n1\n0 9 0.5\n"), "cylinder 0: names points"),
        (CAO.replace("0 1 0  # the last\n0\n", "0 1 0\n1\n0 1\n"), "lines; expected a model of points, faces"),
        (CAO.replace("V1\n", 'V1\nload("model.cao", t=[0;0;1])\n'), "expected what is loaded at its place"),
        ('V1\nload("model.cao")\n0\n0\n0\n0\n', "too deep"),
    ],
)
def test_bad_cao_files_are_named(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "model.cao").write_text(content)
    with pytest.raises(DataError, match=rf"model\.cao: .*{said}"):
        read_cao(tmp_path / "model.cao")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("#VRML V2.0 utf8\n", "no faces"),
        (VRML.replace("0 1 0 ]", "0 1 ]"), "face set 1: 11 coordinates"),
        (VRML.replace("1 1 0,", "1 y 0,"), "face set 1: points: expected numbers"),
        (VRML.replace(" 0, 1, 2, 3, -1]", " 0, 1, 2, 8, -1]"), "face set 1: names points"),
        (VRML.replace("PointLight { on TRUE }", VRML.split("\n", 2)[2]), "within a Transform"),
    ],
)
def test_bad_vrml_files_are_named(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "model.wrl").write_text(content)
    with pytest.raises(DataError, match=rf"model\.wrl: .*{said}"):
        read_vrml(tmp_path / "model.wrl")


def test_missing_files_are_named(tmp_path: Path) -> None:
    for read in (read_cao, read_vrml):
        with pytest.raises(DataError, match="none: cannot be read"):
            read(tmp_path / "none")


def test_cylinders_are_closed_and_a_circle_that_ends_one_is_there_once(tmp_path: Path) -> None:
    text = "V1\n4\n0 0 1\n0 0 -1\n1 0 1\n0 1 1\n0\n0\n0\n1\n0 1 1\n1\n1 0 2 3\n"
    path = tmp_path / "model.cao"
    path.write_text(text)
    mesh = read_cao(path)
    corners = mesh.vertices[mesh.faces]
    volume = float(np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6)
    assert volume == pytest.approx(2.0 * np.pi, rel=0.002)
    assert len(found_symmetry(mesh, 0.002)["free"]) == 1
    path.write_text(text.replace("1 0 2 3", "0.5 0 2 3"))
    assert area(*read_cao(path)) == pytest.approx(area(*mesh) + 0.25 * np.pi, rel=0.002)
