"""The update of the arm as the paper prints it (theory, example 3): line segments, matched, and solvePnP.

Expected edges: the object's part of the depth image, its Laplacian, a Hough transform for the end points, and the depth
image for their depths. The Laplacian is that of the *inverse* depth: what a plane looks like in it is affine in the
pixel, so that it vanishes on the faces. Each expected edge is matched to the nearest line segment of the image that
runs alike, and its end points to where they fall on that; solvePnP gives the pose."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.math.batched import pixels_along
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, make_pose, project, rays, transform

_BEND = 2e-3  # laplacian of the inverse depth, relative to it, from which a pixel is on an edge
_VOTES = 12
_SHORTEST_PX = 8.0
_GAP_PX = 4.0
# Two lines that the Hough transform finds along one edge: nearer and more alike than this.
_SAME_PX = 3.0
_SAME_COSINE = 0.985

_DEPTH_PX = 3  # how far around an end point the surface that it lies on is looked for
_GATES_PX = (16.0, 10.0, 6.0, 4.0, 3.0)
_ALIKE_COSINE = 0.97
_LEAST_LINES = 3


class LineMatch(NamedTuple):
    """What the line segments of an image say of a pose."""

    pose: Floats  # camera_from_object, corrected
    # (6, 6) about the twist ξ in ``pose @ exp_se3(ξ)``, for end points that err by one pixel across their line,
    # independently
    information: Floats
    score: float  # 0 to 1: the share of the expected edges, by length, that a segment was matched to


def image_lines(image: Array) -> Floats:
    """The line segments of an image, uint8, (h, w) gray or (h, w, 3) RGB: end points (n, 2, 2) in pixels."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    found = cv2.createLineSegmentDetector().detect(gray)[0]
    lines = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(np.float64)
    return lines[_lengths(lines) >= _SHORTEST_PX]


def expected_lines(depth: Array, labels: Array, label: int, intrinsics: Array) -> Floats:
    """The visible edges of one object, by Laplacian and Hough transform, from depth (h, w) in metres, 0 where nothing
    is, and labels (h, w): end points (n, 2, 3) in the frame of the camera that these were rendered from, metres."""
    left, top, width, height = cv2.boundingRect((labels == label).view(np.uint8))
    if width == 0:
        return np.zeros((0, 2, 3))
    left, top = max(left - 1, 0), max(top - 1, 0)
    view = np.s_[top : top + height + 2, left : left + width + 2]
    near, mine = depth[view].astype(np.float64), labels[view] == label
    all_inverse = np.divide(1.0, near, out=np.zeros_like(near), where=near > 0.0)
    inverse = np.where(mine, all_inverse, 0.0)
    found = cv2.HoughLinesP(
        _edge_pixels(inverse, np.where(mine, 0.0, all_inverse)), 1.0, np.pi / 360.0, _VOTES, None, _SHORTEST_PX, _GAP_PX
    )
    if found is None:
        return np.zeros((0, 2, 3))
    lines = _distinct(found.reshape(-1, 2, 2).astype(np.float64))
    seen = _inverse_depths(lines.reshape(-1, 2), inverse).reshape(-1, 2)
    whole = (seen > 0.0).all(axis=1)
    return np.asarray(rays(lines[whole] + np.array([left, top]), intrinsics) / seen[whole][:, :, None])


def _edge_pixels(inverse: Floats, others: Floats) -> NDArray[np.uint8]:
    """Where the Laplacian of an object's inverse depth does not vanish: 255, else 0."""
    bend = np.abs(cv2.Laplacian(inverse, cv2.CV_64F, borderType=cv2.BORDER_REPLICATE))
    around = cv2.dilate(inverse, np.ones((3, 3)))
    edges = (bend > _BEND * around) & (around > 0.0)
    # Where something nearer hides the object, it has no edge.
    nearer = (others > 1.01 * around).view(np.uint8)
    edges &= cv2.dilate(nearer, np.ones((5, 5), dtype=np.uint8)) == 0
    return np.where(edges, 255, 0).astype(np.uint8)


def match_lines(lines: Floats, expected: Floats, predicted: Floats, intrinsics: Array) -> LineMatch | None:
    """Correct a predicted pose, camera_from_object, by line segments (n, 2, 2) of `image_lines` and the end points (m,
    2, 3) of the expected edges, object's frame, metres; None where too few of the edges are found."""
    pose = predicted
    matched = np.zeros(0, dtype=np.intp)
    for gate_px in _GATES_PX:
        edges = expected[transform(pose, expected)[..., 2].min(axis=1, initial=np.inf) > NEAREST_M]
        pixels = project(transform(pose, edges), intrinsics)
        matched = _matched(lines, pixels, gate_px)
        chosen = matched >= 0
        if chosen.sum() < _LEAST_LINES:
            return None
        feet = _feet(pixels[chosen], lines[matched[chosen]])
        solved = _solved(edges[chosen].reshape(-1, 3), feet.reshape(-1, 2), pose, intrinsics)
        if solved is None:
            return None
        pose = solved
    lengths = _lengths(pixels)
    return _judged(pose, edges[chosen], lines[matched[chosen]], lengths[chosen].sum() / lengths.sum(), intrinsics)


def _lengths(lines: Floats) -> Floats:
    return np.asarray(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1))


def _distinct(lines: Floats) -> Floats:
    """Without the shorter of those that lie on one another."""
    kept: list[Floats] = []
    for line in lines[np.argsort(-_lengths(lines), kind="stable")]:
        if not any(_covers(other, line) for other in kept):
            kept.append(line)
    return np.array(kept)


def _covers(longer: Floats, shorter: Floats) -> bool:
    along = (longer[1] - longer[0]) / np.hypot(*(longer[1] - longer[0]))
    direction = (shorter[1] - shorter[0]) / np.hypot(*(shorter[1] - shorter[0]))
    relative = shorter - longer[0]
    off = np.abs(relative @ np.array([-along[1], along[0]]))
    places = relative @ along
    length = np.hypot(*(longer[1] - longer[0]))
    beside = places.max() < -_SAME_PX or places.min() > length + _SAME_PX
    return bool(abs(along @ direction) > _SAME_COSINE and off.max() < _SAME_PX and not beside)


def _inverse_depths(pixels: Floats, inverse: Floats) -> Floats:
    """Of each pixel: the inverse depth of the object's nearest pixel, 0 where none is near."""
    height, width = inverse.shape
    steps = np.arange(-_DEPTH_PX, _DEPTH_PX + 1)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[np.argsort(np.sum(grid * grid, axis=1), kind="stable")]
    at = np.rint(pixels).astype(np.intp)[:, None] + grid[None]
    inside = ((at >= 0) & (at < (width, height))).all(axis=2)
    columns, rows = np.clip(at, 0, (width - 1, height - 1)).transpose(2, 0, 1)
    values = np.where(inside, inverse[rows, columns], 0.0)
    first = (values > 0.0).argmax(axis=1)
    return np.asarray(values[np.arange(len(values)), first])


def _matched(lines: Floats, pixels: Floats, gate_px: float) -> NDArray[np.intp]:
    """Of each expected edge (m, 2, 2) the line that runs alike beside it and is nearest; -1 for none."""
    if not len(lines) or not len(pixels):
        return np.full(len(pixels), -1, dtype=np.intp)
    along = (lines[:, 1] - lines[:, 0]) / _lengths(lines)[:, None]
    expected = pixels[:, 1] - pixels[:, 0]
    lengths = np.maximum(_lengths(pixels), 1e-9)
    expected = expected / lengths[:, None]
    alike = np.abs(expected @ along.T) > _ALIKE_COSINE
    # How far the edge's ends are from the line, and how much of the edge the segment runs beside.
    relative = pixels[:, :, None, :] - lines[None, None, :, 0, :]
    off = np.abs(relative[..., 0] * along[:, 1] - relative[..., 1] * along[:, 0])
    places = np.sum((lines[None, :, :, :] - pixels[:, None, :1, :]) * expected[:, None, None, :], axis=3)
    begin, end = places.min(axis=2), places.max(axis=2)
    beside = np.minimum(end, lengths[:, None]) - np.maximum(begin, 0.0)
    far = off.max(axis=1)
    good = alike & (far < gate_px) & (beside > 0.3 * lengths[:, None])
    # Of lines equally far away, the one that covers more of the edge.
    cost = np.where(good, far - 0.1 * gate_px * beside / lengths[:, None], np.inf)
    nearest = cost.argmin(axis=1)
    return np.where(np.isfinite(cost.min(axis=1)), nearest, -1)


def _feet(pixels: Floats, lines: Floats) -> Floats:
    """The points (m, 2, 2) on the lines that are nearest to the edges' end points."""
    along = (lines[:, 1] - lines[:, 0]) / _lengths(lines)[:, None]
    places = np.sum((pixels - lines[:, :1]) * along[:, None], axis=2)
    return np.asarray(lines[:, :1] + places[..., None] * along[:, None])


def _solved(points: Floats, pixels: Floats, pose: Floats, intrinsics: Array) -> Floats | None:
    start = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3].copy()
    lens = lens_matrix(intrinsics)
    found, turn, shift = cv2.solvePnP(points, pixels, lens, None, *start, True, cv2.SOLVEPNP_ITERATIVE)
    solved = make_pose(cv2.Rodrigues(turn)[0], np.ravel(shift))
    return solved if found and np.all(np.isfinite(solved)) else None


def _judged(pose: Floats, edges: Floats, lines: Floats, score: float, intrinsics: Array) -> LineMatch:
    points = edges.reshape(-1, 3)
    seen = transform(pose, points)
    along = np.repeat((lines[:, 1] - lines[:, 0]) / _lengths(lines)[:, None], 2, axis=0)
    normals = np.stack((-along[:, 1], along[:, 0]), axis=1)
    towards = pixels_along(normals, seen, intrinsics) @ pose[:3, :3]
    jacobian = np.concatenate((towards, np.cross(points, towards)), axis=1)
    return LineMatch(pose, jacobian.T @ jacobian, float(score))
