"""What the hypotheses of one reading of the image say of the poses: from points to weighted normal equations.

Every step of the alignment comes through here, with some hundred control points at most: what it costs is how often
numpy is called, not the numbers. So points are columns, what stays the same within a stage is there already, and of few
poses each has its turn."""

from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.stages import Search, Stage
from hierax.nodes.tracking.math.batched import placed, summed, tukey
from hierax.nodes.tracking.math.geometry import NEAREST_M, Floats
from hierax.nodes.tracking.model.controls import Indices


class Seen(NamedTuple):
    """Control points from the poses as they are."""

    points: Floats  # (3, n) in the camera's frame
    inverse: Floats  # (n,) of their depth, 1/m
    flat: Floats  # (n,) how far along their normals they are from the image's centre, pixels
    moved: Floats  # (n,) and from where the image was read
    off: Floats  # (n,) how far the edge of each is off as a whole besides, pixels along the normal


class Nearest(NamedTuple):
    """Of each line the hypothesis that it takes."""

    at: Indices  # (n,) its number among all of `Stage.peaks`, row by row
    pixels: Floats  # (n,) its residual; -inf where there is none


class Matches(NamedTuple):
    """Of each line: the column of its hypothesis, its residual (infinite where none), and how strange it looks."""

    columns: Indices
    pixels: Floats
    strange: Floats


class Equations(NamedTuple):
    """What control points say of twists, when how far each edge is off as a whole is solved for at once. Twists have k
    parts: the object's in its frame are the last six, the camera's in its own the six before, where it is unknown."""

    normal: Floats  # (m, k + 1, k + 1) of each object's twist; last row and column: the gradient
    shared: Floats  # (k + 1, e) of each edge: what its twist does to all of it, and what pulls at it
    wholes: Floats  # (e,) what holds it
    used: Indices  # those edges that have any weight

    @property
    def blocks(self) -> Floats:
        """(m, k, k)"""
        return self.normal[:, :-1, :-1]

    @property
    def gradients(self) -> Floats:
        """(m, k)"""
        return self.normal[:, :-1, -1]

    def off(self, twists: Floats, owners: Indices) -> Floats:
        """(e,) pixels by which each edge is off as a whole after twists (m, k), by its owner."""
        return np.asarray(-(self.shared[-1] + np.einsum("ke,ek->e", self.shared[:-1], twists[owners])) / self.wholes)


def seen_from(poses: Floats, stage: Stage, off: Floats) -> Seen:
    """The control points of a stage from other poses (m, 4, 4), near by."""
    across, origin = stage.projection.across, stage.projection.origin
    points = _placed(poses, stage)
    inverse = 1.0 / np.maximum(points[2], NEAREST_M)
    flat = (across[0] * points[0] + across[1] * points[1]) * inverse
    return Seen(points, inverse, flat, flat + origin, off)


def _placed(poses: Floats, stage: Stage) -> Floats:
    if len(poses) > const.MANY:
        return np.ascontiguousarray(placed(poses, stage.controls.owners, stage.controls.points).T)
    points = np.empty_like(stage.projection.points)
    for view, pose in zip(stage.layout.views, poses, strict=True):
        points[:, view] = pose[:3, :3] @ stage.projection.points[:, view] + pose[:3, 3:]
    return points


def nearest(seen: Seen, stage: Stage, scale: Floats | float) -> Nearest:
    """Of each line the hypothesis that is near, as `scale` (pixels) has it, and not strange."""
    peaks = stage.peaks
    off = peaks.places - (seen.moved + seen.off).astype(np.float32)[:, None]
    per_square = np.asarray(1.0 / np.square(scale), dtype=np.float32)
    cost = off * off * (per_square[:, None] if per_square.ndim else per_square)
    cost += np.float32(const.STRANGE_WEIGHT) * peaks.strange
    at = cost.argmin(axis=1) + np.arange(0, cost.size, cost.shape[1])
    return Nearest(at, -off.reshape(-1)[at].astype(np.float64))


def matches_of(stage: Stage, found: Nearest) -> Matches:
    """What the lines took, as others look at it."""
    peaks = stage.peaks
    return Matches(peaks.columns.reshape(-1)[found.at], found.pixels, _strange(stage, found))


def _strange(stage: Stage, found: Nearest) -> Floats:
    return stage.peaks.strange.reshape(-1)[found.at].astype(np.float64)


def weights_of(stage: Stage, found: Nearest, scale: Floats | float, search: Search) -> Floats:
    """1/px² of each control point: Tukey's function of the distance, less where it may be hidden, where its hypothesis
    looks strange, and on edges blurred beside the others of its object: the blur of a shadow beside the foot of an
    object draws the peak away from the edge, all along it."""
    weights = tukey(found.pixels, scale) * stage.weights * np.exp(-const.STRANGE_WEIGHT * _strange(stage, found))
    near = (weights > 1e-6).astype(np.float64)
    edges, edge_count = stage.layout.edges, len(stage.spread)
    count = summed(edges, near, edge_count)
    sharp = near * stage.peaks.sharpness.reshape(-1)[found.at]
    mean = summed(edges, sharp, edge_count) / np.maximum(count, 1.0)
    relative = np.minimum(mean / np.maximum(_usual(stage, mean, count), 1e-9), 1.0)
    return np.asarray(weights * near * (relative**search.blur_power)[edges])


def _usual(stage: Stage, mean: Floats, count: Floats) -> Floats:
    """(e,) of each edge how sharp those of its object usually are, counting each edge's mean (e,) so often (e,)."""
    owners, views = stage.layout.owners, stage.layout.edge_views
    order = np.lexsort((mean, owners))
    until = np.concatenate((np.zeros(1), np.cumsum(count[order])))
    ends = np.array([[view.start, view.stop] for view in views])
    first, last = until[ends].T
    wanted = first + np.floor(const.USUAL_SHARPNESS * np.maximum(last - first - 1.0, 0.0))
    place = np.minimum(np.searchsorted(until[1:], wanted, side="right"), len(order) - 1)
    return np.asarray(mean[order][place][owners])


def equations(
    poses: Floats, stage: Stage, seen: Seen, found: Nearest, weights: Floats, still: bool, told: Floats | None
) -> Equations:
    """What weighted control points say of poses (m, 4, 4).

    Args:
        poses, stage, seen, found, weights: what all lines show and took there.
        still: whether the camera is known: then its twist is left out.
        told: (m, 6, 6) what takes away of twists what no image tells, by symmetry; None: nothing.
    """
    rows = _jacobian(poses, stage, seen, still, told)
    rows[-1] = np.where(weights > 0.0, found.pixels - seen.off, 0.0)
    weighted = rows * weights
    firsts = stage.layout.firsts
    shared = np.add.reduceat(weighted, firsts, axis=1)
    held = np.add.reduceat(weights, firsts)
    wholes = held + 1.0 / stage.spread**2
    normal = products(weighted, rows, stage.layout.views)
    normal -= products(shared / wholes, shared, stage.layout.edge_views)
    return Equations(normal, shared, wholes, np.nonzero(held)[0])


def products(left: Floats, right: Floats, views: list[slice]) -> Floats:
    """(m, k, k) of columns (k, n): of each owner's ``left @ right.T``; of few it is quicker one by one."""
    if len(views) <= const.MANY:
        return np.stack([left[:, view] @ right[:, view].T for view in views])
    found = np.zeros((len(views), len(left), len(right)))
    some = [at for at, view in enumerate(views) if view.stop > view.start]
    if some:
        every = left[:, None, :] * right[None, :, :]
        sums = np.add.reduceat(every, [views[at].start for at in some], axis=2)
        found[some] = sums.transpose(2, 0, 1)
    return found


def _jacobian(poses: Floats, stage: Stage, seen: Seen, still: bool, told: Floats | None) -> Floats:
    """(k + 1, n): how the parts of a twist move each point along its normal, as `Equations` has them; the last row is
    for what is to be explained."""
    across, hats = stage.projection.across, stage.projection.hats
    towards = np.empty_like(seen.points)
    towards[:2] = across * seen.inverse
    towards[2] = -seen.flat * seen.inverse
    rows = np.empty((7 if still else 13, len(seen.flat)))
    own = rows[-7:-1]
    own[:3] = _turned(poses, stage, towards)
    np.einsum("ijn,jn->in", hats, own[:3], out=own[3:])
    if told is not None:
        for view, kept in zip(stage.layout.views, told, strict=True):
            own[:, view] = kept @ own[:, view]
    if not still:
        x, y, z = seen.points
        rows[:3] = towards
        rows[3] = y * towards[2] - z * towards[1]
        rows[4] = z * towards[0] - x * towards[2]
        rows[5] = x * towards[1] - y * towards[0]
    return rows


def _turned(poses: Floats, stage: Stage, vectors: Floats) -> Floats:
    """Vectors (3, n) of the camera's frame, each in its object's."""
    if len(poses) > const.MANY:
        turned = vectors.T[:, None, :] @ poses[stage.controls.owners, :3, :3]
        return np.asarray(turned[:, 0].T)
    turned = np.empty_like(vectors)
    for view, pose in zip(stage.layout.views, poses, strict=True):
        turned[:, view] = pose[:3, :3].T @ vectors[:, view]
    return turned
