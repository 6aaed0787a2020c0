"""Which edges of the image are whose: the poses of all objects at once, and more hypotheses where that is not sure.

First all objects are aligned together, each within what its prediction leaves open, with the
camera's error as a common unknown. An object that this leaves without support, or that was
pulled farther than its prediction allows, is then looked for alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking.alignment import Aligned, Start, align, offsets_at
from hierax.nodes.tracking.appearance import NOTHING, measured, moved, of_mapping, recalled, remembered
from hierax.nodes.tracking.fusion import Fused, Prior, fuse
from hierax.nodes.tracking.geometry import Array, Floats
from hierax.nodes.tracking.profiles import EDGE_SLOTS, Controls, Image, gathered
from hierax.nodes.tracking.rigid import exp_many, inverse, invert_many, log_many
from hierax.nodes.tracking.searching import Found, Looking, in_turn, search_elsewhere
from hierax.nodes.tracking.stages import Search

_NEAR = Search()
_CALM = Search(reach_px=(8,), scale_px=((8.0, 1.0),), iterations=7)
_SEARCHED_AT_ONCE = 3
_SETTLED_M = 0.004
"""Where no object moves, and all are known better than this, the image is searched near by."""

_LEAST_FREEDOM = 0.3
"""Share of a push's motion that the search leaves open for an object at rest."""

_AT_REST = 0.1
_CLEARLY = 0.1
"""An object with that little unrest rests; by so much of its control points another explanation is clearly better."""

_LEAST_SHOWN = 10.0
"""An object of which fewer control points should be seen is not judged by the image."""

_CHANGE_PER_M = 50.0
_CHANGE_PER_RAD = 4.0
_MOST_CHANGE = 0.5

_FAMILIAR_UNREST = 0.3
_SURE_SEEN = 0.9
_LEARNED_UNREST = 0.1
_LEARNED_SCORE = 0.6


class Options(NamedTuple):
    """How far things go.

    Attributes:
        motion: (6, 6) covariance of an object's deviation from its prediction within a frame, when it is pushed.
        error_px: standard deviation of a control point, as if they erred independently.
        sure_score: an object that scores less is also looked for farther away.
        certain_score: so is one that was found again just now and scores less than this.
    """

    motion: Floats
    error_px: float
    sure_score: float
    certain_score: float = 0.95


class Estimate(NamedTuple):
    """One object after the image.

    Attributes:
        pose: camera_from_object.
        covariance: (6, 6) twist in the object's frame.
        unrest: how much of `Options.motion` its latest motion asks for.
        trend: see `hierax.nodes.tracking.fusion.Prior`.
        score: 0 to 1.
        shown: how many control points should have been seen.
        slots: what is remembered of its looks.
        vain: for how many images in a row it was looked for elsewhere and not found there.
        elsewhere: whether it was found there now.
    """

    pose: Floats
    covariance: Floats
    unrest: float
    trend: Floats
    score: float
    shown: float
    slots: Mapping[str, Any]
    vain: int
    elsewhere: bool


def associate(
    image: Image,
    objects: Sequence[Mapping[str, Any]],
    camera: Floats | None,
    intrinsics: Array,
    options: Options,
) -> tuple[Floats, list[Estimate]] | None:
    """The poses that explain an image.

    Args:
        image: of `hierax.nodes.tracking.profiles.smoothed`.
        objects: each with "pose" (predicted camera_from_object), "before" (where it would be if it
            had not moved), "covariance", "unrest", "probation", "controls", "slots", "vain" and "id".
        camera: (6, 6) inverse covariance of the camera's error; None where its pose is exact.
        intrinsics: (4,) fx, fy, cx, cy in pixels.
        options: how far things go.

    Returns:
        What the camera's error does to all poses (4, 4), and each object's estimate; None
        where nothing is expected in the image.
    """
    controls = gathered([item["controls"] for item in objects])
    slots = [of_mapping(item["slots"]) for item in objects]
    # The light on what moves changes.
    known = [part if item["unrest"] < _FAMILIAR_UNREST else NOTHING for part, item in zip(slots, objects, strict=True)]
    memory = recalled(known, controls, image.shape[2])
    predicted = np.stack([item["pose"] for item in objects])
    covariance = np.stack([item["covariance"] for item in objects])
    unrest = np.array([_with_motion(item) for item in objects])
    trend = np.array([item["trend"] for item in objects])
    prior = Prior(covariance, options.motion, unrest, trend, camera)
    free = prior._replace(unrest=np.maximum(prior.unrest, _LEAST_FREEDOM))
    start = Start(predicted, inverse(free.spread()), camera)
    calm = float(free.unrest.max()) <= _LEAST_FREEDOM and float(covariance[:, :3, :3].max()) < _SETTLED_M**2
    near = (_CALM if calm else _NEAR)._replace(noise_px=options.error_px)

    def aligned(information: Floats) -> Aligned | None:
        return align(image, controls, start._replace(information=information), intrinsics, memory, near)

    together = aligned(start.information)
    if together is None:
        return None
    together, fused = _unless_held(together, aligned, start.information, prior)
    shift = exp_many(fused.shift[None])[0]
    found = Found(
        shift @ predicted @ exp_many(fused.own),
        fused.covariance,
        together.scores,
        together.shown,
        together.gains,
        fused.unrest,
        fused.trend,
        np.zeros(len(objects), dtype=bool),
    )
    doubtful = [at for at, item in enumerate(objects) if _is_doubtful(found, at, item, options)]
    searched = sorted((at for at in doubtful if in_turn(objects[at])), key=lambda at: objects[at]["vain"])
    searched = sorted(searched[:_SEARCHED_AT_ONCE])
    if searched:
        looking = Looking(image, controls, memory, intrinsics, options.error_px)
        found = search_elsewhere(looking, objects, shift, found, searched, prior)
    learned = _learned(together, found, controls, slots, doubtful, intrinsics)
    vain = [item["vain"] + 1 if at in doubtful else max(0, item["vain"] - 1) for at, item in enumerate(objects)]
    vain = [0 if found.elsewhere[at] else count for at, count in enumerate(vain)]
    return shift, _estimates(found, learned, vain)


def _unless_held(
    free: Aligned, aligned: Callable[[Floats], Aligned | None], information: Floats, prior: Prior
) -> tuple[Aligned, Fused]:
    """What is surprising of an object at rest is only believed where resting explains the image clearly less well.

    Args:
        free: found with room for motion.
        aligned: does it again with another (m, 6, 6) information of the predictions.
        information: the one that leaves room.
        prior: what was known before.
    """
    fused = fuse(free, prior)
    held = (fused.unrest == 1.0) & (prior.unrest < _AT_REST)
    calm = inverse(prior.spread())
    for _ in range(2):  # all of them, then those alone of which resting explains enough
        tried = aligned(np.where(held[:, None, None], calm, information)) if held.any() else None
        if tried is None:
            return free, fused
        explained = held & (tried.gains >= free.gains - _CLEARLY * free.shown)
        if (explained == held).all():
            return tried, fuse(tried, prior, held)
        held = explained
    return free, fused


def _is_doubtful(found: Found, at: int, item: Mapping[str, Any], options: Options) -> bool:
    if found.shown[at] < _LEAST_SHOWN:
        return False
    enough = options.certain_score if item["probation"] else options.sure_score
    return bool(found.scores[at] < enough or (found.unrest[at] == 1.0 and item["unrest"] < 1.0))


def _with_motion(item: Mapping[str, Any]) -> float:
    """How much an object that moves may change its motion: the faster it is, the more."""
    motion = log_many(invert_many(item["before"][None]) @ item["pose"][None])[0]
    least = _CHANGE_PER_M * float(np.linalg.norm(motion[:3])) + _CHANGE_PER_RAD * float(np.linalg.norm(motion[3:]))
    return max(float(item["unrest"]), min(least, _MOST_CHANGE))


def _learned(
    together: Aligned,
    found: Found,
    controls: Controls,
    slots: list[dict[str, Any]],
    doubtful: list[int],
    intrinsics: Array,
) -> list[dict[str, Any]]:
    """What is remembered of the looks of those objects that are surely where they were expected."""
    lines, profiles, matches = together.lines, together.profiles, together.matches
    sure = matches.supported & (controls.visible[lines.rows] > _SURE_SEEN)
    offsets = offsets_at(together, controls, found.poses, intrinsics)
    learned = []
    for at, known in enumerate(slots):
        if at in doubtful or found.scores[at] < _LEARNED_SCORE:
            learned.append(known)
            continue
        chosen = np.nonzero(sure & (controls.owners[lines.rows] == at))[0]
        columns = matches.columns[chosen]
        colours = np.stack((profiles.inside[chosen, columns], profiles.outside[chosen, columns]), axis=1)
        known = remembered(known, controls, lines.rows[chosen], colours)
        if found.unrest[at] < _LEARNED_UNREST:
            known = measured(known, controls.slots[lines.rows[chosen], 0] // EDGE_SLOTS, offsets[chosen])
        else:
            known = moved(known)
        learned.append(known)
    return learned


def _estimates(found: Found, learned: list[dict[str, Any]], vain: list[int]) -> list[Estimate]:
    return [
        Estimate(
            found.poses[at],
            found.covariance[at],
            float(found.unrest[at]),
            found.trend[at],
            float(found.scores[at]),
            float(found.shown[at]),
            slots,
            vain[at],
            bool(found.elsewhere[at]),
        )
        for at, slots in enumerate(learned)
    ]
