"""Correcting the poses of all objects at once so that their expected edges lie on edges of the image.

At each control point every peak of the image's gradient along the edge's normal is a hypothesis. Gauss-Newton on SE(3)
moves the poses: in each iteration every control point takes the hypothesis that is nearest to where its pose now puts
it and looks like its edge, weighted by Tukey's function. What all objects seem to do together is the camera's error: it
is one further unknown, a twist in the camera's frame, with a prior of its own."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation import equations as eqs
from hierax.nodes.tracking.estimation import stages
from hierax.nodes.tracking.estimation.appearance import Memory
from hierax.nodes.tracking.estimation.profiles import Image
from hierax.nodes.tracking.math.batched import exp_many, log_many, solved, summed, tukey
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.model.controls import Controls, Indices


class Start(NamedTuple):
    """Where the search begins."""

    poses: Floats  # (m, 4, 4) camera_from_object, predicted
    information: Floats  # (m, 6, 6) inverse covariance of each, twist in the object's frame
    # (6, 6) inverse covariance of the camera's error, twist in its own frame; None where it is known
    camera: Floats | None = None
    told: Floats | None = None  # (m, 6, 6) what takes away of twists what no image tells, by symmetry; None: nothing


class Aligned(NamedTuple):
    """What the image says of the poses."""

    poses: Floats  # (m, 4, 4) camera_from_object, corrected
    shift: Floats  # (4, 4) what the camera's error does to all of them: ``pose = shift @ predicted @ exp(own)``
    own: Floats  # (m, 6) twist of each object in its frame
    # (m, 12, 12) the image's information about (twist of the camera's frame, twist of the object's) here
    blocks: Floats
    slopes: Floats  # (m, 12) gradient of the image's loss over the same: zero but for what the priors hold back
    scores: Floats  # (m,) 0 to 1: the share of control points that the image supports, beyond chance
    shown: Floats  # (m,) how many control points should be seen
    gains: Floats  # (m,) how many of them speak for the pose, each by how near and how familiar its hypothesis is
    stage: stages.Stage  # the last one
    matches: eqs.Matches  # there
    off: Floats  # (n,) of each line, how far its edge is off as a whole, pixels along its normal
    supported: NDArray[np.bool_]  # (n,) of each line, whether its hypothesis supports the pose


class _State(NamedTuple):
    """poses = shift @ predicted @ exp(own)."""

    poses: Floats
    shift: Floats
    own: Floats
    off: Floats  # (n,) of each control point, how far its edge is off as a whole, pixels along its normal

    def seen(self, stage: stages.Stage) -> eqs.Seen:
        return eqs.seen_from(self.poses, stage, self.off[stage.lines.rows])


def align(
    image: Image, controls: Controls, start: Start, intrinsics: Array, memory: Memory, search: stages.Search
) -> Aligned | None:
    """Correct predicted poses; None where no control point is in the image. The image is of `smoothed`, the control
    points are those of all objects, `start` is where they should be, `memory` what they looked like beside their
    edges."""
    whole = np.broadcast_to(np.eye(4), start.poses.shape)
    state = _State(start.poses, np.eye(4), whole, np.zeros(len(controls.owners)))
    stage: stages.Stage | None = None
    for reach, scales in zip(search.reach_px, search.scale_px, strict=True):
        stage = stages.read_stage(image, controls, state.poses, intrinsics, memory, reach, search)
        if stage is None:
            return None
        if search.voted:
            state = _voted(state, stage, search)
        for scale in np.linspace(*scales, search.iterations):
            state = _step(state, start, stage, scale, search)
    assert stage is not None
    ends = _fine_scale(state, stage, search)
    for _ in range(search.fine_iterations):
        state = _step(state, start, stage, ends, search)
    return _judged(state, start, stage, ends, search)


def _voted(state: _State, stage: stages.Stage, search: stages.Search) -> _State:
    """Each edge where most of its control points have a peak at the same distance, the nearer ones rather."""
    reach = (stage.profiles.places.shape[1] - 1) // 2
    seen = state.seen(stage)
    votes = np.zeros((len(stage.spread), 4 * reach + 1))
    away = stage.profiles.places - seen.moved[:, None]
    rows, columns = np.nonzero(np.abs(away) < reach)
    weight = stage.controls.visible[rows] * np.exp(-const.STRANGE_WEIGHT * stage.strange[rows, columns])
    np.add.at(votes, (stage.edges[rows], np.rint(2.0 * (away[rows, columns] + reach)).astype(np.intp)), weight)
    for _ in range(2):  # peaks are a pixel wide
        beside = np.pad(votes, ((0, 0), (1, 1)))
        votes = 0.5 * beside[:, :-2] + votes + 0.5 * beside[:, 2:]
    places = np.linspace(-reach, reach, votes.shape[1])
    best = places[(votes * (1.0 - (places / (1.5 * reach)) ** 2)).argmax(axis=1)]
    off = state.off.copy()
    off[stage.lines.rows] = np.where(stage.loose, best, 0.0)[stage.edges]
    return state._replace(off=off)


def _fine_scale(state: _State, stage: stages.Stage, search: stages.Search) -> Floats:
    """(n,) where Tukey's weight ends for each control point in the end, by how far its object's residuals spread."""
    seen = state.seen(stage)
    sizes = np.abs(eqs.nearest(seen, stage, search.support_px).pixels)
    near, owners = sizes < search.support_px, stage.controls.owners
    found = ranked(owners[near], sizes[near], len(state.poses))
    medians = 0.5 * (found.at((found.counts - 1) // 2, np.inf) + found.at(found.counts // 2, np.inf))
    return np.asarray(np.clip(const.SPREADS * medians, *search.fine_px)[owners])


def offsets_at(aligned: Aligned, poses: Floats) -> Floats:
    """(n,) of each line the pixels along the normal from where other poses, near by, put it to its hypothesis."""
    stage = aligned.stage
    places = stage.profiles.places[np.arange(len(stage.edges)), aligned.matches.columns]
    return np.asarray(places.astype(np.float64) - eqs.seen_from(poses, stage, aligned.off).moved)


def _step(state: _State, start: Start, stage: stages.Stage, scale: Floats | float, search: stages.Search) -> _State:
    """One Gauss-Newton step of all objects and the camera."""
    seen = state.seen(stage)
    found = eqs.nearest(seen, stage, scale)
    weights = eqs.weights_of(stage, found, scale, search)
    said = eqs.equations(state.poses, stage, seen, found, weights, start.camera is None, start.told)
    own = log_many(state.own)
    if start.camera is None:
        slope = said.gradients[..., None] + start.information @ own[..., None]
        twists = -solved(said.blocks + start.information, slope)[..., 0]
        shift, turned = state.shift, exp_many(twists)
        poses = state.poses @ turned
    else:
        camera = log_many(state.shift[None])[0]
        steps = _with_camera(said, start.information, start.camera, own, camera)
        moved = exp_many(steps)
        turned = moved[1:]
        shift, poses = moved[0] @ state.shift, moved[0] @ state.poses @ turned
        twists = np.concatenate((np.broadcast_to(steps[0], (len(own), 6)), steps[1:]), axis=1)
    off = state.off
    if stage.loose.any():
        of_edges = seen.off[stage.firsts]
        of_edges[said.used] = said.off(twists, stage.layout.owners)[said.used]
        off = off.copy()
        off[stage.lines.rows] = np.where(stage.loose, of_edges, 0.0)[stage.edges]
    return _State(poses, shift, state.own @ turned, off)


def _with_camera(said: eqs.Equations, information: Floats, known: Floats, own: Floats, camera: Floats) -> Floats:
    """(m + 1, 6) steps of the camera's twist, then of the objects'.

    Args:
        said: what the image says; information: (m, 6, 6) of the objects' predictions.
        known: (6, 6) inverse covariance of the camera's error.
        own, camera: the twists (m, 6) and (6,) so far.
    """
    blocks, gradients, count = said.blocks, said.gradients, len(own)
    own_blocks = blocks[:, 6:, 6:] + information
    slope = gradients[:, 6:] + (information @ own[..., None])[..., 0]
    size = 6 * (count + 1)
    whole, right = np.zeros((size, size)), np.zeros(size)
    whole[:6, :6] = blocks[:, :6, :6].sum(axis=0) + known
    right[:6] = gradients[:, :6].sum(axis=0) + known @ camera
    for at in range(count):
        view = slice(6 * at + 6, 6 * at + 12)
        whole[view, view] = own_blocks[at]
        whole[:6, view] = blocks[at, :6, 6:]
        whole[view, :6] = blocks[at, 6:, :6]
        right[view] = slope[at]
    return -solved(whole, right).reshape(count + 1, 6)


def _judged(state: _State, start: Start, stage: stages.Stage, scale: Floats, search: stages.Search) -> Aligned:
    """The poses with their information and scores."""
    seen = state.seen(stage)
    found = eqs.nearest(seen, stage, search.support_px)
    matches = eqs.matches_of(stage, found)
    supported = (np.abs(matches.pixels) < search.support_px) & (matches.strange < const.STRANGE)
    weights = eqs.weights_of(stage, found, scale, search)
    said = eqs.equations(state.poses, stage, seen, found, weights, start.camera is None, start.told)
    width = said.blocks.shape[1]
    blocks, slopes = np.zeros((len(start.poses), 12, 12)), np.zeros((len(start.poses), 12))
    blocks[:, 12 - width :, 12 - width :], slopes[:, 12 - width :] = said.blocks, said.gradients
    owners, count = stage.controls.owners, len(start.poses)
    # Where edges crowd, they may claim the same one in the image; it counts for neither.
    limbs = stage.controls.limbs
    counted = stage.controls.visible * stage.memory.apart * np.where(limbs, stage.memory.trust, 1.0)
    shown = summed(owners, counted * np.where(limbs, const.LIMB_SEEN, 1.0), count)
    share = np.minimum(summed(owners, np.where(supported, counted, 0.0), count) / np.maximum(shown, 1e-6), 1.0)
    chance = summed(owners, counted * _chance(stage, search), count) / np.maximum(summed(owners, counted, count), 1e-6)
    familiar = np.exp(-const.STRANGE_WEIGHT * matches.strange)
    return Aligned(
        state.poses,
        state.shift,
        log_many(state.own),
        blocks,
        slopes,
        np.maximum(0.0, (share - chance) / np.maximum(1.0 - chance, const.LEAST_RARITY)),
        shown,
        summed(owners, counted * tukey(matches.pixels, 2.0 * search.support_px) * familiar, count),
        stage,
        matches,
        seen.off,
        supported,
    )


def _chance(stage: stages.Stage, search: stages.Search) -> Floats:
    """Of each line the share of places that are as near to a peak as one that supports a pose."""
    peaks = np.isfinite(stage.profiles.places) & (stage.strange < const.STRANGE)
    near = peaks.copy()
    for step in range(1, int(search.support_px) + 1):
        near[:, step:] |= peaks[:, :-step]
        near[:, :-step] |= peaks[:, step:]
    return np.asarray(near.mean(axis=1))


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
