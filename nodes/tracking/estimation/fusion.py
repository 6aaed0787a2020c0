"""What a prediction and an image say together: the correction of all objects and the camera, and how far it surprises.

How far an object may leave its prediction is learned from how far it did: something at rest is
averaged over many images, something that is pushed is believed at once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.math.batched import adjoints, inverse, invert_many, log_many, solved
from hierax.nodes.tracking.math.geometry import Floats


class Rows:
    """Where things stand in `Prior.joint`: the camera's drift and error, then of each object pose and size."""

    drift, error = slice(6), slice(6, 12)

    @staticmethod
    def bodies(count: int) -> slice:
        """Of all objects."""
        return slice(12, 12 + 7 * count)

    @staticmethod
    def body(at: int) -> slice:
        """Of an object."""
        return slice(12 + 7 * at, 19 + 7 * at)

    @staticmethod
    def sizes(count: int) -> slice:
        """Of all objects' sizes."""
        return slice(18, 12 + 7 * count, 7)

    @staticmethod
    def pose(at: int) -> slice:
        """Of an object's pose."""
        return slice(12 + 7 * at, 18 + 7 * at)


class Known(NamedTuple):
    """What is known of the camera and all objects together, before the image."""

    # (12 + 7 m, 12 + 7 m) covariance of the camera's drift and of its error in this image, twists in its frame, and of
    # each object's pose in the world before it moves, a twist in its frame, and of its size, a share of that; and,
    # where there is one, of the camera's error in an older image (6 more), a twist in its frame; None: the camera's
    # pose is exact
    joint: Floats | None = None
    # what is expected of all of that, where the table's texture has told something of it; None: nothing
    mean: Floats | None = None
    older: slice | None = None  # which rows are about the camera's error in an older image from the next image on
    # how much better than `joint` has it sizes are known, as inverse covariance (m, m), and which they are (m,)
    sizes: tuple[Floats, Floats] | None = None


class Prior(NamedTuple):
    """What is known before the image: of each object, and, as `Known` has it, of all."""

    covariance: Floats  # (m, 6, 6) of the objects where they were seen last
    motion: Floats  # (6, 6) of an object's deviation from its prediction within a frame, when it is pushed
    motion_scale: Floats  # (m,) how much of that each object's latest motion asks for
    trend: Floats  # (m, 6) running mean of how far images had objects from their predictions, in standard deviations
    joint: Floats | None
    mean: Floats | None = None
    older: slice | None = None
    sizes: tuple[Floats, Floats] | None = None

    @property
    def camera(self) -> Floats | None:
        """(6, 6) inverse covariance of the camera's error, twist in its frame, if objects are where they are expected;
        None where its pose is exact."""
        return None if self.joint is None else _information(self.joint, len(self.covariance))

    @property
    def shift(self) -> Floats:
        """(6,) the camera's error as it is expected, twist in its frame."""
        return np.zeros(6) if self.mean is None else self.mean[Rows.error]

    def spread(self) -> Floats:
        """(m, 6, 6) covariance of the predicted poses."""
        return np.asarray(self.covariance + self.motion_scale[:, None, None] ** 2 * self.motion)


class Fused(NamedTuple):
    """What is known after the image."""

    shift: Floats  # (6,) twist of the camera's frame: what its error does to all poses
    own: Floats  # (m, 6) twist of each object in its frame
    covariance: Floats  # (m, 6, 6) of the corrected poses
    motion_scale: Floats  # (m,)
    trend: Floats  # (m, 6)
    drift: Floats  # (6,) twist of the camera's frame: what is left of its error in the next image
    sizes: Floats  # (m,) by which share each object is larger than was expected
    # (6 + 7 m, 6 + 7 m) covariance of drift, poses in the world and sizes, and of `Prior.older`; None: a known camera
    joint: Floats | None
    older: Floats  # (6,) what is known of `Prior.older` beside what was expected of it


class _Solved(NamedTuple):
    """What the image and the prior say."""

    twists: Floats  # (m, 6) of the objects
    shift: Floats  # (6,)
    drift: Floats  # (6,)
    sizes: Floats  # (m,)
    spread: Floats  # covariance as `Prior.joint` has it, after the image; of nothing where that is None
    older: Floats  # (6,)


def fuse(aligned: Aligned, prior: Prior, resting: NDArray[np.bool_] | None = None) -> Fused:
    """The correction that prediction and image speak for together (a Kalman filter's update); aligned: what the image
    says, found with priors that leave room for motion; resting: (m,) which objects are known to rest, however the image
    surprises; None: none."""
    found = _solved(aligned, prior)
    off = _off(aligned, prior, found)
    gain = 1.0 - const.CALMING
    trend = prior.trend + gain * (off - prior.trend)
    # Many small deviations the same way are as surprising as one large one.
    squares = np.maximum((off * off).sum(axis=1), (trend * trend).sum(axis=1) * (2.0 / gain - 1.0))
    surprise = np.sqrt(squares / 6.0)
    surprised = surprise > const.SURPRISED
    if resting is not None:
        surprised &= ~resting
    if surprised.any():
        prior = prior._replace(motion_scale=np.where(surprised, 1.0, prior.motion_scale))
        found = _solved(aligned, prior)
    calmer = np.clip(prior.motion_scale * np.maximum(const.CALMING, surprise), const.LEAST_MOTION_SCALE, 1.0)
    motion_scale = np.where(surprised, 1.0, calmer)
    trend = np.where(surprised[:, None], 0.0, trend)
    covariance, joint = _spread(aligned, prior, found)
    solved_for = (found.drift, found.sizes, joint, found.older)
    return Fused(found.shift, found.twists, covariance, motion_scale, trend, *solved_for)


def _solved(aligned: Aligned, prior: Prior) -> _Solved:
    """By the image's loss as a quadratic around what was found."""
    count = len(aligned.own)
    shift = log_many(aligned.shift[None])[0]
    if prior.joint is None:
        blocks = aligned.blocks[:, 6:, 6:]
        said = (blocks @ aligned.own[..., None])[..., 0] - aligned.slopes[:, 6:]
        twists = solved(blocks + inverse(prior.spread()), said[..., None])[..., 0]
        nothing = np.zeros((Rows.error.stop, Rows.error.stop))
        return _Solved(twists, np.zeros(6), np.zeros(6), np.zeros(count), nothing, np.zeros(6))
    whole = inverse(_with_motion(prior))
    right = np.zeros(len(whole)) if prior.mean is None else whole @ prior.mean
    if prior.sizes is not None:
        rows = np.r_[Rows.sizes(count)]
        information, which = prior.sizes
        whole[np.ix_(rows, rows)] += information
        right[rows] += information @ which
    whole[Rows.error, Rows.error] += aligned.blocks[:, :6, :6].sum(axis=0)
    for at in range(count):
        view, seen = Rows.body(at), _as_seen(aligned.poses[at])
        blocks = aligned.blocks[at]
        whole[view, view] += seen.T @ blocks[6:, 6:] @ seen
        whole[Rows.error, view] += blocks[:6, 6:] @ seen
        whole[view, Rows.error] += seen.T @ blocks[6:, :6]
        said = blocks @ np.concatenate((shift, aligned.own[at])) - aligned.slopes[at]
        right[view] = seen.T @ said[6:]
        right[Rows.error] += said[:6]
    spread = inverse(whole)
    means = spread @ right
    bodies = means[Rows.bodies(count)].reshape(count, 7)
    older = np.zeros(6) if prior.older is None else means[prior.older]
    return _Solved(bodies[:, :6], means[Rows.error], means[Rows.drift], bodies[:, 6], spread, older)


def _as_seen(pose: Floats) -> Floats:
    """(6, 7) what a twist and a size together look like, as a twist: what is larger looks nearer."""
    nearer = np.concatenate((-pose[:3, :3].T @ pose[:3, 3], np.zeros(3)))
    return np.column_stack((np.eye(6), nearer))


def _with_motion(prior: Prior) -> Floats:
    """`Prior.joint` when the objects have moved."""
    assert prior.joint is not None
    joint, count = np.array(prior.joint), len(prior.motion_scale)
    motion = np.broadcast_to(prior.motion, (count, 6, 6))
    for at, scale in enumerate(prior.motion_scale):
        joint[Rows.pose(at), Rows.pose(at)] += scale**2 * motion[at]
    return joint


def _spread(aligned: Aligned, prior: Prior, found: _Solved) -> tuple[Floats, Floats | None]:
    """The covariances (m, 6, 6) of the poses as the camera sees them; and `Fused.joint`."""
    if prior.joint is None:
        return inverse(inverse(prior.spread()) + aligned.blocks[:, 6:, 6:]), None
    carried = adjoints(invert_many(aligned.poses))
    camera = found.spread[Rows.error, Rows.error]
    covariance = np.zeros((len(carried), 6, 6))
    for at, turned in enumerate(carried):
        both = turned @ found.spread[Rows.error, Rows.pose(at)]
        covariance[at] = turned @ camera @ turned.T + both + both.T + found.spread[Rows.pose(at), Rows.pose(at)]
    older = np.zeros(0, dtype=np.int64) if prior.older is None else np.r_[prior.older]
    kept = np.concatenate((np.r_[Rows.drift, Rows.bodies(len(carried))], older))
    return 0.5 * (covariance + covariance.transpose(0, 2, 1)), found.spread[np.ix_(kept, kept)]


def _information(joint: Floats, count: int) -> Floats:
    """(6, 6) inverse covariance of the camera's error, by `Prior.joint`, where the objects are known."""
    rows = slice(Rows.error.start, Rows.bodies(count).stop)
    return inverse(joint[rows, rows])[:6, :6]


def _off(aligned: Aligned, prior: Prior, found: _Solved) -> Floats:
    """(m, 6) how far the image alone would have each object from its prediction, in standard deviations of both, and of
    what the camera's error, as far as it is known, makes of it."""
    spread = prior.spread()
    known = inverse(spread)
    information = aligned.blocks[:, 6:, 6:] + const.EASE * known
    moved = found.shift - log_many(aligned.shift[None])[0]
    right = (information @ aligned.own[..., None])[..., 0] - aligned.slopes[:, 6:]
    right -= aligned.blocks[:, 6:, :6] @ moved
    alone = solved(information, right[..., None])
    vague = np.zeros((6, 6)) if prior.joint is None else inverse(_information(found.spread, len(spread)))
    carried = adjoints(invert_many(aligned.poses))
    both = spread + inverse(information) + carried @ vague @ carried.transpose(0, 2, 1)
    return np.asarray(solved(np.asarray(np.linalg.cholesky(both)), alone)[..., 0])
