"""One reading of the image around some poses: each control point's hypotheses, and what they say of the poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.estimation.appearance import Memory, strangeness
from hierax.nodes.tracking.estimation.gamma_bias import contrasts
from hierax.nodes.tracking.estimation.profiles import (
    Controls,
    Image,
    Indices,
    Lines,
    Profiles,
    Singles,
    lines_of,
    read_profiles,
)
from hierax.nodes.tracking.math.batched import cross_rows
from hierax.nodes.tracking.math.geometry import Array, Floats

NEAREST_M = 0.02
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
    """One reading of the image, and where the poses stood."""

    lines: Lines
    profiles: Profiles
    strange: Singles
    owners: Indices
    points: Floats
    edges: Indices
    visible: Floats
    trust: Singles
    apart: Singles
    contrasts: Singles
    outlines: NDArray[np.bool_]


class Seen(NamedTuple):
    """Control points from the poses as they are: (n, 3) in the camera's frame; pixels moved along their normals."""

    points: Floats
    moved: Floats


def read_stage(
    image: Image, controls: Controls, poses: Floats, intrinsics: Array, memory: Memory, reach: int, search: Search
) -> Stage | None:
    lines = lines_of(controls, poses, intrinsics, image.shape)
    if not len(lines.rows):
        return None
    edges = controls.edges[lines.rows]
    profiles = read_profiles(image, lines, edges, reach, search.contrast)
    strange = strangeness(memory, controls, lines.rows, profiles)
    contrast = contrasts(profiles)
    profiles = profiles._replace(places=profiles.places + memory.factor[lines.rows, None] * contrast)
    owners = controls.owners[lines.rows]
    return Stage(
        lines,
        profiles,
        strange,
        owners,
        controls.points[lines.rows],
        edges,
        controls.visible[lines.rows],
        memory.trust[lines.rows],
        memory.apart[lines.rows],
        contrast,
        ~controls.creases[lines.rows],
    )


def seen_from(poses: Floats, stage: Stage, intrinsics: Array) -> Seen:
    rotations = poses[stage.owners, :3, :3]
    points = (rotations @ stage.points[:, :, None])[..., 0] + poses[stage.owners, :3, 3]
    flat = points[:, :2] / np.maximum(points[:, 2:], NEAREST_M)
    pixels = flat * intrinsics[:2] + intrinsics[2:]
    return Seen(points, np.einsum("nk,nk->n", pixels - stage.lines.pixels, stage.lines.normals))


def chosen_near(seen: Seen, stage: Stage, scale: Floats) -> tuple[Indices, Floats, Floats]:
    """Of each line the hypothesis that is near and not strange: column, residual, strangeness."""
    off = stage.profiles.places - seen.moved.astype(np.float32)[:, None]
    cost = off * off * (1.0 / (scale * scale)).astype(np.float32)[:, None] + np.float32(STRANGE_WEIGHT) * stage.strange
    columns = cost.argmin(axis=1)
    rows = np.arange(len(columns))
    return columns, -off[rows, columns].astype(np.float64), stage.strange[rows, columns].astype(np.float64)


def weights_of(
    stage: Stage, columns: Indices, residuals: Floats, strange: Floats, scale: Floats, search: Search
) -> Floats:
    """1/px² of each control point: Tukey's function of the distance, less where it may be hidden, where its
    hypothesis looks strange, and on edges blurred beside the others of its object.

    The blur of a shadow beside the foot of an object draws the peak away from the edge, all along it.
    """
    part = np.minimum(np.abs(residuals) / scale, 1.0)
    weights = (1.0 - part * part) ** 2 * stage.visible * np.exp(-STRANGE_WEIGHT * strange)
    weights *= stage.trust * stage.apart / search.noise_px**2
    near = weights > 1e-6
    if not near.any():
        return np.zeros_like(weights)
    sharp = stage.profiles.sharpness[np.arange(len(columns)), columns].astype(np.float64)
    count = np.bincount(stage.edges, weights=near)
    total = np.bincount(stage.edges, weights=np.where(near, sharp, 0.0))
    mean = (total / np.maximum(count, 1.0))[stage.edges]
    count_owners = int(stage.owners[-1]) + 1
    ends = np.searchsorted(stage.owners, np.arange(count_owners + 1))
    usual = np.ones(count_owners)
    for at in range(count_owners):
        view = slice(ends[at], ends[at + 1])
        values = np.sort(mean[view][near[view]])
        if len(values):
            usual[at] = values[int(_USUAL_SHARPNESS * (len(values) - 1))]
    relative = np.minimum(mean / np.maximum(usual[stage.owners], 1e-9), 1.0)
    blurred: Floats = np.where(near, weights * relative**search.blur_power, 0.0)
    return blurred


def normal_equations(
    poses: Floats,
    stage: Stage,
    seen: Seen,
    residuals: Floats,
    weights: Floats,
    used: NDArray[np.bool_],
    intrinsics: Array,
    further: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Of each object the (12, 12) matrix and the (12,) gradient over (camera, own) twists.

    With `further`, (n,) how one more unknown, common to all, moves residuals, (13, 13) and (13,).
    """
    owners = stage.owners[used]
    jacobian = _jacobian(poses, stage.points[used], owners, stage.lines.normals[used], seen.points[used], intrinsics)
    if further is not None:
        jacobian = np.concatenate((jacobian, further[used, None]), axis=1)
    unknowns = jacobian.shape[1]
    weighted = jacobian * weights[used, None]
    ends = np.searchsorted(owners, np.arange(len(poses) + 1))
    blocks = np.zeros((len(poses), unknowns, unknowns))
    gradients = np.zeros((len(poses), unknowns))
    count = len(poses)
    for at in range(count):
        view = slice(ends[at], ends[at + 1])
        blocks[at] = jacobian[view].T @ weighted[view]
        gradients[at] = weighted[view].T @ residuals[used][view]
    if len(owners):
        # How far an edge is off as a whole is one more unknown of each edge, solved for at once.
        starts = np.nonzero(np.diff(stage.edges[used], prepend=-1))[0]
        shared = np.add.reduceat(weighted, starts)
        own = np.add.reduceat(weights[used] * residuals[used], starts)
        spread = np.where(stage.outlines[used][starts], _OUTLINE_PX, _CREASE_PX)
        whole = np.add.reduceat(weights[used], starts) + 1.0 / spread**2
        edge_ends = np.searchsorted(owners[starts], np.arange(count + 1))
        scaled = shared / whole[:, None]
        for at in range(count):
            view = slice(edge_ends[at], edge_ends[at + 1])
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
    return np.concatenate((towards, cross_rows(seen, towards), turned, cross_rows(points, turned)), axis=1)
