"""Correcting a pose so that its expected edges lie on edges of the image.

Control points are spread along the expected edges. At each one the image is read along the
edge's normal, and every peak of the gradient is kept as a hypothesis. Gauss-Newton on SE(3)
then moves the pose: in each iteration every control point takes the hypothesis nearest to
where the pose now puts it, weighted by Tukey's function; the predicted pose is a prior,
weighted by its uncertainty. The image is read anew in each stage, nearer and more strictly.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.geometry import Array, Floats, exp_se3, invert, log_se3, project, transform

cv2.setNumThreads(1)

Image = NDArray[np.float32]

_SPACING_PX = 4.0
_MARGIN_PX = 3.0
_POINTS_MAX = 400
_SEGMENT_POINTS_MAX = 60
_NEAREST_M = 0.02
_LEAST_INFORMATION = 0.01
"""Share of the prior that is counted as seen, so that what no edge shows stays finite."""

_LEAST_RARITY = 0.4
"""Where edges are so dense that more than the rest of the places are near one, to be near one proves little."""

_SHIFT_PX = 2
_VOTE_PX = 5
_REACH_FACTOR = 3
"""Halves of how far a shift along both axes can move a control point along its normal: a little over √2."""

_USUAL_SHARPNESS = 0.7
"""Quantile of the control points' sharpness that counts as an edge in focus."""


class Search(NamedTuple):
    """How the image is searched.

    Attributes:
        reach_px: how far along the normal, one entry a stage.
        scale_px: where Tukey's weight ends in the first and the last iteration of each stage.
        iterations: Gauss-Newton steps in a stage.
        contrast: smallest slope that counts as an edge, grey levels per pixel.
        noise_px: what a control point's residual is worth; neighbours on an edge err alike,
            so this is more than one of them errs.
        blur_power: how strongly blurred peaks lose weight.
        support_px: how near a hypothesis must be in the end to support a control point.
    """

    reach_px: tuple[int, ...] = (14, 8, 4)
    scale_px: tuple[tuple[float, float], ...] = ((14.0, 8.0), (8.0, 3.0), (3.0, 0.7))
    iterations: int = 6
    contrast: float = 2.0
    noise_px: float = 1.5
    support_px: float = 1.5
    blur_power: float = 4.0


NEAR = Search()
"""How an image is searched for an object that is about where it was expected."""


class Match(NamedTuple):
    """What the image says of a pose.

    Attributes:
        pose: camera_from_object, corrected.
        information: (6, 6) about the twist ξ in ``pose @ exp_se3(ξ)`` that the image alone gives, for control points
            that err by one pixel independently.
        score: 0 to 1: the share of control points that the image supports, beyond chance.
        residual_px: root mean square of the supported control points.
        points: (n, 3) the control points, object's frame.
        supported: (n,) which of them the image supports.
    """

    pose: Floats
    information: Floats
    score: float
    residual_px: float
    points: Floats
    supported: NDArray[np.bool_]


class Controls(NamedTuple):
    """Control points on an object.

    Attributes:
        points: (n, 2, 3) each point and one a little further along its edge, object's frame, metres.
        owners: (n,) which edge each is on.
    """

    points: Floats
    owners: NDArray[np.intp]


class _Lines(NamedTuple):
    """Control points seen from one pose: pixels (n, 2), normals (n, 2), points (n, 3) in the object's frame, edges."""

    pixels: Floats
    normals: Floats
    points: Floats
    owners: NDArray[np.intp]


class _Peaks(NamedTuple):
    """Extremes of the gradient along the normals.

    Attributes:
        places: (n, m) pixels along the normal, inf where there is none.
        sharpness: (n, m) curvature over height, 1/px²: what a blurred step has more of than a shadow.
    """

    places: Floats
    sharpness: Floats


class _Residuals(NamedTuple):
    """Of each control point: pixels from its nearest hypothesis (inf where none), that one's sharpness, the point
    in the camera's frame."""

    pixels: Floats
    sharpness: Floats
    seen: Floats


def smoothed(image: Array) -> Image:
    """The image that `match` searches: float32 (h, w, channels), lightly smoothed.

    Args:
        image: uint8, (h, w) gray or (h, w, 3) RGB.
    """
    soft = np.asarray(cv2.GaussianBlur(image.astype(np.float32), (5, 5), 0.9), dtype=np.float32)
    return soft[:, :, None] if soft.ndim == 2 else soft


def match(
    image: Image,
    segments: Floats,
    predicted: Floats,
    covariance: Floats,
    intrinsics: Array,
    search: Search = NEAR,
) -> Match | None:
    """Correct a predicted pose.

    Args:
        image: of `smoothed`.
        segments: (n, 2, 3) end points of the expected edges in the object's frame, metres.
        predicted: camera_from_object.
        covariance: (6, 6) of the prediction's error, twist in the object's frame.
        intrinsics: (4,) fx, fy, cx, cy in pixels.
        search: how.

    Returns:
        The corrected pose; None where too few of the edges are in the image.
    """
    prior = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    pose = predicted
    controls = control_points(segments, predicted, intrinsics)
    for reach, scales in zip(search.reach_px, search.scale_px, strict=True):
        lines = _lines(controls, pose, intrinsics, image.shape)
        if lines is None:
            return None
        peaks = _peaks(image, lines, reach, search.contrast)
        for scale in np.linspace(*scales, search.iterations):
            pose = _step(pose, predicted, prior, lines, peaks, float(scale), intrinsics, search)
    return _judged(image, pose, prior, controls, intrinsics, search)


def shifted(image: Image, segments: Floats, pose: Floats, intrinsics: Array, reach_px: int = 40) -> Floats:
    """A pose moved parallel to the image to where most of its edges are found: a start for `match`.

    Each control point votes for the shifts that bring it onto an edge, whichever way the
    edge is along itself (a Hough transform over the shift).

    Args:
        image, segments, intrinsics: as for `match`.
        pose: camera_from_object.
        reach_px: the largest shift, each way.

    Returns:
        camera_from_object; the same pose where too few of the edges are in the image.
    """
    lines = _lines(control_points(segments, pose, intrinsics), pose, intrinsics, image.shape)
    if lines is None:
        return pose
    peaks = np.isfinite(_peaks(image, lines, _REACH_FACTOR * reach_px // 2, NEAR.contrast).places)
    # A vote reaches a little to both sides; many peaks along a normal say little, so they share one vote.
    spread = cv2.blur(peaks.astype(np.float32), (_VOTE_PX, 1), borderType=cv2.BORDER_CONSTANT) > 0
    votes = spread / (1.0 + spread.sum(axis=1, keepdims=True))
    steps = np.arange(-reach_px, reach_px + 1, _SHIFT_PX)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    along = np.rint(lines.normals @ grid.T).astype(np.intp) + peaks.shape[1] // 2
    total = votes[np.arange(len(votes))[:, None], along].sum(axis=0)
    # Of equals, the smallest shift.
    best = grid[int(np.argmax(total - 1e-6 * np.linalg.norm(grid, axis=1)))]
    depth = float(transform(pose, lines.points)[:, 2].mean())
    moved: Floats = pose.copy()
    moved[:2, 3] += best * depth / intrinsics[:2]
    return moved


def control_points(segments: Floats, pose: Floats, intrinsics: Array) -> Controls:
    """Points along segments, evenly spaced as the pose shows them."""
    ends = transform(pose, segments)
    seen = ends[:, :, 2].min(axis=1) > _NEAREST_M
    if not seen.any():
        return Controls(np.zeros((0, 2, 3)), np.zeros(0, dtype=np.intp))
    segments = segments[seen]
    pixels = project(ends[seen], intrinsics)
    lengths = np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=1)
    spacing = max(_SPACING_PX, float(lengths.sum()) / _POINTS_MAX)
    counts = np.clip(((lengths - 2.0 * _MARGIN_PX) / spacing).astype(int) + 1, 0, _SEGMENT_POINTS_MAX)
    counts[lengths < 2.0 * _MARGIN_PX] = 0
    owner = np.repeat(np.arange(len(segments)), counts)
    order = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    margin = _MARGIN_PX / np.maximum(lengths, 1.0)
    share = margin[owner] + (1.0 - 2.0 * margin[owner]) * (order + 0.5) / np.maximum(counts[owner], 1)
    step = (segments[:, 1] - segments[:, 0])[owner]
    start = segments[owner, 0] + share[:, None] * step
    return Controls(np.stack((start, start + 0.02 * step), axis=1), owner)


def _lines(controls: Controls, pose: Floats, intrinsics: Array, shape: tuple[int, ...]) -> _Lines | None:
    seen = transform(pose, controls.points)
    ahead = seen[:, :, 2].min(axis=1) > _NEAREST_M if len(seen) else np.zeros(0, dtype=bool)
    pixels = project(seen[ahead], intrinsics)
    along = pixels[:, 1] - pixels[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    high, wide = shape[:2]
    first = pixels[:, 0]
    inside = (first > _MARGIN_PX).all(axis=1) & (first < (wide - _MARGIN_PX, high - _MARGIN_PX)).all(axis=1)
    inside &= lengths > 1e-6
    if inside.sum() < 6:
        return None
    along = along[inside] / lengths[inside, None]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=1)
    return _Lines(first[inside], normals, controls.points[ahead][inside, 0], controls.owners[ahead][inside])


def _peaks(image: Image, lines: _Lines, reach: int, contrast: float) -> _Peaks:
    """All extremes of the gradient along the normals, to `reach` pixels on both sides."""
    offsets = np.arange(-reach - 2, reach + 3, dtype=np.float64)
    where = lines.pixels[:, None, :] + offsets[None, :, None] * lines.normals[:, None, :]
    grid = where.astype(np.float32)
    values = cv2.remap(image, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = values.reshape(*grid.shape[:2], -1)
    slope = 0.5 * (values[:, 2:] - values[:, :-2]).astype(np.float64)
    size = np.sqrt(np.einsum("pkc,pkc->pk", slope, slope))
    # Neighbours on the other flank of a thin line slope the other way: they do not shape this peak.
    agree = np.einsum("pkc,pkc->pk", slope[:, 1:], slope[:, :-1]) > 0
    middle = size[:, 1:-1]
    before = np.where(agree[:, :-1], size[:, :-2], 0.0)
    after = np.where(agree[:, 1:], size[:, 2:], 0.0)
    top = (middle > contrast) & (middle >= before) & (middle > after)
    bend = np.where(top, 2.0 * middle - before - after, 1.0)
    shift = 0.5 * (after - before) / bend
    places = np.where(top, offsets[2:-2] + np.clip(shift, -0.5, 0.5), np.inf)
    return _Peaks(places, np.where(top, bend / np.maximum(middle, contrast), 0.0))


def _residuals(pose: Floats, lines: _Lines, peaks: _Peaks, intrinsics: Array) -> _Residuals:
    """Where each point is along its normal, less its nearest hypothesis."""
    seen = transform(pose, lines.points)
    moved = np.sum((project(seen, intrinsics) - lines.pixels) * lines.normals, axis=1)
    nearest = np.abs(peaks.places - moved[:, None]).argmin(axis=1)
    rows = np.arange(len(nearest))
    return _Residuals(moved - peaks.places[rows, nearest], peaks.sharpness[rows, nearest], seen)


def _step(
    pose: Floats,
    predicted: Floats,
    prior: Floats,
    lines: _Lines,
    peaks: _Peaks,
    scale: float,
    intrinsics: Array,
    search: Search,
) -> Floats:
    """One Gauss-Newton step."""
    residuals = _residuals(pose, lines, peaks, intrinsics)
    weights = _weights(residuals, lines.owners, scale, search)
    used = weights > 0
    jacobian = _jacobian(pose, lines.points[used], lines.normals[used], residuals.seen[used], intrinsics)
    weighted = jacobian * weights[used, None]
    off = log_se3(invert(predicted) @ pose)
    information = jacobian.T @ weighted + prior
    gradient = weighted.T @ residuals.pixels[used] + prior @ off
    return pose @ exp_se3(-np.linalg.solve(information, gradient))


def _weights(residuals: _Residuals, owners: NDArray[np.intp], scale: float, search: Search) -> Floats:
    """1/px² of each control point: Tukey's function of the distance, less on edges blurred beside the others.

    The blur of a shadow beside the foot of an object draws the peak away from the edge, all along it.
    """
    weights = _tukey(residuals.pixels, scale) / search.noise_px**2
    near = weights > 0
    if not near.any():
        return weights
    count = np.bincount(owners, weights=near)
    total = np.bincount(owners, weights=np.where(near, residuals.sharpness, 0.0))
    sharpness = (total / np.maximum(count, 1.0))[owners]
    usual = float(np.quantile(sharpness[near], _USUAL_SHARPNESS))
    relative = np.minimum(sharpness / max(usual, 1e-9), 1.0)
    blurred: Floats = weights * relative**search.blur_power
    return blurred


def _tukey(residuals: Floats, scale: float) -> Floats:
    part = np.minimum(np.abs(residuals) / scale, 1.0)
    weights: Floats = (1.0 - part * part) ** 2
    return weights


def _jacobian(pose: Floats, points: Floats, normals: Floats, seen: Floats, intrinsics: Array) -> Floats:
    """(n, 6): how a twist in the object's frame moves each point along its normal, pixels per metre and radian."""
    fx, fy = float(intrinsics[0]), float(intrinsics[1])
    inverse = 1.0 / seen[:, 2]
    across, down = normals[:, 0] * fx * inverse, normals[:, 1] * fy * inverse
    ahead = -(across * seen[:, 0] + down * seen[:, 1]) * inverse
    towards = np.stack((across, down, ahead), axis=1) @ pose[:3, :3]
    return np.concatenate((towards, np.cross(points, towards)), axis=1)


def _judged(
    image: Image, pose: Floats, prior: Floats, controls: Controls, intrinsics: Array, search: Search
) -> Match | None:
    """The pose with its covariance and its score."""
    lines = _lines(controls, pose, intrinsics, image.shape)
    if lines is None:
        return None
    reach = search.reach_px[-1]
    peaks = _peaks(image, lines, 2 * reach, search.contrast)
    residuals = _residuals(pose, lines, peaks, intrinsics)
    supported = np.abs(residuals.pixels) < search.support_px
    share = float(supported.mean())
    # By chance: the share of places along the normals that are as near to a peak.
    places = np.arange(-2.0 * reach, 2.0 * reach + 1.0)
    nearest = np.abs(peaks.places[:, None, :] - places[None, :, None]).min(axis=2)
    chance = float((nearest < search.support_px).mean())
    score = max(0.0, (share - chance) / max(1.0 - chance, _LEAST_RARITY))
    jacobian = _jacobian(pose, lines.points[supported], lines.normals[supported], residuals.seen[supported], intrinsics)
    information = jacobian.T @ jacobian + _LEAST_INFORMATION * prior
    squares = residuals.pixels[supported] ** 2
    residual = float(np.sqrt(squares.mean())) if len(squares) else float("inf")
    return Match(pose, information, score, residual, lines.points, supported)
