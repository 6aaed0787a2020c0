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


class Prior(NamedTuple):
    """What is known before the image."""

    covariance: Floats  # (m, 6, 6) of the objects where they were seen last
    motion: Floats  # (6, 6) of an object's deviation from its prediction within a frame, when it is pushed
    motion_scale: Floats  # (m,) how much of that each object's latest motion asks for
    trend: Floats  # (m, 6) running mean of how far images had objects from their predictions, in standard deviations
    # (6, 6) inverse covariance of the camera's error, twist in its frame; None where its pose is exact
    camera: Floats | None

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


def fuse(aligned: Aligned, prior: Prior, resting: NDArray[np.bool_] | None = None) -> Fused:
    """The correction that prediction and image speak for together (a Kalman filter's update); aligned: what the image
    says, found with priors that leave room for motion; resting: (m,) which objects are known to rest, however the image
    surprises; None: none."""
    shift, own, vague = _solved(aligned, prior)
    off = _off(aligned, prior, shift, vague)
    trend = prior.trend + const.TREND_GAIN * (off - prior.trend)
    # Many small deviations the same way are as surprising as one large one.
    squares = np.maximum((off * off).sum(axis=1), (trend * trend).sum(axis=1) * (2.0 / const.TREND_GAIN - 1.0))
    surprise = np.sqrt(squares / 6.0)
    surprised = surprise > const.SURPRISED
    if resting is not None:
        surprised &= ~resting
    if surprised.any():
        prior = prior._replace(motion_scale=np.where(surprised, 1.0, prior.motion_scale))
        shift, own, _ = _solved(aligned, prior)
    covariance = inverse(inverse(prior.spread()) + aligned.blocks[:, 6:, 6:])
    calmer = np.clip(prior.motion_scale * np.maximum(const.CALMING, surprise), const.LEAST_MOTION_SCALE, 1.0)
    motion_scale = np.where(surprised, 1.0, calmer)
    trend = np.where(surprised[:, None], 0.0, trend)
    return Fused(shift, own, covariance, motion_scale, trend)


def _solved(aligned: Aligned, prior: Prior) -> tuple[Floats, Floats, Floats]:
    """Twists of the camera (6,) and of the objects (m, 6), by the image's loss as a quadratic around what was found;
    and the covariance (6, 6) of the camera's."""
    count = len(aligned.own)
    known = inverse(prior.spread())
    found = log_many(aligned.shift[None])[0]
    size = 6 * (count + 1)
    whole, right = np.zeros((size, size)), np.zeros(size)
    whole[:6, :6] = np.eye(6) if prior.camera is None else prior.camera
    for at in range(count):
        view = slice(6 * at + 6, 6 * at + 12)
        blocks = aligned.blocks[at]
        whole[view, view] = blocks[6:, 6:] + known[at]
        right[view] = blocks[6:, 6:] @ aligned.own[at] - aligned.slopes[at, 6:]
        if prior.camera is None:
            continue
        whole[:6, view], whole[view, :6] = blocks[:6, 6:], blocks[6:, :6]
        whole[:6, :6] += blocks[:6, :6]
        right[view] += blocks[6:, :6] @ found
        right[:6] += blocks[:6] @ np.concatenate((found, aligned.own[at])) - aligned.slopes[at, :6]
    twists = solved(whole, right).reshape(count + 1, 6)
    vague = np.zeros((6, 6)) if prior.camera is None else solved(whole, np.eye(size)[:, :6])[:6]
    return twists[0], twists[1:], vague


def _off(aligned: Aligned, prior: Prior, shift: Floats, vague: Floats) -> Floats:
    """(m, 6) how far the image alone would have each object from its prediction, in standard deviations of both, and of
    what the camera's error, as far as it is known, makes of it."""
    spread = prior.spread()
    known = inverse(spread)
    information = aligned.blocks[:, 6:, 6:] + const.EASE * known
    moved = shift - log_many(aligned.shift[None])[0]
    right = (information @ aligned.own[..., None])[..., 0] - aligned.slopes[:, 6:]
    right -= aligned.blocks[:, 6:, :6] @ moved
    alone = solved(information, right[..., None])
    carried = adjoints(invert_many(aligned.poses))
    both = spread + inverse(information) + carried @ vague @ carried.transpose(0, 2, 1)
    return np.asarray(solved(np.asarray(np.linalg.cholesky(both)), alone)[..., 0])
