"""Files of meshes: all formats, and errors that say where."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.model.files import read_mesh, write_ply
from hierax.nodes.tracking.model.mesh import box_mesh

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
    mesh = read_mesh(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0], [0.005, 0.005, 0.008]]
    assert mesh.faces.tolist() == [[3, 2, 1], [3, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("faces", [[[0, 2, 1], [0, 1, 3]], [[0, 2, 1, 3], [0, 1, 3]]])
def test_binary_of_both_orders(tmp_path: Path, order: str, faces: list[list[int]]) -> None:
    path = tmp_path / "b.ply"
    path.write_bytes(binary(order, faces))
    mesh = read_mesh(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    expected = [[0, 2, 1], [0, 1, 3]] if len(faces[0]) == 3 else [[0, 2, 1], [0, 1, 3], [0, 1, 3]]
    assert mesh.faces.tolist() == expected


def test_what_is_written_is_read(tmp_path: Path) -> None:
    mesh = box_mesh((0.03, 0.05, 0.07))
    write_ply(tmp_path / "box.ply", mesh)
    back = read_mesh(tmp_path / "box.ply")
    assert np.allclose(back.vertices, mesh.vertices, atol=1e-9)
    assert np.array_equal(back.faces, mesh.faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("ply\n", "plx\n"), "line 1: expected 'ply'; expected a PLY model"),
        (("format ascii 1.0", "format fancy 1.0"), "line 2: don't understand format 'fancy'"),
        (("property float y", "property floot y"), "line 6: field type 'floot' not in"),
        (("property float y", "property float w"), "no property 'y'"),
        (("10 10 0 9", "10 ten 0 9"), "element 'vertex': row 2: property 'y': malformed input"),
        (("10 10 0 9", "10 10 0"), "element 'vertex': row 2: property 'red': early end-of-line"),
        (("4 3 2 1 0", "5 3 2 1 0"), "element 'face': row 0: property 'vertex_indices': early end-of-line"),
        (("3 3 0 4\n", ""), "element 'face': row 4: early end-of-file"),
        (("3 3 0 4", "3 3 0 9"), "names vertices [3, 0, 9]; there are 5"),
        (("5 5 8 9", "5 5 nan 9"), "vertex 4 is not finite"),
        (("element face 5", "element quad 5"), "no element 'face'"),
    ],
)
def test_damage_is_named(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = tmp_path / "damaged.ply"
    path.write_text(ASCII.replace(*change))
    with pytest.raises(DataError) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_missing_and_a_cut_off_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.ply: no such file"):
        read_mesh(tmp_path / "none.ply")
    whole = binary("<", [[0, 2, 1], [0, 1, 3]])
    path = tmp_path / "cut.ply"
    path.write_bytes(whole[:-20])
    with pytest.raises(DataError, match=r"cut\.ply: element 'face': row 1: property 'vertex_index': early end-of-file"):
        read_mesh(path)


def test_any_mutation_is_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = tmp_path / "mutated.ply"
    for whole in (ASCII.encode(), binary("<", [[0, 2, 1], [0, 1, 3]])):
        check_mutations(path, whole, rng, 300)


def check_mutations(path: Path, whole: bytes, rng: np.random.Generator, times: int) -> None:
    """A file with some bytes changed is read, or refused by its name."""
    for trial in range(times):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data)
        message = refusal(path)
        assert message is None or path.name in message, f"trial {trial}"


def refusal(path: Path) -> str | None:
    try:
        read_mesh(path)
    except DataError as error:
        return str(error)
    return None


CORNERS = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]]
SIDES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


def obj() -> bytes:
    lines = ["mtllib nothing.mtl", *("v " + " ".join(f"{1000 * part:g}" for part in corner) for corner in CORNERS)]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in SIDES)]).encode()


def stl(ascii_text: bool) -> bytes:
    triangles = [[[1000 * part for part in CORNERS[at]] for at in side] for side in SIDES]
    if not ascii_text:
        packed = [struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles]
        return bytes(80) + struct.pack("<I", len(packed)) + b"".join(packed)
    loops = [
        "facet normal 0 0 0 outer loop " + " ".join(f"\nvertex {x} {y} {z}\n" for x, y, z in triangle)
        for triangle in triangles
    ]
    return f"solid a\n{' endloop endfacet '.join(loops)} endloop endfacet\nendsolid a\n".encode()


def gltf(buffer: dict[str, object] | None = None, count: int = 12) -> tuple[dict[str, object], bytes]:
    """A tetrahedron under a node that moves it by a metre along x; its JSON and its buffer."""
    data = struct.pack("<12f", *np.ravel(CORNERS)) + struct.pack("<12H", *np.ravel(SIDES))
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}]
    ends = {"min": [0, 0, 0], "max": [0.01, 0.02, 0.03]}
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [1.0, 0.0, 0.0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", **ends},
            {"bufferView": 1, "componentType": 5123, "count": count, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": 72, **(buffer or {})}],
    }, data


def glb(count: int = 12) -> bytes:
    tree, data = gltf(count=count)
    head = json.dumps(tree).encode()
    head += b" " * (-len(head) % 4)
    chunks = struct.pack("<II", len(head), 0x4E4F534A) + head + struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


@pytest.mark.parametrize(
    ("name", "data", "moved"),
    [("a.obj", obj(), 0), ("a.stl", stl(True), 0), ("b.STL", stl(False), 0), ("a.glb", glb(), 1)],
)
def test_other_formats(tmp_path: Path, name: str, data: bytes, moved: float) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    mesh = read_mesh(path)
    wanted = np.array(CORNERS)[np.array(SIDES)] + [moved, 0.0, 0.0]
    assert mesh.vertices[mesh.faces] == pytest.approx(wanted, abs=1e-7)


def test_a_file_beside_a_gltf_is_read_and_none_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "in" / "a.gltf"
    path.parent.mkdir()
    tree, data = gltf({"uri": "a.bin"})
    path.write_text(json.dumps(tree))
    with pytest.raises(DataError, match=r"a\.bin: no such file; expected a part of a\.gltf"):
        read_mesh(path)
    (path.parent / "a.bin").write_bytes(data)
    assert read_mesh(path).vertices == pytest.approx(np.array(CORNERS) + np.array([1.0, 0.0, 0.0]), abs=1e-7)
    (tmp_path / "a.bin").write_bytes(data)
    path.write_text(json.dumps(gltf({"uri": "../a.bin"})[0]))
    with pytest.raises(DataError, match=r"names '\.\./a\.bin'; expected a file beside it"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "a.obj: line 4: names vertex 9; there are 3"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4: names vertex 0; expected them numbered from 1 on"),
        ("a.obj", b"v 0 0 0\nf -1 -2 -1\n", "line 2: names vertex -2; expected"),
        ("a.obj", b"v 0 0\n", "a.obj: line 1: '0 0'; expected 3 numbers at least"),
        ("a.obj", b"v 0 0 x\n", "a.obj: line 1: '0 0 x'; expected 3 numbers at least"),
        ("a.obj", b"v 0 0 0\nf 1/1 1/1\n", "line 2: '1 1'; expected 3 numbers at least"),
        ("a.obj", b"", "no faces"),
        ("a.stl", stl(False)[:-7], "expected a binary STL model of 4 triangles, 284 bytes"),
        ("a.stl", stl(True)[:-20], "ends before its last line; expected 'endsolid' there"),
        ("a.stl", b"<html>no such page</html>", "has 25 bytes; expected a binary STL model of 0 triangles"),
        ("a.glb", glb(count=10**9), "accessors[1].count: expected at most 600000"),
        ("a.gltf", b"[1]", "expected a GLTF model"),
        ("a.fbx", b"", "expected a model that ends in .ply, .obj, .stl, .glb, .gltf"),
    ],
)
def test_what_is_wrong_in_other_formats_is_told(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(DataError) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_any_mutation_of_other_formats_is_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    for name, whole in (("m.obj", obj()), ("m.stl", stl(True)), ("n.stl", stl(False)), ("m.glb", glb())):
        check_mutations(tmp_path / name, whole, rng, 60)
