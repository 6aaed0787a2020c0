"""How much better poses explain an image than clutter does: a log-likelihood ratio in nats.

Peaks of clutter are a Poisson process along the profile, of the density that this image has there. A control point is
seen with the chance that nothing hides it, and then found but for a few; so the ratio of what its profile shows is
``1 - v m + v m / λ · N(d; 0, σ²) · g`` (Isard & Blake, IJCV 1998): d is how far its peak is, g how familiar it looks.
"""

from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.math.batched import summed
from hierax.nodes.tracking.math.geometry import Floats


class Shares(NamedTuple):
    """Nats by which poses explain an image better than clutter does, by where they come from; together `explains`."""

    peaks: Floats  # (n,) of each line: where its peak is, or that it has none
    looks: Floats  # (n,) of each line: that its peak looks strange
    wholes: Floats  # (e,) of each edge: that it is off as a whole


def explains(aligned: Aligned) -> Floats:
    """(m,) nats by which each pose explains the image better than clutter does; where its edges are off as a whole
    counts against it by how unlikely that was, and how exactly it had to be fitted."""
    stage, count = aligned.stage, len(aligned.poses)
    owners = stage.controls.owners
    said = _said(aligned, np.exp(-const.STRANGE_WEIGHT * aligned.matches.strange))
    wholes = _wholes(aligned, const.ALIKE * said)
    return np.asarray(const.ALIKE * summed(owners, said, count) + summed(owners[stage.firsts], wholes, count))


def shares(aligned: Aligned) -> Shares:
    """The same by line and by edge."""
    peaks = const.ALIKE * _said(aligned, 1.0)
    said = const.ALIKE * _said(aligned, np.exp(-const.STRANGE_WEIGHT * aligned.matches.strange))
    return Shares(peaks, said - peaks, _wholes(aligned, said))


def expected(aligned: Aligned) -> Floats:
    """(n,) of each line the chance that its edge is seen, if the pose is right."""
    return np.asarray(const.FOUND * aligned.stage.controls.visible * aligned.stage.memory.apart)


def _said(aligned: Aligned, familiar: Floats | float) -> Floats:
    """(n,) of each line the logarithm of the ratio."""
    clutter = np.maximum(np.isfinite(aligned.stage.profiles.places).mean(axis=1), const.LEAST_CLUTTER)
    seen, away = expected(aligned), np.abs(aligned.matches.pixels) / const.PEAK_PX
    near = np.exp(-0.5 * np.minimum(away, 9.0) ** 2) / (const.PEAK_PX * np.sqrt(2.0 * np.pi))
    return np.asarray(np.log(1.0 - seen + seen / clutter * near * familiar))


def _wholes(aligned: Aligned, said: Floats) -> Floats:
    """(e,) nats that it costs that each edge is off as a whole; said: (n,) of each line. Of an imprecise model an edge
    may be missing, too: then it says neither."""
    stage = aligned.stage
    off = aligned.off[stage.firsts] / stage.spread
    held = np.bincount(stage.edges, weights=np.where(aligned.supported, expected(aligned), 0.0)) / const.PEAK_PX**2
    costs = 0.5 * off * off + 0.5 * np.log1p(stage.spread**2 * const.ALIKE * held)
    if not stage.loose.any():
        return np.asarray(-costs)
    lines = np.bincount(stage.edges, weights=said)
    there = np.logaddexp(np.log(const.FOUND) + lines - costs, np.log(1.0 - const.FOUND))
    return np.asarray(np.where(stage.loose, there - lines, -costs))
