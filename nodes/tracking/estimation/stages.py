"""One reading of the image around some poses: each control point's hypotheses, laid out as the steps need them."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.appearance import Memory, strangeness
from hierax.nodes.tracking.estimation.profiles import Image, Lines, Profiles, Singles, lines_of, read_profiles
from hierax.nodes.tracking.math.batched import only, pixels_along, placed
from hierax.nodes.tracking.math.geometry import Array, Floats
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
    sharpness: Singles  # (n, p)


class Layout(NamedTuple):
    """Which lines are whose, and on which edge: both ascend."""

    views: list[slice]  # of each object its lines
    edges: Indices  # (n,) on which of the edges that are seen each line is, from 0 on
    firsts: Indices  # (e,) of each of those edges, the first line that is on it
    owners: Indices  # (e,) and whose it is
    edge_views: list[slice]  # of each object its edges


class Projection(NamedTuple):
    """How control points move along their normals, column by column: ``(across · (x, y)) / z + origin`` is how many
    pixels (x, y, z) in the camera's frame is from where the image was read."""

    points: Floats  # (3, n) in their objects' frames
    hats: Floats  # (3, 3, n) their cross products' matrices
    across: Floats  # (2, n) normals, times the focal lengths in pixels
    origin: Floats  # (n,)


class Stage(NamedTuple):
    """One reading of the image, and what is known of the control points that it shows."""

    lines: Lines
    profiles: Profiles
    strange: Singles  # (n, k) how strange each peak looks
    peaks: Peaks
    controls: Controls  # of the lines
    memory: Memory  # beside them
    layout: Layout
    projection: Projection
    weights: Floats  # (n,) 1/px² of a line whose peak is where it should be and looks familiar
    spread: Floats  # (e,) of each edge, the standard deviation of how far it is off as a whole, pixels
    # (e,) and whether its object's model is imprecise: then it is matched where it is found to be
    loose: NDArray[np.bool_]

    @property
    def edges(self) -> Indices:
        """(n,) as `Layout` has them."""
        return self.layout.edges

    @property
    def firsts(self) -> Indices:
        """(e,) as `Layout` has them."""
        return self.layout.firsts


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
    layout = _layout(shown.owners, numbers, len(poses))
    spread = _spread(shown, poses, lines, memory, layout.edges, intrinsics)
    loose = np.bincount(layout.edges, weights=memory.slack[:, 0, 0]) > 0.0
    weights = shown.visible * (memory.trust * memory.apart) / search.noise_px**2
    peaks = _peaks(profiles, strange)
    projection = _projection(shown, lines, intrinsics)
    return Stage(lines, profiles, strange, peaks, shown, memory, layout, projection, weights, spread, loose)


def _layout(owners: Indices, numbers: Indices, count: int) -> Layout:
    begins = np.diff(numbers, prepend=-1) != 0
    firsts = np.nonzero(begins)[0]
    edge_owners = owners[firsts]
    return Layout(views_of(owners, count), np.cumsum(begins) - 1, firsts, edge_owners, views_of(edge_owners, count))


def _projection(controls: Controls, lines: Lines, intrinsics: Array) -> Projection:
    points, normals = np.ascontiguousarray(controls.points.T), lines.normals.T
    hats = np.zeros((3, 3, len(lines.rows)))
    hats[2, 1], hats[0, 2], hats[1, 0] = points
    hats -= hats.transpose(1, 0, 2)
    origin = np.einsum("kn,kn->n", normals, np.asarray(intrinsics[2:])[:, None] - lines.pixels.T)
    return Projection(points, hats, normals * np.asarray(intrinsics[:2])[:, None], origin)


def _peaks(profiles: Profiles, strange: Singles) -> Peaks:
    places = profiles.places
    rows, at = np.nonzero(np.isfinite(places))
    counts = np.bincount(rows, minlength=len(places))
    order = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = np.zeros((len(places), max(1, int(counts.max(initial=0)))), dtype=np.intp)
    columns[rows, order] = at
    kept = np.full(columns.shape, np.inf, dtype=np.float32)
    kept[rows, order] = places[rows, at]
    every = np.arange(len(places))[:, None]
    return Peaks(columns, kept, strange[every, columns], profiles.sharpness[every, columns])


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
    towards = pixels_along(lines.normals[rows], placed(poses, owners, points), intrinsics)
    return np.asarray((towards[:, None, :] @ poses[owners, :3, :3])[:, 0])


def views_of(owners: Indices, count: int) -> list[slice]:
    """Where each of so many owners' part is in what is sorted by owner."""
    ends = np.searchsorted(owners, np.arange(count + 1)).tolist()
    return [slice(*pair) for pair in pairwise(ends)]
