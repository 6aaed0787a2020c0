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

FOUND = 0.9  # chance that an edge that nothing hides has a peak at all
_PEAK_PX = 0.6  # standard deviation of a peak
LEAST_CLUTTER = 0.02  # peaks a pixel: so many there may be where a profile shows none
# Points of one face look alike: standard deviation of their colours in grey levels, the share of them that do, and what
# they say together, by this exponent.
_PAINT, _PAINTED, _SAME = 10.0, 0.8, 0.05
_LEAST_VARIED = 30.0  # standard deviation of the colours of places anywhere, at least
ALIKE = 0.15  # control points of one edge err alike: what they say together counts by this exponent


def explains(aligned: Aligned) -> Floats:
    """(m,) nats by which each pose explains the image better than clutter does; where its edges are off as a whole
    counts against it by how unlikely that was, and how exactly it had to be fitted."""
    stage, matches, count = aligned.stage, aligned.matches, len(aligned.poses)
    owners = stage.controls.owners
    clutter = np.maximum(np.isfinite(stage.profiles.places).mean(axis=1), LEAST_CLUTTER)
    seen = FOUND * stage.controls.visible * stage.memory.apart
    near = np.exp(-0.5 * np.minimum(np.abs(matches.pixels) / _PEAK_PX, 9.0) ** 2) / (_PEAK_PX * np.sqrt(2.0 * np.pi))
    ratio = 1.0 - seen + seen / clutter * near * np.exp(-STRANGE_WEIGHT * matches.strange)
    first = stage.firsts
    off = aligned.off[first] / stage.spread
    held = np.bincount(stage.edges, weights=np.where(aligned.supported, seen, 0.0)) / _PEAK_PX**2
    fitted = 0.5 * off * off + 0.5 * np.log1p(stage.spread**2 * ALIKE * held)
    found: Floats = ALIKE * summed(owners, np.log(ratio), count) - summed(owners[first], fitted, count)
    return found


def painted(aligned: Aligned) -> Floats:
    """(m,) nats by which, at each pose, what lies beside the edges of one face looks alike, rather than as anything."""
    stage, count = aligned.stage, len(aligned.poses)
    controls, profiles = stage.controls, stage.profiles
    rows, reach = np.arange(len(controls.owners)), (profiles.places.shape[1] - 1) // 2
    found = np.isfinite(aligned.matches.pixels)
    places = np.where(found, profiles.places[rows, aligned.matches.columns], 0.0)
    places += np.where(found, aligned.matches.pixels, 0.0)  # where the poses put them
    columns = np.clip(np.rint(places), -reach, reach).astype(np.intp) + reach
    twice = np.nonzero(controls.creases)[0]
    which = np.concatenate((rows, twice))
    colours = np.concatenate((profiles.inside[rows, columns], profiles.outside[twice, columns[twice]]))
    patches = np.concatenate((controls.faces[:, 0], controls.faces[twice, 1])) + 1
    faces = np.unique(controls.owners[which] * (int(patches.max(initial=0)) + 1) + patches, return_inverse=True)[1]
    varied = max(_LEAST_VARIED, float(profiles.outside.std(axis=(0, 1)).mean()))
    nats = np.zeros(len(which))
    for face in range(int(faces.max(initial=-1)) + 1):
        own = np.nonzero(faces == face)[0]
        off = ((colours[own] - np.median(colours[own], axis=0)) ** 2).mean(axis=1)
        ratio = varied / _PAINT * np.exp(0.5 * np.minimum(off / varied**2, 9.0) - 0.5 * off / _PAINT**2)
        own_nats = np.log(_PAINTED * ratio + 1.0 - _PAINTED)
        nats[own] = own_nats * max(0.0, 1.0 - 4.0 / len(own))  # the face's own colour is not known before
    return _SAME * summed(controls.owners[which], controls.visible[which] * nats, count)
