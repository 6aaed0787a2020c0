"""What of the camera's error lasts, and how it goes together with the objects' errors.

A camera's reported pose has an error that is drawn anew in each image, and one that lasts, its drift. Where the camera
is over the table only reports tell; where objects are, the image tells with regard to the camera. So who has the camera
too high has everything too far away, and no single image says which of it is wrong: each would have the camera follow
its report, and objects with it. Hence the covariance of all of them together is kept, as in simultaneous localisation
and mapping (Smith, Self and Cheeseman, 1990).

Of a camera that is carried about by hand nothing says how far its drift goes in the end: it is a random walk. One on an
arm is where joints say, but for so much: there it is a first-order Gauss-Markov process, which forgets. Else whatever
most objects do together at once, as a tower that somebody pushes, would be the camera's drift, once that had time to
become uncertain."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.fusion import Rows
from hierax.nodes.tracking.estimation.sizes import Sizes, by_tolerances, expected_sizes, places_in, size_row
from hierax.nodes.tracking.imagery.alternatives import at_rest
from hierax.nodes.tracking.math.batched import inverse
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.model.controls import Indices
from hierax.nodes.tracking.schema import Together, TrackedObject


def lasting(report: float, drift: float | None) -> float:
    """Which share of a drift is left in the next image.

    Args:
        report: standard deviation of the error that is drawn anew in each image, in metres or radians.
        drift: of the drift, in the long run, in the same unit; None: nothing bounds it.

    Raises ValueError: the drift changes by more than that from one image to the next.
    """
    if drift is None:
        return 1.0
    change = const.DRIFTS * report
    if not change < drift < math.inf:
        raise ValueError(f"a drift of {drift}; expected more than {change:g}, by which it changes from image to image")
    return math.sqrt(1.0 - (change / drift) ** 2)


def joint_of(
    objects: Sequence[TrackedObject],
    together: Together | None,
    reports: Floats,
    sizes: float = const.SIZES,
    lasts: Floats | float = 1.0,
    learned: Sizes | None = None,
) -> Floats:
    """`hierax.nodes.tracking.estimation.fusion.Prior.joint` of the objects.

    Args:
        together: what is known since the image before; None: nothing.
        reports: (6, 6) covariance of the error that is drawn anew in each image.
        sizes: how large what has an exact model may be beside it, as a share.
        lasts: (6,) which share of the drift is left since the image before, along and about each axis, or in all.
        learned: of objects' sizes, up to the image before; None: nothing.
    """
    whole = _continued(objects, together, sizes, 1.0 if learned is None else learned.alike)
    if learned is not None:
        rows = [size_row(at) for at in range(len(objects))]
        whole[rows, rows] += learned.looser
    whole[Rows.drift] *= np.reshape(lasts, (-1, 1))
    whole[:, Rows.drift] *= lasts
    whole[Rows.drift, Rows.drift] += const.DRIFTS**2 * reports
    for at, item in enumerate(objects):
        if item["stands"]:
            whole = at_rest(whole, _pose(at), item["support"])
    rows = np.r_[Rows.drift, : len(whole)]  # an image's error is the drift, and what it has of its own
    joint = whole[np.ix_(rows, rows)]
    joint[Rows.error, Rows.error] += reports
    return np.asarray(joint)


def loosened(joint: Floats, objects: Sequence[TrackedObject], tolerances: Mapping[int, float]) -> Floats:
    """A joint covariance of some objects where some models, by their index, turn out to be as imprecise as that, in
    metres."""
    rows, after = np.r_[Rows.sizes(len(objects))][list(tolerances)], np.array(joint)
    more = by_tolerances([objects[at] for at in tolerances], list(tolerances.values()))
    after[np.ix_(rows, rows)] += more.covariance(1.0)
    return after


def together_of(objects: Sequence[TrackedObject], kept: Sequence[int], joint: Floats | None) -> Together | None:
    """What is known after an image; kept: which objects are in the end where that has them, joint: as
    `hierax.nodes.tracking.estimation.fusion.Fused` has it."""
    if joint is None:
        return None
    rows = np.r_[_rows(kept), 6 + 7 * len(objects) : len(joint)]
    ids = np.array([objects[at]["id"] for at in kept], dtype=np.int64)
    return {"ids": ids, "covariance": joint[np.ix_(rows, rows)]}


def _rows(places: Sequence[int]) -> Indices:
    """Where the drift, and these objects, stand in a covariance of the drift and of objects."""
    return np.concatenate([np.arange(6), *(np.arange(7) + 7 * at + 6 for at in places)])


def _continued(objects: Sequence[TrackedObject], together: Together | None, sizes: float, alike: float) -> Floats:
    """(6 + 7 m, 6 + 7 m) covariance of the drift and of the objects, and of the camera in an older image (6 more),
    where there is one; what nothing was known of goes with nothing."""
    before = 0 if together is None else len(together["covariance"])
    older = 0 if together is None else before - 6 - 7 * len(together["ids"])
    size = 6 + 7 * len(objects) + older
    whole = np.zeros((size, size))
    for at, item in enumerate(objects):
        whole[_pose(at), _pose(at)] = item["covariance"]
    expected = expected_sizes(objects, sizes).covariance(alike)
    places = places_in(together, objects)
    if together is not None:
        here = np.r_[_rows(list(places)), size - older : size]
        there = np.r_[_rows(list(places.values())), before - older : before]
        whole[np.ix_(here, here)] = together["covariance"][np.ix_(there, there)]
    return _with_new_sizes(whole, expected, list(places))


def _with_new_sizes(whole: Floats, expected: Floats, known: Sequence[int]) -> Floats:
    """The same with sizes of the objects that are not known, of which these tell what all have in common; expected:
    (m, m) covariance of all sizes before anything is known."""
    new = [at for at in range(len(expected)) if at not in known]
    rows, seen = [size_row(at) for at in new], [size_row(at) for at in known]
    among, between = np.ix_(rows, rows), expected[np.ix_(new, known)]
    told = between @ inverse(expected[np.ix_(known, known)]) if known else np.zeros((len(new), 0))
    whole[rows] = told @ whole[seen]
    whole[:, rows] = whole[rows].T
    whole[among] = expected[np.ix_(new, new)] - told @ between.T + told @ whole[np.ix_(seen, seen)] @ told.T
    return whole


def _pose(at: int) -> slice:
    return slice(7 * at + 6, 7 * at + 12)
