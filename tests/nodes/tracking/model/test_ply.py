"""PLY files: all formats, and errors that say where."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.tracking.errors import DataError
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.ply import read_ply, write_ply

ASCII = """ply
format ascii 1.0
comment a square pyramid
element vertex 5
property float x
property float y
property float z
property uchar red
element face 5
property list uchar int vertex_indices
end_header
0 0 0 9
10 0 0 9
10 10 0 9
0 10 0 9
5 5 8 9
4 3 2 1 0
3 0 1 4
3 1 2 4
3 2 3 4
3 3 0 4
"""


def binary(order: str, faces: list[list[int]]) -> bytes:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = (
        f"ply\nformat {name} 1.0\nelement vertex 4\nproperty double x\nproperty float nx\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\nproperty list uchar uint vertex_index\nproperty short flags\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    data = header.encode()
    for x, y, z in ((0, 0, 0), (1000, 0, 0), (0, 1000, 0), (0, 0, 1000)):
        data += struct.pack(order + "dfdd", x, 7.0, y, z)
    for face in faces:
        data += struct.pack(f"{order}B{len(face)}Ih", len(face), *face, -3)
    return data + struct.pack(order + "ii", 0, 1)


def test_ascii_with_polygons_and_further_properties(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(ASCII)
    mesh = read_ply(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0], [0.005, 0.005, 0.008]]
    assert mesh.faces.tolist() == [[3, 2, 1], [3, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("faces", [[[0, 2, 1], [0, 1, 3]], [[0, 2, 1, 3], [0, 1, 3]]])
def test_binary_of_both_orders(tmp_path: Path, order: str, faces: list[list[int]]) -> None:
    path = tmp_path / "b.ply"
    path.write_bytes(binary(order, faces))
    mesh = read_ply(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    expected = [[0, 2, 1], [0, 1, 3]] if len(faces[0]) == 3 else [[0, 2, 1], [0, 1, 3], [0, 1, 3]]
    assert mesh.faces.tolist() == expected


def test_what_is_written_is_read(tmp_path: Path) -> None:
    mesh = box_mesh((0.03, 0.05, 0.07))
    write_ply(tmp_path / "box.ply", mesh)
    back = read_ply(tmp_path / "box.ply")
    assert np.allclose(back.vertices, mesh.vertices, atol=1e-9)
    assert np.array_equal(back.faces, mesh.faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("ply\n", "plx\n"), "does not begin with a PLY header"),
        (("format ascii 1.0", "format fancy 1.0"), "format 'fancy'; expected ascii"),
        (("property float y", "property floot y"), "line 6: 'property floot y'"),
        (("property float y", "property float w"), "no property 'y'"),
        (("10 10 0 9", "10 ten 0 9"), "line 14: '10 ten 0 9'; expected numbers"),
        (("10 10 0 9", "10 10 0"), "line 14: 3 numbers; expected 4"),
        (("4 3 2 1 0", "5 3 2 1 0"), "line 17: 5 numbers; the lists' lengths want 6"),
        (("3 3 0 4\n", ""), "ends after 4 of 5 lines of element 'face'"),
        (("3 3 0 4", "3 3 0 9"), "names vertices [3, 0, 9]; there are 5"),
        (("5 5 8 9", "5 5 nan 9"), "vertex 4 is not finite"),
        (("element face 5", "element quad 5"), "no element 'face'"),
    ],
)
def test_damage_is_named(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = tmp_path / "damaged.ply"
    path.write_text(ASCII.replace(*change))
    with pytest.raises(DataError) as caught:
        read_ply(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_missing_and_a_cut_off_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.ply: no such file"):
        read_ply(tmp_path / "none.ply")
    whole = binary("<", [[0, 2, 1], [0, 1, 3]])
    path = tmp_path / "cut.ply"
    path.write_bytes(whole[:-20])
    with pytest.raises(DataError, match=r"cut\.ply: ends at byte"):
        read_ply(path)


def test_any_mutation_is_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = tmp_path / "mutated.ply"
    for whole in (ASCII.encode(), binary("<", [[0, 2, 1], [0, 1, 3]])):
        for trial in range(300):
            data = bytearray(whole)
            for at in rng.integers(0, len(data), 3):
                data[at] = rng.integers(0, 256)
            path.write_bytes(data)
            message = refusal(path)
            assert message is None or "mutated.ply" in message, f"trial {trial}"


def refusal(path: Path) -> str | None:
    try:
        read_ply(path)
    except DataError as error:
        return str(error)
    return None
