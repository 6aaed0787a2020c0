"""One reading of the image around some poses: each control point's hypotheses, and what they say of the poses."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking.estimation.appearance import Memory, strangeness
from hierax.nodes.tracking.estimation.gamma_bias import contrasts
from hierax.nodes.tracking.estimation.profiles import Image, Lines, Profiles, Singles, lines_of, read_profiles
from hierax.nodes.tracking.math.batched import only, pixels_of, placed, tukey
from hierax.nodes.tracking.math.geometry import NEAREST_M, Array, Floats, cross
from hierax.nodes.tracking.model.controls import CREASE, Controls, Indices

STRANGE_WEIGHT = 0.5
_USUAL_SHARPNESS = 0.7  # quantile of the control points' sharpness that counts as an edge in focus

# Standard deviations of how far an edge is off as a whole: the shadow at an object's foot, light, blur and the model's
# own error move it, alike along the edge and from image to image.
_OUTLINE_PX = 0.2
_CREASE_PX = 0.1


class Search(NamedTuple):
    """How the image is searched."""

    reach_px: tuple[int, ...] = (14, 6)  # how far along the normal, one entry a stage
    # where Tukey's weight ends in the first and the last iteration of each stage
    scale_px: tuple[tuple[float, float], ...] = ((14.0, 4.0), (5.0, 1.0))
    iterations: int = 6  # Gauss-Newton steps in a stage
    # least and largest end of Tukey's weight in the steps that follow the last stage
    fine_px: tuple[float, float] = (0.3, 1.0)
    fine_iterations: int = 4  # how many those are
    contrast: float = 1.5  # smallest slope that counts as an edge, grey levels per pixel
    # what a control point's residual is worth; neighbours on an edge err alike, and from image to image, so this is
    # more than one of them errs
    noise_px: float = 1.5
    blur_power: float = 4.0  # how strongly blurred peaks lose weight
    support_px: float = 1.5  # how near a hypothesis must be in the end to support a control point


class Stage(NamedTuple):
    """One reading of the image, and what is known of the control points that it shows."""

    lines: Lines
    profiles: Profiles
    strange: Singles  # (n, k) how strange each peak looks
    contrasts: Singles  # (n, k) of `gamma_bias.contrasts`
    numbers: Indices  # (n,) of the edges, different for different objects
    controls: Controls  # of the lines
    memory: Memory  # beside them


class Seen(NamedTuple):
    """Control points from the poses as they are: (n, 3) in the camera's frame; pixels moved along their normals."""

    points: Floats
    moved: Floats


class Matches(NamedTuple):
    """Of each line: the column of its hypothesis, its residual (inf where none), and how strange it looks."""

    columns: Indices
    pixels: Floats
    strange: Floats


def read_stage(
    image: Image, controls: Controls, poses: Floats, intrinsics: Array, memory: Memory, reach: int, search: Search
) -> Stage | None:
    lines = lines_of(controls, poses, intrinsics, image.shape)
    if not len(lines.rows):
        return None
    numbers, memory = controls.numbers[lines.rows], only(memory, lines.rows)
    profiles = read_profiles(image, lines, numbers, reach, search.contrast)
    strange, contrast = strangeness(memory, profiles), contrasts(profiles)
    profiles = profiles._replace(places=profiles.places + memory.factor[:, None] * contrast)
    return Stage(lines, profiles, strange, contrast, numbers, only(controls, lines.rows), memory)


def seen_from(poses: Floats, controls: Controls, lines: Lines, intrinsics: Array) -> Seen:
    points = placed(poses, controls.owners, controls.points)
    return Seen(points, np.einsum("nk,nk->n", pixels_of(points, intrinsics) - lines.pixels, lines.normals))


def chosen_near(seen: Seen, stage: Stage, scale: Floats | float) -> Matches:
    """Of each line the hypothesis that is near, as `scale` (pixels) has it, and not strange."""
    off = stage.profiles.places - seen.moved.astype(np.float32)[:, None]
    scales = np.broadcast_to(scale, seen.moved.shape)
    cost = off * off * (1.0 / (scales * scales)).astype(np.float32)[:, None]
    columns = (cost + np.float32(STRANGE_WEIGHT) * stage.strange).argmin(axis=1)
    rows = np.arange(len(columns))
    return Matches(columns, -off[rows, columns].astype(np.float64), stage.strange[rows, columns].astype(np.float64))


def weights_of(stage: Stage, matches: Matches, scale: Floats | float, search: Search) -> Floats:
    """1/px² of each control point: Tukey's function of the distance, less where it may be hidden, where its
    hypothesis looks strange, and on edges blurred beside the others of its object.

    The blur of a shadow beside the foot of an object draws the peak away from the edge, all along it.
    """
    weights = tukey(matches.pixels, scale) * stage.controls.visible * np.exp(-STRANGE_WEIGHT * matches.strange)
    weights *= stage.memory.trust * stage.memory.apart / search.noise_px**2
    near = weights > 1e-6
    if not near.any():
        return np.zeros_like(weights)
    owners = stage.controls.owners
    sharp = stage.profiles.sharpness[np.arange(len(near)), matches.columns].astype(np.float64)
    count = np.bincount(stage.numbers, weights=near)
    total = np.bincount(stage.numbers, weights=np.where(near, sharp, 0.0))
    mean = (total / np.maximum(count, 1.0))[stage.numbers]
    usual = np.ones(int(owners[-1]) + 1)
    for at, view in enumerate(views_of(owners, len(usual))):
        values = np.sort(mean[view][near[view]])
        if len(values):
            usual[at] = values[int(_USUAL_SHARPNESS * (len(values) - 1))]
    relative = np.minimum(mean / np.maximum(usual[owners], 1e-9), 1.0)
    blurred: Floats = np.where(near, weights * relative**search.blur_power, 0.0)
    return blurred


def views_of(owners: Indices, count: int) -> list[slice]:
    """Where each of so many owners' part is in what is sorted by owner."""
    ends = np.searchsorted(owners, np.arange(count + 1)).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def normal_equations(
    poses: Floats,
    stage: Stage,
    seen: Seen,
    residuals: Floats,
    weights: Floats,
    intrinsics: Array,
    further: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Of each object the (12, 12) matrix and the (12,) gradient over (camera, own) twists.

    With `further`, (n,) how one more unknown, common to all, moves residuals, (13, 13) and (13,).
    """
    used, count = weights > 0, len(poses)
    points, owners = stage.controls.points[used], stage.controls.owners[used]
    jacobian = _jacobian(poses, points, owners, stage.lines.normals[used], seen.points[used], intrinsics)
    if further is not None:
        jacobian = np.concatenate((jacobian, further[used, None]), axis=1)
    weighted = jacobian * weights[used, None]
    blocks, gradients = np.zeros((count, *jacobian.shape[1:] * 2)), np.zeros((count, jacobian.shape[1]))
    for at, view in enumerate(views_of(owners, count)):
        blocks[at] = jacobian[view].T @ weighted[view]
        gradients[at] = weighted[view].T @ residuals[used][view]
    if len(owners):
        # How far an edge is off as a whole is one more unknown of each edge, solved for at once.
        starts = np.nonzero(np.diff(stage.numbers[used], prepend=-1))[0]
        shared = np.add.reduceat(weighted, starts)
        own = np.add.reduceat(weights[used] * residuals[used], starts)
        spread = np.where(stage.controls.kinds[used][starts] == CREASE, _CREASE_PX, _OUTLINE_PX)
        whole = np.add.reduceat(weights[used], starts) + 1.0 / spread**2
        scaled = shared / whole[:, None]
        for at, view in enumerate(views_of(owners[starts], count)):
            blocks[at] -= shared[view].T @ scaled[view]
            gradients[at] -= scaled[view].T @ own[view]
    return blocks, gradients


def _jacobian(
    poses: Floats, points: Floats, owners: Indices, normals: Floats, seen: Floats, intrinsics: Array
) -> Floats:
    """(n, 12): how a twist of the camera's frame, and one of the object's, move each point along its normal."""
    inverse = 1.0 / np.maximum(seen[:, 2], NEAREST_M)
    across, down = normals[:, 0] * intrinsics[0] * inverse, normals[:, 1] * intrinsics[1] * inverse
    ahead = -(across * seen[:, 0] + down * seen[:, 1]) * inverse
    towards = np.stack((across, down, ahead), axis=1)
    turned = (towards[:, None, :] @ poses[owners, :3, :3])[:, 0]
    return np.concatenate((towards, cross(seen, towards), turned, cross(points, turned)), axis=1)
