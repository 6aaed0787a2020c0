"""CAO and VRML files of meshes, as the data sets of model-based trackers hold them: their polygons in metres."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.mesh import Mesh

_WELD_M = 1e-6
_LEAST_AREA_M2 = 1e-8
_DEEPEST = 8
_CAO_SECTIONS = ("points", "lines", "faces from lines", "faces from points", "cylinders", "circles")
_LOAD = re.compile(r'load\(\s*"([^"]+)"\s*(\)?)')
_SECTIONS = 64  # corners of what is round
_VRML_SHAPE = re.compile(r"\bIndexedFaceSet\b(.*?)coordIndex\s*\[(.*?)\]", re.DOTALL)
_VRML_POINTS = re.compile(r"\bpoint\s*\[(.*?)\]", re.DOTALL)


def read_cao(path: Path) -> Mesh:
    """The faces from points, cylinders and circles of a CAO model, and of those that it loads.

    A cylinder is closed at its ends; a circle that is one of these is there once.

    Raises:
        DataError: a file is missing or damaged, has lines or faces from lines, or moves what it loads.
    """
    return mesh_of(path, _cao_polygons(path, _DEEPEST))


def read_vrml(path: Path) -> Mesh:
    """The face sets of a VRML 2.0 file in which nothing that is to be seen is moved by a Transform.

    Raises:
        DataError: the file is missing or damaged, or has moved parts.
    """
    text = re.sub(r"#[^\n]*", "", _text(path))
    if _has_moved_shape(text):
        raise DataError(f"{path}: a shape within a Transform; expected shapes at their places")
    polygons: list[Floats] = []
    for number, (head, indices) in enumerate(_VRML_SHAPE.findall(text), start=1):
        where = f"{path}: face set {number}"
        found = _VRML_POINTS.search(head)
        if found is None:
            raise DataError(f"{where}: no points")
        numbers = _numbers(f"{where}: points", found[1], float)
        if len(numbers) % 3:
            raise DataError(f"{where}: {len(numbers)} coordinates; expected three for each point")
        points = np.array(numbers).reshape(-1, 3)
        polygons += [_chosen(where, points, face) for face in _split(_numbers(f"{where}: indices", indices, int))]
    return mesh_of(path, polygons)


def mesh_of(path: Path, polygons: Sequence[Floats]) -> Mesh:
    """The mesh of plane polygons, each (n, 3); corners at one place are made one.

    Args:
        path: where they come from, for errors.
        polygons: convex or not; those without area are left out.

    Raises:
        DataError: there is none.
    """
    whole = [polygon for polygon in polygons if np.linalg.norm(_area(polygon)) > _LEAST_AREA_M2]
    if not whole:
        raise DataError(f"{path}: no faces")
    corners = np.concatenate(whole)
    keys = np.rint(corners / _WELD_M).astype(np.int64)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces: list[tuple[int, int, int]] = []
    start = 0
    for polygon in whole:
        own = number.ravel()[start : start + len(polygon)]
        faces += [(int(own[a]), int(own[b]), int(own[c])) for a, b, c in cut(polygon)]
        start += len(polygon)
    return Mesh(corners[first], np.array(faces, dtype=np.int32))


def cut(polygon: Floats) -> list[tuple[int, int, int]]:
    """Triangles of a plane polygon (n, 3) that may have inward corners, of the same turning sense: ear by ear."""
    normal = _area(polygon)
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, drop, axis=1)
    # Dropping the y axis mirrors the plane, and so does looking from behind.
    if (normal[drop] < 0) != (drop == 1):
        flat = flat * np.array([1.0, -1.0])
    left = list(range(len(polygon)))
    triangles = []
    while len(left) > 3:
        at = next((at for at in range(len(left)) if _is_ear(flat, left, at)), 0)
        triangles.append((left[at - 1], left[at], left[(at + 1) % len(left)]))
        del left[at]
    triangles.append((left[0], left[1], left[2]))
    return [item for item in triangles if abs(_twice_area(*flat[list(item)])) > _LEAST_AREA_M2]


def _cao_polygons(path: Path, depth: int) -> list[Floats]:
    if depth == 0:
        raise DataError(f"{path}: loaded from too deep; expected at most {_DEEPEST} files in one another")
    rows, polygons = [], []
    for line in _text(path).splitlines():
        bare = line.split("#")[0].strip()
        if loaded := _LOAD.match(bare):
            if not loaded[2]:
                raise DataError(f"{path}: {bare!r:.80}; expected what is loaded at its place")
            polygons += _cao_polygons(path.parent / loaded[1], depth - 1)
        elif bare:
            rows.append(bare.split())
    if not rows or rows[0] != ["V1"]:
        raise DataError(f"{path}: expected a CAO model that begins with V1")
    taken = iter(rows[1:])
    try:
        points = [[float(part) for part in row[:3]] for row in _section(taken)]
        others = {name: len(_section(taken)) for name in _CAO_SECTIONS[1:3]}
        faces = [[int(part) for part in row[1 : 1 + int(row[0])]] for row in _section(taken)]
        cylinders = [(int(row[0]), int(row[1]), float(row[2])) for row in _section(taken, optional=True)]
        circles = [(float(row[0]), *(int(part) for part in row[1:4])) for row in _section(taken, optional=True)]
        corners = np.array(points, dtype=np.float64).reshape(-1, 3)
    except (ValueError, IndexError, StopIteration) as error:
        raise DataError(f"{path}: expected the sections {', '.join(_CAO_SECTIONS)}, each after its length") from error
    unknown = [name for name, count in others.items() if count]
    if unknown:
        raise DataError(f"{path}: {unknown[0]}; expected a model of points, faces from them, cylinders and circles")
    polygons += [_chosen(f"{path}: face {at}", corners, face) for at, face in enumerate(faces)]
    ends: list[tuple[Floats, float]] = []
    for at, (first, last, radius) in enumerate(cylinders):
        low, high = _chosen(f"{path}: cylinder {at}", corners, [first, last], 2)
        polygons += cylinder_polygons(low, high, radius)
        ends += [(low, radius), (high, radius)]
    for at, (radius, *three) in enumerate(circles):
        centre, one, other = _chosen(f"{path}: circle {at}", corners, three)
        if not any(np.allclose(centre, end) and np.isclose(radius, wide) for end, wide in ends):
            polygons.append(ring(centre, np.cross(one - centre, other - centre), radius))
    return polygons


def cylinder_polygons(low: Floats, high: Floats, radius_m: float) -> list[Floats]:
    """The sides and both ends of a cylinder between two points of its axis, seen from outside."""
    below = ring(low, high - low, radius_m)
    above = below + (high - low)
    after = np.roll(np.arange(_SECTIONS), -1)
    sides = [np.stack((below[at], below[to], above[to], above[at])) for at, to in enumerate(after)]
    return [*sides, below[::-1], above]


def ring(centre: Floats, axis: Floats, radius_m: float) -> Floats:
    """Corners (n, 3) on a circle, counter-clockwise seen against its axis."""
    axis = axis / np.linalg.norm(axis)
    right = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    right /= np.linalg.norm(right)
    turns = 2.0 * np.pi * np.arange(_SECTIONS) / _SECTIONS
    corners: Floats = centre + radius_m * (
        np.cos(turns)[:, None] * right + np.sin(turns)[:, None] * np.cross(axis, right)
    )
    return corners


def _section(rows: Iterator[list[str]], optional: bool = False) -> list[list[str]]:
    """The rows of the next section, which begins with their number."""
    head = next(rows, None)
    if head is None:
        if optional:
            return []
        raise ValueError("the file ends")
    return [next(rows) for _ in range(int(head[0]))]


def _chosen(where: str, points: Floats, face: Sequence[int], least: int = 3) -> Floats:
    if len(face) < least or not all(0 <= at < len(points) for at in face):
        raise DataError(f"{where}: names points {list(face)}; expected {least} or more of {len(points)}")
    return points[list(face)]


def _has_moved_shape(text: str) -> bool:
    """Whether a geometry stands within the braces of a Transform."""
    for found in re.finditer(r"\bTransform\s*\{", text):
        depth, at = 1, found.end()
        while depth and at < len(text):
            depth += {"{": 1, "}": -1}.get(text[at], 0)
            at += 1
        if re.search(r"\bgeometry\b", text[found.end() : at]):
            return True
    return False


def _numbers(where: str, text: str, kind: type[float] | type[int]) -> list[float]:
    try:
        return [kind(part) for part in text.replace(",", " ").split()]
    except ValueError as error:
        raise DataError(f"{where}: expected numbers") from error


def _split(indices: Sequence[float]) -> list[list[int]]:
    """Faces from indices with -1 behind each."""
    faces: list[list[int]] = [[]]
    for index in indices:
        if index < 0:
            faces.append([])
        else:
            faces[-1].append(int(index))
    return [face for face in faces if face]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}; expected a model") from error


def _area(polygon: Floats) -> Floats:
    """Normal vector of a plane polygon, as long as its area."""
    following = np.roll(polygon, -1, axis=0)
    area: Floats = 0.5 * np.cross(polygon - polygon[0], following - polygon[0]).sum(axis=0)
    return area


def _is_ear(flat: Floats, left: Sequence[int], at: int) -> bool:
    before, tip, after = (flat[left[(at + step) % len(left)]] for step in (-1, 0, 1))
    if _twice_area(before, tip, after) <= 0.0:
        return False
    ends = {left[at - 1], left[at], left[(at + 1) % len(left)]}
    return not any(_is_inside(flat[other], before, tip, after) for other in left if other not in ends)


def _is_inside(point: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    return all(_twice_area(first, second, point) > 0.0 for first, second in ((a, b), (b, c), (c, a)))


def _twice_area(a: Floats, b: Floats, c: Floats) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
