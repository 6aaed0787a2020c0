"""What objects looked like beside their edges: a memory of colours that tells an object's edge from a shadow's.

For each side of each edge where the object is (a face, always lit alike while the object is at rest) the colour beside
the matched place is remembered. A peak with another colour on that side is strange: probably an edge of something else.
"""

from typing import Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.profiles import Profiles, Singles
from hierax.nodes.tracking.math.batched import found_among
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.controls import EDGE_SLOTS, Controls, Indices
from hierax.nodes.tracking.schema import Looks

NOTHING: Looks = {
    "keys": np.zeros(0, dtype=np.int64),
    "colours": np.zeros((0, 1), dtype=np.float32),
    "spread": np.zeros(0, dtype=np.float32),
    "weights": np.zeros(0, dtype=np.float32),
    "edges": np.zeros(0, dtype=np.int64),
    "offsets": np.zeros((0, 2), dtype=np.float32),
    "parts": np.zeros(0, dtype=np.int64),
    "hits": np.zeros((0, 2), dtype=np.float32),
    "tolerance": None,
    "size": 1.0,
    "judged": 0,
    "bent": np.zeros(0, dtype=np.int64),
    "bends": np.zeros((0, 3)),
    "slack": np.zeros((0, 3, 3)),
    "dye": np.zeros(0, dtype=np.float32),
    "dyed": 0.0,
}

_LASTING: Final = ("tolerance", "size", "bent", "bends", "slack", "parts", "hits", "dye", "dyed")


class Memory(NamedTuple):
    """What is remembered beside each control point."""

    colours: Singles  # (n, 2, channels) inside and outside; any where nothing is remembered
    precision: Singles  # (n, 2) 1/variance; 0 where nothing is remembered or the object is not on that side
    trust: Singles  # (n,) 0 to 1, less on edges that are off in image after image: shadows at an object's foot, mostly
    apart: Singles  # (n,) 0 to 1, how far the edge stands alone, see `hierax.nodes.tracking.estimation.joint_alignment`
    # (n, 3, 3) covariance of where its edge is beside the model's, m², see `hierax.nodes.tracking.estimation.bending`
    slack: Floats


def recalled(objects: list[Looks], controls: Controls, channels: int) -> Memory:
    """The memory of all objects (by their index), laid beside the control points."""
    count = len(controls.owners)
    colours = np.zeros((count, 2, channels), dtype=np.float32)
    precision = np.zeros((count, 2), dtype=np.float32)
    trust = np.ones(count, dtype=np.float32)
    ends = np.searchsorted(controls.owners, np.arange(len(objects) + 1))
    places, creases = controls.slots, controls.creases
    for at, slots in enumerate(objects):
        keys, view = slots["keys"], slice(ends[at], ends[at + 1])
        wanted = places[view]
        trust[view] = _trust(slots, wanted[:, 0])
        if not len(keys) or slots["colours"].shape[1] != channels:
            continue
        known, place = found_among(keys, wanted)
        known &= slots["weights"][place] >= const.FIRST_WEIGHT
        known[:, 1] &= creases[view]
        colours[view] = slots["colours"][place]
        precision[view] = np.where(known, 1.0 / (const.LEAST_SPREAD + slots["spread"][place]), 0.0)
    return Memory(colours, precision, trust, np.ones(count, dtype=np.float32), np.zeros((count, 3, 3)))


def _trust(slots: Looks, parts: NDArray[np.int64]) -> Singles:
    """(n,) of parts of edges, by how far their edges are off, and in what share of images, as if in one more, they were
    found: where an object has no contrast of its own, what is found in the end belongs to something else."""
    offset, frames = _kept(slots["edges"], slots["offsets"], parts // EDGE_SLOTS)
    part = offset * np.minimum(frames / np.float32(const.LOOKS_FRAMES), np.float32(1.0)) / np.float32(const.WHOLE_PX)
    found, sought = _kept(slots["parts"], slots["hits"], parts)
    return np.asarray(1.0 / (1.0 + part * part) * ((found + 1.0) / (sought + 1.0)) ** const.DOUBT)


def _kept(known: NDArray[np.int64], values: Singles, wanted: NDArray[np.int64]) -> Singles:
    """(2, n) what is kept under the wanted numbers; zeros of those that are not known."""
    if not len(known):
        return np.zeros((2, len(wanted)), dtype=np.float32)
    there, place = found_among(known, wanted)
    return np.asarray(np.where(there, values[place].T, np.float32(0.0)))


def _laid_out(
    known: NDArray[np.int64], found: NDArray[np.int64], *kept: Singles
) -> tuple[NDArray[np.int64], NDArray[np.intp], list[Floats]]:
    """All numbers, ascending; where the found ones are among them; and at each what was kept, zeros of new ones."""
    every = np.union1d(known, found)
    before = np.searchsorted(every, known)
    laid = [np.zeros((len(every), *values.shape[1:])) for values in kept]
    for new, values in zip(laid, kept, strict=True):
        new[before] = values
    return every, np.searchsorted(every, found), laid


def sought(slots: Looks, parts: NDArray[np.int64], found: NDArray[np.bool_]) -> Looks:
    """What is remembered of the parts of edges after an image; parts: (n,) numbers of those that one object's control
    points are on, of which surely nothing hides them; found: (n,) which of them were."""
    if not len(parts):
        return slots
    now, place = np.unique(parts, return_inverse=True)
    share = np.bincount(place, weights=found) / np.bincount(place)
    every, at, (hits,) = _laid_out(slots["parts"], now, slots["hits"])
    hits[at] = (1.0 - 1.0 / const.LOOKS_FRAMES) * hits[at] + np.stack((share, np.ones(len(now))), axis=1)
    return {**slots, "parts": every, "hits": hits.astype(np.float32)}


def only_found(slots: Looks) -> Looks:
    """What is remembered of an object in another light, or in another place, where it may be another of the sides that
    look alike that is seen: where its edges are, which parts of them are found, and what colours it has."""
    kept = {name: slots[name] for name in _LASTING}
    return cast(Looks, {**NOTHING, **kept})


def measured(slots: Looks, edges: NDArray[np.int64], offsets: Floats) -> Looks:
    """What is remembered of the edges after an image; edges: (n,) numbers of those that one object's matched control
    points are on; offsets: (n,) pixels from where the corrected pose puts each to where it was found."""
    if not len(edges):
        return slots
    found, place = np.unique(edges, return_inverse=True)
    mean = np.bincount(place, weights=offsets) / np.bincount(place)
    every, now, (kept,) = _laid_out(slots["edges"], found, slots["offsets"])
    kept[now, 1] = np.minimum(kept[now, 1] + 1.0, const.OFFSET_FRAMES)
    kept[now, 0] += (mean - kept[now, 0]) / kept[now, 1]
    return {**slots, "edges": every, "offsets": kept.astype(np.float32)}


def strangeness(memory: Memory, profiles: Profiles) -> Singles:
    """(n, k): how far each peak's surroundings are from what is remembered, in variances of a channel, bounded."""
    precision = memory.precision
    total = np.zeros(profiles.places.shape, dtype=np.float32)
    for side, colours in ((0, profiles.inside), (1, profiles.outside)):
        known = np.nonzero(precision[:, side] > 0)[0]
        if len(known):
            off = colours[known] - memory.colours[known, side][:, None, :]
            square = np.einsum("pkc,pkc->pk", off, off) / np.float32(off.shape[2])
            total[known] += np.minimum(square * precision[known, side][:, None], np.float32(const.MOST_STRANGE))
    # Where all look strange, the light has changed: then that says little.
    usual = np.where(np.isfinite(profiles.places), total, np.float32(np.inf)).min(axis=1)
    return np.asarray(np.maximum(total - np.minimum(usual, np.float32(const.FORGIVEN))[:, None], np.float32(0.0)))


def moved(slots: Looks) -> Looks:
    """What is remembered of an object that moved: its shadows move, too, and the light on its sides changes."""
    offsets = slots["offsets"] * np.array([1.0, const.FADING], dtype=np.float32)
    return {**slots, "offsets": offsets, "weights": slots["weights"] * np.float32(const.FADING)}


def remembered(slots: Looks, controls: Controls, rows: Indices, colours: Singles) -> Looks:
    """What is remembered after an image; controls: of all objects; rows: of one object's that were matched and are
    surely seen; colours: (n, 2, channels) inside and outside of each."""
    used = np.stack((np.ones(len(rows), dtype=bool), controls.creases[rows]), axis=1)
    keys = controls.slots[rows][used]
    if not len(keys):
        return slots
    values = colours[used].astype(np.float64)
    found, place = np.unique(keys, return_inverse=True)
    count = np.bincount(place)
    channels = values.shape[1]
    mean = np.stack([np.bincount(place, weights=values[:, at]) for at in range(channels)], axis=1) / count[:, None]
    square = np.bincount(place, weights=((values - mean[place]) ** 2).mean(axis=1)) / count
    old = slots
    if slots["colours"].shape[1] != channels:
        old = {**NOTHING, "colours": np.zeros((0, channels), dtype=np.float32)}
    every, now, (weights, kept, spread) = _laid_out(old["keys"], found, old["weights"], old["colours"], old["spread"])
    gain = 1.0 / np.minimum(weights[now] + 1.0, const.LOOKS_FRAMES)
    off: Floats = mean - kept[now]
    off[weights[now] == 0] = 0.0
    change = (off * off).mean(axis=1)
    kept[now] = np.where(weights[now, None] == 0, mean, kept[now] + gain[:, None] * off)
    spread[now] += gain * (square + change - spread[now])
    weights[now] += 1.0
    return {
        **slots,
        "keys": every,
        "colours": kept.astype(np.float32),
        "spread": spread.astype(np.float32),
        "weights": np.minimum(weights, const.LOOKS_FRAMES).astype(np.float32),
    }
