"""One reading of the image around some poses: each control point's hypotheses, and what they say of the poses."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.appearance import Memory, strangeness
from hierax.nodes.tracking.estimation.profiles import Image, Lines, Profiles, Singles, lines_of, read_profiles
from hierax.nodes.tracking.math.batched import only, pixels_along, pixels_of, placed, tukey
from hierax.nodes.tracking.math.geometry import Array, Floats, cross
from hierax.nodes.tracking.model.controls import CREASE, Controls, Indices


class Search(NamedTuple):
    """How the image is searched."""

    reach_px: tuple[int, ...] = const.REACH_PX  # how far along the normal, one entry a stage
    # where Tukey's weight ends in the first and the last iteration of each stage
    scale_px: tuple[tuple[float, float], ...] = const.SCALE_PX
    iterations: int = const.ITERATIONS  # Gauss-Newton steps in a stage
    # least and largest end of Tukey's weight in the steps that follow the last stage
    fine_px: tuple[float, float] = const.LAST_PX
    fine_iterations: int = const.LAST_ITERATIONS  # how many those are
    contrast: float = const.CONTRAST  # smallest slope that counts as an edge, grey levels per pixel
    noise_px: float = const.NOISE_PX  # standard deviation of a match
    blur_power: float = const.BLUR_POWER  # how strongly blurred peaks lose weight
    support_px: float = const.SUPPORT_PX  # how near a hypothesis must be in the end to support a control point
    # whether each edge as a whole is looked for first: so far beside the model's it may be that none of its control
    # points is near
    voted: bool = False


class Peaks(NamedTuple):
    """The peaks of each line alone, in their order."""

    columns: Indices  # (n, p) of the profile; of a line with fewer peaks the others are 0
    places: Singles  # (n, p) pixels along the normal; inf where there is none
    strange: Singles  # (n, p)


class Stage(NamedTuple):
    """One reading of the image, and what is known of the control points that it shows."""

    lines: Lines
    profiles: Profiles
    strange: Singles  # (n, k) how strange each peak looks
    peaks: Peaks
    controls: Controls  # of the lines
    memory: Memory  # beside them
    edges: Indices  # (n,) on which of the edges that are seen each line is, from 0 on
    spread: Floats  # of each of those, the standard deviation of how far it is off as a whole, pixels
    loose: NDArray[np.bool_]  # and whether its object's model is imprecise: then it is matched where it is found to be

    @property
    def firsts(self) -> Indices:
        """Of each of those edges, the first line that is on it."""
        return np.searchsorted(self.edges, np.arange(len(self.spread)))


class Seen(NamedTuple):
    """Control points from the poses as they are: (n, 3) in the camera's frame; pixels moved along their normals."""

    points: Floats
    moved: Floats
    off: Floats  # (n,) how far the edge of each is off as a whole besides, pixels along the normal


class Equations(NamedTuple):
    """What control points say of twists, when how far each edge is off as a whole is solved for at once."""

    blocks: Floats  # (m, 12, 12) of each object's, over (camera, own) twists
    gradients: Floats  # (m, 12)
    edges: Indices  # (e,) numbers of the edges as `Stage.edges` has them; of each its owner, and what says how far
    owners: Indices
    shared: Floats  # (e, 12)
    pulls: Floats  # (e,)
    wholes: Floats  # (e,)

    def told(self, projections: Floats | None) -> "Equations":
        """The same without what no image tells of the objects, by projections (m, 6, 6) of their twists."""
        if projections is None:
            return self
        whole = np.tile(np.eye(12), (len(projections), 1, 1))
        whole[:, 6:12, 6:12] = projections
        blocks = whole @ self.blocks @ whole
        shared = np.einsum("eij,ej->ei", whole[self.owners], self.shared)
        return self._replace(blocks=blocks, gradients=(whole @ self.gradients[..., None])[..., 0], shared=shared)

    def off(self, twists: Floats) -> Floats:
        """(e,) pixels by which each edge is off as a whole after (camera, own) twists (m, 12)."""
        return np.asarray(-(self.pulls + np.einsum("ek,ek->e", self.shared, twists[self.owners])) / self.wholes)


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
    strange = strangeness(memory, profiles)
    shown = only(controls, lines.rows)
    edges = np.cumsum(np.diff(numbers, prepend=numbers[0]) != 0)
    spread = _spread(shown, poses, lines, memory, edges, intrinsics)
    loose = np.bincount(edges, weights=memory.slack[:, 0, 0]) > 0.0
    return Stage(lines, profiles, strange, _peaks(profiles.places, strange), shown, memory, edges, spread, loose)


def _peaks(places: Singles, strange: Singles) -> Peaks:
    rows, at = np.nonzero(np.isfinite(places))
    counts = np.bincount(rows, minlength=len(places))
    order = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = np.zeros((len(places), max(1, int(counts.max(initial=0)))), dtype=np.intp)
    columns[rows, order] = at
    kept = np.full(columns.shape, np.inf, dtype=np.float32)
    kept[rows, order] = places[rows, at]
    return Peaks(columns, kept, np.take_along_axis(strange, columns, axis=1))


def _spread(
    controls: Controls, poses: Floats, lines: Lines, memory: Memory, edges: Indices, intrinsics: Array
) -> Floats:
    """Of each edge the standard deviation of how far it is off as a whole, by its kind and by what is not known of the
    object's model, pixels."""
    variance = np.where(controls.kinds == CREASE, const.CREASE_PX, const.WHOLE_PX) ** 2
    loose = np.nonzero(memory.slack.any(axis=(1, 2)))[0]
    if len(loose):
        moves = moves_of(poses, controls, lines, loose, intrinsics)
        variance[loose] += np.einsum("ni,nij,nj->n", moves, memory.slack[loose], moves)
    return np.asarray(np.sqrt(np.bincount(edges, weights=variance) / np.bincount(edges)))


def moves_of(poses: Floats, controls: Controls, lines: Lines, rows: Indices, intrinsics: Array) -> Floats:
    """(n, 3) pixels along the normal for every metre in the object's frame, of some lines."""
    points, owners = controls.points[rows], controls.owners[rows]
    return _jacobian(poses, points, owners, lines.normals[rows], placed(poses, owners, points), intrinsics)[:, 6:9]


def seen_from(poses: Floats, stage: Stage, off: Floats, intrinsics: Array) -> Seen:
    points = placed(poses, stage.controls.owners, stage.controls.points)
    moved = np.einsum("nk,nk->n", pixels_of(points, intrinsics) - stage.lines.pixels, stage.lines.normals)
    return Seen(points, moved, off)


def chosen_near(seen: Seen, stage: Stage, scale: Floats | float) -> Matches:
    """Of each line the hypothesis that is near, as `scale` (pixels) has it, and not strange."""
    peaks = stage.peaks
    off = peaks.places - (seen.moved + seen.off).astype(np.float32)[:, None]
    scales = np.broadcast_to(scale, seen.moved.shape)
    cost = off * off * (1.0 / (scales * scales)).astype(np.float32)[:, None]
    nearest = (cost + np.float32(const.STRANGE_WEIGHT) * peaks.strange).argmin(axis=1)
    at = (np.arange(len(nearest)), nearest)
    return Matches(peaks.columns[at], -off[at].astype(np.float64), peaks.strange[at].astype(np.float64))


def weights_of(stage: Stage, matches: Matches, scale: Floats | float, search: Search) -> Floats:
    """1/px² of each control point: Tukey's function of the distance, less where it may be hidden, where its hypothesis
    looks strange, and on edges blurred beside the others of its object: the blur of a shadow beside the foot of an
    object draws the peak away from the edge, all along it."""
    weights = tukey(matches.pixels, scale) * stage.controls.visible * np.exp(-const.STRANGE_WEIGHT * matches.strange)
    weights *= stage.memory.trust * stage.memory.apart / search.noise_px**2
    near = weights > 1e-6
    if not near.any():
        return np.zeros_like(weights)
    owners = stage.controls.owners
    sharp = stage.profiles.sharpness[np.arange(len(near)), matches.columns].astype(np.float64)
    count = np.bincount(stage.edges, weights=near)
    total = np.bincount(stage.edges, weights=np.where(near, sharp, 0.0))
    mean = (total / np.maximum(count, 1.0))[stage.edges]
    found = ranked(owners[near], mean[near], int(owners[-1]) + 1)
    usual = found.at((const.USUAL_SHARPNESS * (found.counts - 1)).astype(np.intp), 1.0)
    relative = np.minimum(mean / np.maximum(usual[owners], 1e-9), 1.0)
    return np.asarray(np.where(near, weights * relative**search.blur_power, 0.0))


class Ranked(NamedTuple):
    """Values of owners, each owner's ascending."""

    values: Floats
    starts: Indices  # (m,) where each owner's begin
    counts: Indices  # (m,)

    def at(self, places: Array, otherwise: float) -> Floats:
        """Of each owner the value at a place of its own (m,), below its count; of one without any, `otherwise`."""
        known = self.counts > 0
        found = np.full(len(known), otherwise)
        found[known] = self.values[(self.starts + places)[known]]
        return found


def ranked(owners: Indices, values: Floats, count: int) -> Ranked:
    """Values (n,) of so many owners, by the owner's number."""
    counts = np.bincount(owners, minlength=count)
    return Ranked(values[np.lexsort((values, owners))], np.cumsum(counts) - counts, counts)


def views_of(owners: Indices, count: int) -> list[slice]:
    """Where each of so many owners' part is in what is sorted by owner."""
    ends = np.searchsorted(owners, np.arange(count + 1)).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def normal_equations(
    poses: Floats,
    stage: Stage,
    seen: Seen,
    matches: Matches,
    weights: Floats,
    intrinsics: Array,
    still: bool = False,
) -> Equations:
    """What weighted control points say of poses; where the camera is known (`still`), of many poses without what they
    say of its twist, which is zeros."""
    used, count = weights > 0, len(poses)
    width = 6 if still and count > const.MANY else 12
    points, owners = stage.controls.points[used], stage.controls.owners[used]
    residuals, weights = (matches.pixels - seen.off)[used], weights[used]
    if not len(owners):
        none = np.zeros(0, dtype=np.intp)
        nothing = (np.zeros((count, 12, 12)), np.zeros((count, 12)))
        return Equations(*nothing, none, none, np.zeros((0, 12)), np.zeros(0), np.zeros(0))
    jacobian = _jacobian(poses, points, owners, stage.lines.normals[used], seen.points[used], intrinsics, width)
    weighted = jacobian * weights[:, None]
    blocks, gradients = _summed_products(jacobian, weighted, residuals, owners, count)
    edges = stage.edges[used]
    starts = np.nonzero(np.diff(edges, prepend=-1))[0]
    edges, owners = edges[starts], owners[starts]
    shared = np.add.reduceat(weighted, starts)
    pulls = np.add.reduceat(weights * residuals, starts)
    wholes = np.add.reduceat(weights, starts) + 1.0 / stage.spread[edges] ** 2
    taken, pulled = _summed_products(shared, shared / wholes[:, None], pulls, owners, count)
    own = slice(12 - width, 12)
    told = Equations(
        np.zeros((count, 12, 12)), np.zeros((count, 12)), edges, owners, np.zeros((len(edges), 12)), pulls, wholes
    )
    told.blocks[:, own, own] = blocks - taken
    told.gradients[:, own], told.shared[:, own] = gradients - pulled, shared
    return told


def _summed_products(
    left: Floats, right: Floats, numbers: Floats, owners: Indices, count: int
) -> tuple[Floats, Floats]:
    """(m, k, k) and (m, k): of each owner's rows left.T @ right, and right.T @ numbers."""
    width = left.shape[1]
    blocks, gradients = np.zeros((count, width, width)), np.zeros((count, width))
    if count > const.MANY:  # of few it is quicker one by one
        starts = np.nonzero(np.diff(owners, prepend=-1))[0]
        products = (left[:, :, None] * right[:, None, :]).reshape(-1, width * width)
        blocks[owners[starts]] = np.add.reduceat(products, starts).reshape(-1, width, width)
        gradients[owners[starts]] = np.add.reduceat(right * numbers[:, None], starts)
        return blocks, gradients
    for at, view in enumerate(views_of(owners, count)):
        blocks[at] = left[view].T @ right[view]
        gradients[at] = right[view].T @ numbers[view]
    return blocks, gradients


def _jacobian(
    poses: Floats,
    points: Floats,
    owners: Indices,
    normals: Floats,
    seen: Floats,
    intrinsics: Array,
    width: int = 12,
) -> Floats:
    """(n, 12): how a twist of the camera's frame, and one of the object's, move each point along its normal; or (n, 6),
    the latter alone."""
    towards = pixels_along(normals, seen, intrinsics)
    turned = (towards[:, None, :] @ poses[owners, :3, :3])[:, 0]
    own = (turned, cross(points, turned))
    return np.concatenate(own if width == 6 else (towards, cross(seen, towards), *own), axis=1)
