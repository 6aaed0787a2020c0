"""How large objects are beside their models: what is larger looks as if it were nearer.

Where an object stands tells its size, as far as it is known where the camera is, and its size how far away the camera
is. Sizes are off in part for reasons that all objects of a scene have in common: light and blur, and that what is worn
is smaller. So many objects do not tell the camera's height as certainly as if each of them erred for itself."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.batched import inverse
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import TRACKED, Together, TrackedObject


class Expected(NamedTuple):
    """How far sizes are from models', as squares of shares."""

    own: Floats  # (m,) variance of what each has of its own
    common: Floats  # (m, m) covariance of what all have in common: light, blur, and that what is worn is smaller

    def covariance(self, alike: float) -> Floats:
        return np.asarray(alike**2 * np.diag(self.own) + self.common)


class Sizes(NamedTuple):
    """What objects' sizes are beside their models', as all of them together tell."""

    told: tuple[Floats, Floats]  # `hierax.nodes.tracking.estimation.fusion.Prior.sizes`
    looser: Floats  # (m,) by how much less is known of each than it was, variance
    alike: float  # by how much less they differ than expected, as a share


def sizes_of(
    objects: Sequence[TrackedObject], together: Together | None, alike: float, sizes: float = const.SIZES
) -> Sizes:
    """How far sizes are from models' is learned from all objects: where those that stand on one table seem as large
    beside one another as their models are, models are exact, but for what all of them have in common. One step of
    expectation maximisation (Dempster, Laird and Rubin, 1977) an image.

    Args:
        together: what is known since the image before; None: nothing.
        sizes: how large what has an exact model may be beside it, as a share.
        alike: what was learned up to the image before.
    """
    information, which = np.zeros((len(objects), len(objects))), np.zeros(len(objects))
    looser = np.zeros(len(objects))
    places = places_in(together, objects)
    if together is None or not places:
        return Sizes((information, which), looser, alike)
    known = list(places)
    expected = expected_sizes([objects[at] for at in known], sizes)
    off = np.array([objects[at]["slots"]["size"] - 1.0 for at in known])
    rows = [size_row(place) for place in places.values()]
    covariance = together["covariance"][np.ix_(rows, rows)]
    before, own = inverse(expected.covariance(alike)), np.diag(alike**2 * expected.own)
    gain = own @ before  # of what an object is off, what it has of its own
    squares = (gain @ off) ** 2 + np.diag(gain @ covariance @ gain.T + own - gain @ own)
    # As if one more were as far off as expected.
    learned = math.sqrt((1.0 + (squares / expected.own).sum()) / (1.0 + len(known)))
    if learned < alike:
        information[np.ix_(known, known)] = inverse(expected.covariance(learned)) - before
        which[known] = -off / (1.0 + off)
    else:  # what was told before is not to be taken away: more than is known there may be of what is new
        looser[known] = (learned**2 - alike**2) * expected.own
    return Sizes((information, which), looser, learned)


def expected_sizes(objects: Sequence[TrackedObject], exact: float) -> Expected:
    """How far sizes of objects are expected to be from their models'; exact: standard deviation where these are."""
    more = by_tolerances(objects, at_least_usual([item["slots"]["tolerance"] or 0.0 for item in objects]))
    together = const.SIZES_TOGETHER if exact != const.SAME_SIZE else 0.0
    return Expected((1.0 - together) * exact**2 + more.own, together * exact**2 + more.common)


def at_least_usual(tolerances: Sequence[float]) -> list[float]:
    """How imprecise models are in what no edge tells alone, by what edges tell: where most of a scene's models are
    imprecise, one whose edges are where they should be beside one another may still be of another size."""
    usual = float(np.median(tolerances)) if len(tolerances) else 0.0
    return [max(each, usual) for each in tolerances]


def by_tolerances(objects: Sequence[TrackedObject], tolerances: Sequence[float]) -> Expected:
    """What comes to that of objects whose models are as imprecise as that, in metres."""
    more = np.array([_imprecision(*each) for each in zip(objects, tolerances, strict=True)])
    return Expected((1.0 - const.WORN_TOGETHER) * more**2, const.WORN_TOGETHER * np.outer(more, more))


def places_in(together: Together | None, objects: Sequence[TrackedObject]) -> dict[int, int]:
    """By the index of those that are tracked and known of since the image before, their place in what is known."""
    places = {} if together is None else {number: place for place, number in enumerate(together["ids"].tolist())}
    known = (at for at, item in enumerate(objects) if item["status"] == TRACKED and item["id"] in places)
    return {at: places[objects[at]["id"]] for at in known}


def size_row(at: int) -> int:
    """Where the size of one of the objects stands in a covariance of the drift and of objects."""
    return 7 * at + 12


def _imprecision(item: TrackedObject, tolerance: float) -> float:
    """How much less is known of how large an object is because its model is as imprecise as that, as a share."""
    points = item["controls"]["points"]
    if not tolerance or not len(points):
        return 0.0
    return tolerance / math.sqrt(float((points * points).sum(axis=1).max()))
