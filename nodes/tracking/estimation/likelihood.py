"""How much better poses explain an image than clutter does: a log-likelihood ratio in nats.

Peaks of clutter are a Poisson process along the profile, of the density that this image has there. A control point is
seen with the chance that nothing hides it, and then found but for a few; so the ratio of what its profile shows is
``1 - v m + v m / λ · N(d; 0, σ²) · g`` (Isard & Blake, IJCV 1998): d is how far its peak is, g how familiar it looks.
"""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.estimation.stages import STRANGE_WEIGHT
from hierax.nodes.tracking.math.batched import summed
from hierax.nodes.tracking.math.geometry import Floats

_FOUND = 0.9  # chance that an edge that nothing hides has a peak at all
_PEAK_PX = 0.6  # standard deviation of a peak
_LEAST_CLUTTER = 0.02  # peaks a pixel: so many there may be where a profile shows none
_ALIKE = 0.15  # control points of one edge err alike: what they say together counts by this exponent


def explains(aligned: Aligned) -> Floats:
    """(m,) nats by which each pose explains the image better than clutter does; where its edges are off as a whole
    counts against it by how unlikely that was, and how exactly it had to be fitted."""
    stage, matches, count = aligned.stage, aligned.matches, len(aligned.poses)
    owners = stage.controls.owners
    clutter = np.maximum(np.isfinite(stage.profiles.places).mean(axis=1), _LEAST_CLUTTER)
    seen = _FOUND * stage.controls.visible * stage.memory.apart
    near = np.exp(-0.5 * np.minimum(np.abs(matches.pixels) / _PEAK_PX, 9.0) ** 2) / (_PEAK_PX * np.sqrt(2.0 * np.pi))
    ratio = 1.0 - seen + seen / clutter * near * np.exp(-STRANGE_WEIGHT * matches.strange)
    first = stage.firsts
    off = aligned.off[first] / stage.spread
    held = np.bincount(stage.edges, weights=np.where(aligned.supported, seen, 0.0)) / _PEAK_PX**2
    fitted = 0.5 * off * off + 0.5 * np.log1p(stage.spread**2 * _ALIKE * held)
    found: Floats = _ALIKE * summed(owners, np.log(ratio), count) - summed(owners[first], fitted, count)
    return found
