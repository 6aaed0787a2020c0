"""The visible edges of an object, with depth, from a segmented depth image (theory, example 3).

Two planar facets that meet do so in a line that their planes give exactly. Where a facet
ends before something farther away, the line is fitted to the cracks between its last
pixels and what is behind. Where something nearer hides the facet, no edge of it is to be
seen, and none is expected.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.controls import CREASE, OUTLINE
from hierax.nodes.tracking.facets import Facets, Patch, angle_between, facets_of, facing, patch_of, predicted
from hierax.nodes.tracking.geometry import Array, Floats, rays

cv2.setNumThreads(1)

_CREASE_RADIANS = 0.3
_CONTACT = 0.006
"""Two objects whose inverse depths differ by less than this share touch; the boundary is nobody's for sure."""

_GRAZING = 0.12
"""A facet seen at a smaller sine than this has too uncertain a depth where it ends."""

_SIDE_PX = 6.0
_POLYGON_PX = 1.2
_GAP_PX = 4.0
_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))


class Edges(NamedTuple):
    """Line segments on an object.

    Attributes:
        segments: (n, 2, 3) float64, end points in metres.
        kinds: (n,) uint8, `OUTLINE` (the object ends before something farther) or `CREASE`.
    """

    segments: Floats
    kinds: NDArray[np.uint8]


NO_EDGES = Edges(np.zeros((0, 2, 3)), np.zeros(0, dtype=np.uint8))


class _Cracks(NamedTuple):
    """Boundaries between a pixel of a facet and its neighbour: (n, 2) middle, facet, neighbour's facet, direction."""

    middles: Floats
    facets: NDArray[np.int32]
    others: NDArray[np.int32]
    upright: NDArray[np.bool_]


def visible_edges(depth: Array, labels: Array, label: int, intrinsics: Array) -> Edges:
    """The edges of one object that can be seen in a rendered scene.

    Args:
        depth: (h, w) metres along the camera's z, 0 where nothing is.
        labels: (h, w) uint8, which object is seen.
        label: the object.
        intrinsics: (4,) fx, fy, cx, cy in pixels.

    Returns:
        Segments in the frame of the camera that the image was rendered from.
    """
    patch = patch_of(depth, labels, label)
    if patch is None:
        return NO_EDGES
    facets = facets_of(patch)
    outline, crease = _classified(patch, facets)
    segments: list[Floats] = []
    kinds: list[int] = []
    for found in _crease_lines(crease, facets, intrinsics, patch):
        segments.append(found)
        kinds.append(CREASE)
    for found in _outline_lines(outline, facets, intrinsics, patch):
        segments.append(found)
        kinds.append(OUTLINE)
    if not segments:
        return NO_EDGES
    return Edges(np.stack(segments), np.array(kinds, dtype=np.uint8))


def _classified(patch: Patch, facets: Facets) -> tuple[_Cracks, _Cracks]:
    """All cracks that are edges of the object: where it ends before something farther, and where facets meet."""
    outlines, creases = [], []
    for dx, dy in _STEPS:
        here, there = _pairs(facets.numbers.shape, dx, dy)
        numbers, others = facets.numbers[here], facets.numbers[there]
        rows, columns = np.nonzero((numbers > 0) & (numbers != others))
        own, other = numbers[rows, columns], others[rows, columns]
        w_here = patch.inverse[here][rows, columns]
        w_there = patch.inverse[there][rows, columns]
        label = patch.labels[there][rows, columns]
        start = np.stack((columns + max(-dx, 0), rows + max(-dy, 0)), axis=1).astype(np.float64)
        middles = start + np.array([0.5 * dx, 0.5 * dy])
        expected = predicted(facets, own, middles, w_here)
        met = predicted(facets, np.maximum(other, 1), middles, w_there)
        behind = np.where(other > 0, met, w_there)
        touching = other > 0
        touching[touching] = _close(facets, own[touching], other[touching], expected[touching], behind[touching])
        farther = (label == 0) | (behind < expected * (1.0 - np.where(other > 0, 0.0, _CONTACT)))
        upright = np.full(len(own), dx != 0)
        outlines.append(_pick(farther & ~touching, middles, own, other, upright))
        creases.append(_pick(touching & (own < other), middles, own, other, upright))
    return _joined(outlines), _joined(creases)


def _close(
    facets: Facets, own: NDArray[np.int32], other: NDArray[np.int32], first: Floats, second: Floats
) -> NDArray[np.bool_]:
    """Whether two facets of the object meet within a pixel of where their depths are given."""
    planar = (own <= len(facets.planes)) & (other <= len(facets.planes))
    slope = np.full(len(own), np.inf)
    one, two = facets.planes[own[planar] - 1], facets.planes[other[planar] - 1]
    slope[planar] = np.linalg.norm(one[:, :2] - two[:, :2], axis=1)
    tolerance = np.where(planar, slope, 0.02 * first)
    return np.asarray(np.abs(first - second) <= tolerance)


def _pairs(shape: tuple[int, ...], dx: int, dy: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of all pixels that have a neighbour at the step, and of the neighbours."""
    height, width = shape
    here = np.s_[max(-dy, 0) : height - max(dy, 0), max(-dx, 0) : width - max(dx, 0)]
    there = np.s_[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
    return here, there


def _pick(
    chosen: NDArray[np.bool_],
    middles: Floats,
    own: NDArray[np.int32],
    other: NDArray[np.int32],
    upright: NDArray[np.bool_],
) -> _Cracks:
    return _Cracks(middles[chosen], own[chosen], other[chosen], upright[chosen])


def _joined(parts: list[_Cracks]) -> _Cracks:
    return _Cracks(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _crease_lines(cracks: _Cracks, facets: Facets, intrinsics: Array, patch: Patch) -> list[Floats]:
    """Segments where two planar facets meet, on the planes' intersection."""
    found: list[Floats] = []
    count = len(facets.planes)
    keys = cracks.facets * (count + 2) + cracks.others
    for key in np.unique(keys):
        first, second = divmod(int(key), count + 2)
        if second > count or angle_between(facets.planes[[first - 1, second - 1]], intrinsics, patch) < _CREASE_RADIANS:
            continue
        plane = facets.planes[first - 1]
        difference = plane - facets.planes[second - 1]
        slope = float(np.linalg.norm(difference[:2]))
        normal, offset = difference[:2] / slope, difference[2] / slope
        points = cracks.middles[keys == key]
        found += [_lifted(ends, plane, intrinsics, patch) for ends in _runs(points, normal, -offset)]
    return found


def _outline_lines(cracks: _Cracks, facets: Facets, intrinsics: Array, patch: Patch) -> list[Floats]:
    """Segments where a facet ends before something farther away."""
    found: list[Floats] = []
    for number in np.unique(cracks.facets):
        chosen = cracks.facets == number
        middles, upright = cracks.middles[chosen], cracks.upright[chosen]
        planar = number <= len(facets.planes)
        if planar and facing(facets.planes[number - 1], middles, intrinsics, patch) < _GRAZING:
            continue
        for start, end in _sides((facets.numbers == number).view(np.uint8)):
            line = _fitted(start, end, middles, upright)
            if line is None:
                continue
            normal, offset, points = line
            for ends in _runs(points, normal, offset):
                plane = facets.planes[number - 1] if planar else _plane_beside(ends, patch, facets.numbers == number)
                found.append(_lifted(ends, plane, intrinsics, patch))
    return found


def _sides(mask: NDArray[np.uint8]) -> list[tuple[Floats, Floats]]:
    """The sides of the polygons around a facet, in pixels; short ones fall away."""
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    sides = []
    for contour in contours:
        corners = cv2.approxPolyDP(contour, _POLYGON_PX, True)[:, 0, :].astype(np.float64)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if np.hypot(*(end - start)) >= _SIDE_PX:
                sides.append((start, end))
    return sides


def _fitted(
    start: Floats, end: Floats, middles: Floats, upright: NDArray[np.bool_]
) -> tuple[Floats, float, Floats] | None:
    """The line (normal, offset) through the cracks along a polygon's side, and those cracks.

    Of a line nearer to the vertical each row gives one crack, of any other each column:
    those are spread evenly by half a pixel around it, the others are not.
    """
    along = (end - start) / np.hypot(*(end - start))
    steep = abs(along[1]) > abs(along[0])
    across = np.array([-along[1], along[0]])
    relative = middles - start
    place = relative @ along
    length = float((end - start) @ along)
    near = (np.abs(relative @ across) < 2.0) & (place > 0.5) & (place < length - 0.5) & (upright == steep)
    points = middles[near]
    for _ in range(2):
        if len(points) < 4:
            return None
        free, bound = (points[:, 1], points[:, 0]) if steep else (points[:, 0], points[:, 1])
        centre = free.mean()
        spread = free - centre
        slope = float(spread @ bound) / max(float(spread @ spread), 1e-9)
        level = bound.mean()
        points = points[np.abs(level + slope * spread - bound) < 0.8]
    normal = np.array([1.0, -slope]) if steep else np.array([-slope, 1.0])
    normal /= np.hypot(1.0, slope)
    anchor = np.array([level, centre]) if steep else np.array([centre, level])
    return normal, float(normal @ anchor), points


def _runs(points: Floats, normal: Floats, offset: float) -> list[Floats]:
    """End points (2, 2) on the line normal·x = offset of the stretches that points lie along."""
    along = np.array([-normal[1], normal[0]])
    near = np.abs(points @ normal - offset) < 1.5
    places = np.sort(points[near] @ along)
    runs = []
    for part in np.split(places, 1 + np.nonzero(np.diff(places) > _GAP_PX)[0]):
        if len(part) and part[-1] - part[0] >= _SIDE_PX - 1.0:
            ends = np.array([part[0], part[-1]])
            runs.append(offset * normal + ends[:, None] * along)
    return runs


def _plane_beside(ends: Floats, patch: Patch, where: NDArray[np.bool_]) -> Floats:
    """A stand-in for the plane of a curved surface: inverse depth along a line on its border, level across it."""
    places = np.linspace(ends[0], ends[1], 12)
    rows, columns = np.nonzero(where)
    distance = (columns - places[:, :1]) ** 2 + (rows - places[:, 1:]) ** 2
    nearest = distance.argmin(axis=1)
    values = patch.inverse[rows[nearest], columns[nearest]]
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    slope, level = np.polyfit((places - ends[0]) @ along, values, 1)
    return np.array([slope * along[0], slope * along[1], level - slope * (along @ ends[0])])


def _lifted(ends: Floats, plane: Floats, intrinsics: Array, patch: Patch) -> Floats:
    """End points in the camera's frame, on a facet's plane."""
    inverse = ends @ plane[:2] + plane[2]
    lifted: Floats = rays(ends + patch.corner, intrinsics) / inverse[:, None]
    return lifted
