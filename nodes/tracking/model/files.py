"""Files of triangle meshes: PLY, as BOP datasets hold them, OBJ, STL and glTF."""

import json
import re
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.files import DataError, read_file
from hierax.nodes.tracking.math.geometry import Floats, transform
from hierax.nodes.tracking.model.mesh import Mesh, triangulated

BOP_UNIT_M = 0.001  # BOP models are in millimetres
GLTF_UNIT_M = 1.0

# Of a mesh, and of everything else in its file: two frames of a scene with so many take 5 s and 0.5 GB.
MAX_FACES = 200_000

_MAX_DIGITS = 9
_FARTHEST_M = 100.0
# Twice a face's area, in squares of the mesh's extent: one with less is a line or a point, and left out.
_LEAST_AREA = 1e-14
_STL_HEAD, _STL_FACE = 84, 50  # bytes of a binary file's head, which ends with how many triangles follow, and of each
_FACE_LISTS = ("vertex_indices", "vertex_index")


def read_mesh(path: Path, unit_m: float = BOP_UNIT_M) -> Mesh:
    """A mesh from a PLY, OBJ, STL or glTF file; polygons are cut into triangles, vertices stay as they are. The unit of
    length, in metres, is not that of glTF, where it is 1. Raises DataError: the file is missing or damaged; it names
    file, element or vertex, and what was expected."""
    kind = path.suffix.lower()
    if kind not in _READERS:
        raise DataError(f"{path}: expected a model that ends in {', '.join(_READERS)}")
    name = f"a {kind[1:].upper()} model"
    data = read_file(path, name)
    try:
        with np.errstate(all="ignore"):  # what is not finite is told behind
            vertices, faces = _READERS[kind](path, data)
    except DataError:
        raise
    except Exception as error:  # the libraries raise whatever they meet
        raise DataError(f"{path}: {str(error) or type(error).__name__:.200}; expected {name}") from error
    return _checked(path, vertices * (GLTF_UNIT_M if kind in _GLTF else unit_m), faces)


def write_ply(path: Path, mesh: Mesh, unit_m: float = BOP_UNIT_M) -> None:
    """Write a mesh (metres) as an ascii PLY file, in a unit of so many metres; its folder must exist."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{part:.9g}" for part in vertex) for vertex in mesh.vertices / unit_m]
    lines += ["3 " + " ".join(str(int(index)) for index in face) for face in mesh.faces]
    path.write_text("\n".join(lines) + "\n")


def _read_ply(path: Path, data: bytes) -> tuple[Floats, NDArray[np.int32]]:
    from plyfile import PlyData, PlyListProperty  # simulated worlds read no files

    header = data[: data.find(b"end_header")]
    for name, count in re.findall(rb"^\s*element\s+(\S+)\s+(\d+)", header, re.MULTILINE):
        if len(count) > _MAX_DIGITS or int(count) > MAX_FACES:
            told = f"{path}: element {name.decode('ascii', 'replace')!r:.40}: {count.decode():.40}"
            raise DataError(f"{told}; expected at most {MAX_FACES} of an element")
    content = PlyData.read(BytesIO(data))
    found = {element.name: {item.name: item for item in element.properties} for element in content.elements}
    for element in ("vertex", "face"):
        if element not in found:
            raise DataError(f"{path}: no element {element!r}; expected a mesh with vertices and faces")
    missing = [axis for axis in "xyz" if axis not in found["vertex"]]
    if missing:
        raise DataError(f"{path}: element 'vertex' has no property {missing[0]!r}, only {', '.join(found['vertex'])}")
    listed = next((found["face"][name] for name in _FACE_LISTS if name in found["face"]), None)
    if not isinstance(listed, PlyListProperty) or "f" in listed.len_dtype + listed.val_dtype:
        raise DataError(f"{path}: element 'face': {_FACE_LISTS[0]}: expected lists of whole numbers")
    vertices = np.stack([content["vertex"][axis].astype(np.float64) for axis in "xyz"], axis=1)
    return vertices, triangulated([face.tolist() for face in content["face"][listed.name]])


def _read_scene(path: Path, data: bytes) -> tuple[Floats, NDArray[np.int32]]:
    import trimesh  # which takes a while

    kind = path.suffix[1:].lower()
    beside: Any = _Beside(path)
    scene = trimesh.load_scene(BytesIO(data), kind, beside, process=False, maintain_order=True, skip_materials=True)
    vertices: list[Floats] = []
    faces: list[NDArray[Any]] = []
    for node in scene.graph.nodes_geometry:
        placed, name = scene.graph[node]
        part = scene.geometry[name]
        if isinstance(part, trimesh.Trimesh):
            faces.append(np.asarray(part.faces) + sum(map(len, vertices)))
            vertices.append(transform(placed, np.asarray(part.vertices, dtype=np.float64)))
        if sum(map(len, faces)) > MAX_FACES:
            raise DataError(f"{path}: expected at most {MAX_FACES} triangles")
    return np.concatenate([np.zeros((0, 3)), *vertices]), triangulated(np.concatenate([np.zeros((0, 3), int), *faces]))


def _read_gltf(path: Path, data: bytes) -> tuple[Floats, NDArray[np.int32]]:
    binary = data.startswith(b"glTF")
    # What an accessor without a buffer has is zeros, as many as it says.
    head = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")] if binary else data)
    for at, accessor in enumerate(head.get("accessors", ())):
        if not 0 <= accessor["count"] <= 3 * MAX_FACES:
            raise DataError(f"{path}: accessors[{at}].count: expected at most {3 * MAX_FACES}")
    return _read_scene(path, data)


def _read_obj(path: Path, data: bytes) -> tuple[Floats, NDArray[np.int32]]:
    vertices, named = 0, (0, 0)
    for number, line in enumerate(data.splitlines(), start=1):
        kind, *words = line.split() or [b""]
        if kind == b"v":
            _three_numbers(path, number, words[:3])
            vertices += 1
        elif kind == b"f":
            corners = [int(each) for each in _three_numbers(path, number, [word.partition(b"/")[0] for word in words])]
            if 0 in corners or min(corners) < -vertices:
                what = f"names vertex {0 if 0 in corners else min(corners)}; expected them numbered from 1 on"
                raise DataError(f"{path}: line {number}: {what}, or backwards from -1")
            named = max(named, (max(corners), number))
    if named[0] > vertices:
        raise DataError(f"{path}: line {named[1]}: names vertex {named[0]}; there are {vertices}")
    return _read_scene(path, data)


def _three_numbers(path: Path, line: int, words: Sequence[bytes]) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) < 3:
        told = b" ".join(words).decode("utf-8", "replace")
        raise DataError(f"{path}: line {line}: {told!r:.60}; expected 3 numbers at least")
    return found


def _read_stl(path: Path, data: bytes) -> tuple[Floats, NDArray[np.int32]]:
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:2048].lower():
        if b"endsolid" not in data[-2048:].lower():
            raise DataError(f"{path}: ends before its last line; expected 'endsolid' there")
        return _read_scene(path, data)
    count = int.from_bytes(data[80:84], "little")
    if len(data) < _STL_HEAD or len(data) < _STL_HEAD + _STL_FACE * count:
        expected = f"expected a binary STL model of {count} triangles, {_STL_HEAD + _STL_FACE * count} bytes"
        raise DataError(f"{path}: has {len(data)} bytes; {expected}")
    return _read_scene(path, data)


class _Beside:
    """Files that a model's file names, bounded as that is."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __getitem__(self, name: str) -> bytes:
        if Path(name).name != name:
            raise DataError(f"{self._path}: names {name!r:.80}; expected a file beside it")
        return read_file(self._path.with_name(name), f"a part of {self._path.name}")

    get = __getitem__


_GLTF = (".glb", ".gltf")
_READERS: dict[str, Callable[[Path, bytes], tuple[Floats, NDArray[np.int32]]]] = {
    ".ply": _read_ply,
    ".obj": _read_obj,
    ".stl": _read_stl,
    **dict.fromkeys(_GLTF, _read_gltf),
}
SUFFIXES = tuple(_READERS)


def _checked(path: Path, vertices: Floats, faces: NDArray[np.int32]) -> Mesh:
    if not len(faces):
        raise DataError(f"{path}: no faces; expected a mesh of triangles")
    if len(faces) > MAX_FACES:
        raise DataError(f"{path}: {len(faces)} triangles; expected at most {MAX_FACES}")
    if not np.all(np.isfinite(vertices)):
        row = int(np.argmin(np.all(np.isfinite(vertices), axis=1)))
        raise DataError(f"{path}: vertex {row} is not finite")
    wrong = (faces < 0) | (faces >= len(vertices))
    if wrong.any():
        row = int(np.argmax(wrong.any(axis=1)))
        raise DataError(f"{path}: triangle {row} names vertices {faces[row].tolist()}; there are {len(vertices)}")
    farthest = float(np.abs(vertices).max())
    if farthest > _FARTHEST_M:
        raise DataError(f"{path}: a vertex is {farthest:.3g} m from the origin; expected at most {_FARTHEST_M:g} m")
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    extent = float(np.ptp(vertices, axis=0).max())
    has_area = areas > _LEAST_AREA * extent**2
    if not has_area.any():
        raise DataError(f"{path}: no face has an area; expected a mesh of triangles")
    used, numbers = np.unique(faces[has_area], return_inverse=True)
    if len(used) == len(vertices) and has_area.all():
        return Mesh(vertices, faces)
    # What no face uses is no part of the body: it rests on nothing, and weighs nothing.
    return Mesh(vertices[used], numbers.reshape(-1, 3).astype(np.int32))
