"""PLY files of triangle meshes, as BOP datasets hold them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.errors import DataError
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.bounded_files import read_file
from hierax.nodes.tracking.model.mesh import Mesh, triangulated

BOP_UNIT_M = 0.001  # BOP models are in millimetres

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
# Of a mesh, and of everything else in its file: two frames of a scene with so many take 5 s and 0.5 GB.
MAX_FACES = 200_000

_MAX_DIGITS = 9
_FARTHEST_M = 100.0
# Twice a face's area, in squares of the mesh's extent: one with less is a line or a point, and left out.
_LEAST_AREA = 1e-14

_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_FACE_LISTS = ("vertex_indices", "vertex_index")


class _Property(NamedTuple):
    name: str
    kind: str
    count_kind: str | None


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


class _Header(NamedTuple):
    format: str
    elements: list[_Element]
    lines: int
    size: int


def read_ply(path: Path, unit_m: float = BOP_UNIT_M) -> Mesh:
    """A mesh from a PLY file: ascii, or binary of either byte order; polygons are cut into triangles.

    Args:
        path: the file; unit_m: the file's unit of length in metres.

    Raises:
        DataError: the file is missing or damaged; it names file, line or element, and what was expected.
    """
    data = read_file(path, "a PLY model")
    header = _read_header(path, data)
    rows = _AsciiRows(path, data, header) if header.format == "ascii" else _BinaryRows(path, data, header)
    vertices: Floats | None = None
    polygons: list[Any] | NDArray[Any] | None = None
    for element in header.elements:
        if element.name == "vertex":
            vertices = rows.scalars(element, ("x", "y", "z")) * unit_m
        elif element.name == "face":
            polygons = rows.lists(element, _FACE_LISTS)
        else:
            rows.skip(element)
    if vertices is None or polygons is None:
        missing = "vertex" if vertices is None else "face"
        raise DataError(f"{path}: no element '{missing}'; expected a mesh with vertices and faces")
    return _checked(path, vertices, triangulated(polygons))


def write_ply(path: Path, mesh: Mesh, unit_m: float = BOP_UNIT_M) -> None:
    """Write a mesh as an ascii PLY file.

    Args:
        path: the file; its folder must exist.
        mesh: in metres; unit_m: the file's unit of length in metres.
    """
    lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{part:.9g}" for part in vertex) for vertex in mesh.vertices / unit_m]
    lines += ["3 " + " ".join(str(int(index)) for index in face) for face in mesh.faces]
    path.write_text("\n".join(lines) + "\n")


def _read_header(path: Path, data: bytes) -> _Header:
    end = data.find(b"end_header")
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise DataError(f"{path}: does not begin with a PLY header ('ply' … 'end_header')")
    lines = data[:end].decode("ascii", "replace").splitlines()
    kind = ""
    elements: list[_Element] = []
    for number, line in enumerate(lines[1:], start=2):
        where = f"{path}, line {number}"
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            kind = words[1]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            if len(words[2]) > _MAX_DIGITS or int(words[2]) > MAX_FACES:
                raise DataError(f"{where}: {line.strip()!r:.60}; expected at most {MAX_FACES} of an element")
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_read_property(where, words))
        else:
            raise DataError(f"{where}: {line.strip()!r} is no PLY header line")
    if kind != "ascii" and kind not in _ORDERS:
        raise DataError(f"{path}: format {kind or 'not given'!r}; expected ascii or {' or '.join(_ORDERS)}")
    return _Header(kind, elements, len(lines) + 1, newline + 1)


def _read_property(where: str, words: list[str]) -> _Property:
    if len(words) == 3 and words[1] in _TYPES:
        return _Property(words[2], _TYPES[words[1]], None)
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        return _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    raise DataError(f"{where}: {' '.join(words)!r}; expected 'property TYPE NAME' or 'property list TYPE TYPE NAME'")


class _AsciiRows:
    """The elements of an ascii file, read one after the other."""

    def __init__(self, path: Path, data: bytes, header: _Header) -> None:
        self._path = path
        self._lines = data[header.size :].decode("ascii", "replace").splitlines()
        self._first_line = header.lines + 1
        self._next = 0

    def scalars(self, element: _Element, names: Sequence[str]) -> Floats:
        columns = _columns(self._path, element, names)
        rows = self._numbers(element)
        result = np.empty((element.rows, len(names)))
        for index, row in enumerate(rows):
            if len(row) != len(element.properties):
                raise DataError(f"{self._where(index)}: {len(row)} numbers; expected {len(element.properties)}")
            result[index] = [row[column] for column in columns]
        self._next += element.rows
        return result

    def lists(self, element: _Element, names: Sequence[str]) -> list[Any]:
        wanted = _list_column(self._path, element, names)
        result = []
        for index, row in enumerate(self._numbers(element)):
            result.append(self._list(index, row, element, wanted))
        self._next += element.rows
        return result

    def skip(self, element: _Element) -> None:
        self._next += element.rows

    def _list(self, index: int, row: list[float], element: _Element, wanted: int) -> list[int]:
        at = 0
        found: list[int] = []
        for column, item in enumerate(element.properties):
            if item.count_kind is None:
                at += 1
                continue
            numbers = [row[at]] if at < len(row) else [0.0]
            length = int(numbers[0]) if _are_whole(numbers) and numbers[0] >= 0 else -1
            if column == wanted and length >= 0:
                numbers += row[at + 1 : at + 1 + length]
                found = [int(part) for part in numbers[1:]] if _are_whole(numbers) else []
            if length < 0 or not _are_whole(numbers):
                raise DataError(f"{self._where(index)}: list '{item.name}': expected whole numbers, its length first")
            at += 1 + length
        if at != len(row):
            raise DataError(f"{self._where(index)}: {len(row)} numbers; the lists' lengths want {at}")
        return found

    def _numbers(self, element: _Element) -> list[list[float]]:
        lines = self._lines[self._next : self._next + element.rows]
        if len(lines) < element.rows:
            raise DataError(
                f"{self._path}: ends after {len(lines)} of {element.rows} lines of element '{element.name}'"
            )
        return [self._parsed(index, line) for index, line in enumerate(lines)]

    def _parsed(self, index: int, line: str) -> list[float]:
        try:
            return [float(word) for word in line.split()]
        except ValueError as error:
            raise DataError(f"{self._where(index)}: {line[:60]!r}; expected numbers") from error

    def _where(self, index: int) -> str:
        return f"{self._path}, line {self._first_line + self._next + index}"


class _BinaryRows:
    """The elements of a binary file, read one after the other."""

    def __init__(self, path: Path, data: bytes, header: _Header) -> None:
        self._path = path
        self._data = data
        self._at = header.size
        self._order = _ORDERS[header.format]

    def scalars(self, element: _Element, names: Sequence[str]) -> Floats:
        columns = _columns(self._path, element, names)
        rows = self._records(element)
        return np.stack([rows[f"p{column}"].astype(np.float64) for column in columns], axis=1)

    def lists(self, element: _Element, names: Sequence[str]) -> list[Any] | NDArray[Any]:
        wanted = _list_column(self._path, element, names)
        triangles = self._triangles(element, wanted)
        return self._walk(element, wanted) if triangles is None else triangles

    def skip(self, element: _Element) -> None:
        if any(item.count_kind is not None for item in element.properties):
            self._walk(element, -1)
        else:
            self._records(element)

    def _records(self, element: _Element) -> NDArray[Any]:
        if any(item.count_kind is not None for item in element.properties):
            raise DataError(f"{self._path}: element '{element.name}' has a list; expected single numbers")
        if not element.properties:
            raise DataError(f"{self._path}: element '{element.name}' has no properties")
        dtype = np.dtype([(f"p{at}", self._order + item.kind) for at, item in enumerate(element.properties)])
        return self._take(element, dtype)

    def _triangles(self, element: _Element, wanted: int) -> NDArray[Any] | None:
        """The usual case at once: the one list is of three in every face. None where it is not."""
        fields: list[tuple[Any, ...]] = []
        for at, item in enumerate(element.properties):
            if item.count_kind is not None and at != wanted:
                return None
            if item.count_kind is not None:
                fields.append(("count", self._order + item.count_kind))
                fields.append(("list", self._order + item.kind, (3,)))
            else:
                fields.append((f"p{at}", self._order + item.kind))
        dtype = np.dtype(fields)
        if self._at + element.rows * dtype.itemsize > len(self._data):
            return None
        rows = np.frombuffer(self._data, dtype, count=element.rows, offset=self._at)
        if not np.all(rows["count"] == 3):
            return None
        self._at += element.rows * dtype.itemsize
        return rows["list"].astype(np.int64)

    def _walk(self, element: _Element, wanted: int) -> list[Any]:
        result = []
        for _ in range(element.rows):
            found: list[int] = []
            for at, item in enumerate(element.properties):
                length = 1
                if item.count_kind is not None:
                    count = float(self._take(element, np.dtype(self._order + item.count_kind), 1)[0])
                    if not _are_whole([count]) or count < 0:
                        raise DataError(f"{self._path}: list '{item.name}': its length is {count:g}")
                    length = int(count)
                values = self._take(element, np.dtype(self._order + item.kind), length)
                if at == wanted:
                    found = [int(part) for part in values]
            result.append(found)
        return result

    def _take(self, element: _Element, dtype: np.dtype[Any], count: int | None = None) -> NDArray[Any]:
        count = element.rows if count is None else count
        end = self._at + count * dtype.itemsize
        if count < 0 or end > len(self._data):
            raise DataError(
                f"{self._path}: ends at byte {len(self._data)} within element '{element.name}' "
                f"({element.rows} of it are announced)"
            )
        rows = np.frombuffer(self._data, dtype, count=count, offset=self._at)
        self._at = end
        return rows


def _columns(path: Path, element: _Element, names: Sequence[str]) -> list[int]:
    known = [item.name for item in element.properties]
    missing = [name for name in names if name not in known]
    if missing:
        raise DataError(f"{path}: element '{element.name}' has no property '{missing[0]}', only {', '.join(known)}")
    return [known.index(name) for name in names]


def _list_column(path: Path, element: _Element, names: Sequence[str]) -> int:
    for at, item in enumerate(element.properties):
        if item.name in names and item.count_kind is not None:
            if "f" in item.kind + item.count_kind:
                raise DataError(f"{path}: list '{item.name}' of element '{element.name}': expected whole numbers")
            return at
    raise DataError(f"{path}: element '{element.name}' has no list property '{names[0]}'")


def _are_whole(numbers: Sequence[float]) -> bool:
    return all(abs(number) < _WHOLE_BOUND and float(number).is_integer() for number in numbers)


_WHOLE_BOUND = 2.0**31


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
    return Mesh(vertices, faces if has_area.all() else faces[has_area])
