"""Which edges of the image are whose: the poses of all objects at once, and more hypotheses where that is not sure.

First all objects are aligned together, each within what its prediction leaves open, with the
camera's error as a common unknown. An object that this leaves without support, or that was
pulled farther than its prediction allows, is then looked for alone: from its prediction, from
where it was, farther along its motion, and from where most of its edges are found by a
shift; the explanation that most control points speak for wins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking.alignment import Aligned, Start, align, offsets_at
from hierax.nodes.tracking.appearance import Memory, measured, moved, of_mapping, recalled, remembered
from hierax.nodes.tracking.fusion import Prior, fuse
from hierax.nodes.tracking.geometry import Array, Floats
from hierax.nodes.tracking.profiles import EDGE_SLOTS, Controls, Image, gathered
from hierax.nodes.tracking.rigid import exp_many, inverse, invert_many, log_many
from hierax.nodes.tracking.stages import Search

_NEAR = Search()
_CALM = Search(reach_px=(8,), scale_px=((8.0, 1.0),), iterations=7)
_SETTLED_M = 0.004
"""Where no object moves, and all are known better than this, the image is searched near by."""

_FAR = Search(reach_px=(20, 10, 5), scale_px=((20.0, 10.0), (10.0, 4.0), (4.0, 1.0)), iterations=5)

_LEAST_FREEDOM = 0.3
"""Share of a push's motion that the search leaves open for an object at rest."""

_LEAST_SHOWN = 10.0
"""An object of which fewer control points should be seen is not judged by the image."""

_BETTER = 0.05
"""By so much of its control points another explanation must be better than the expected one."""

_FARTHER = (1.0, 0.0, 0.5, 1.5, 2.0)
_VAGUE_M = 0.015
_LEVER_M = 0.05
_GRID = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 7), np.linspace(-1.5, 1.5, 7)), axis=-1).reshape(-1, 2)
"""Of an object whose place is that uncertain, these many standard deviations are tried in two directions."""

_VAIN_AT_ONCE = 5
_VAIN_EVERY = 4
_CHANGE_PER_M = 50.0
_CHANGE_PER_RAD = 4.0
_MOST_CHANGE = 0.5

_UNLIKELIEST = 0.25
"""So large a share of the control points that support the expected explanation must speak for another one beyond
that, however unlikely it was before."""

_AROUND = np.random.default_rng(1).normal(size=(24, 6))

_SURE_SEEN = 0.9
_LEARNED_UNREST = 0.1
_LEARNED_SCORE = 0.6


class Options(NamedTuple):
    """How far things go.

    Attributes:
        motion: (6, 6) covariance of an object's deviation from its prediction within a frame, when it is pushed.
        error_px: standard deviation of a control point, as if they erred independently.
        sure_score: an object that scores less is also looked for farther away.
        usual_drop: so is one whose score is lower than usual by more than this.
    """

    motion: Floats
    error_px: float
    sure_score: float
    usual_drop: float = 0.12


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
    """

    pose: Floats
    covariance: Floats
    unrest: float
    trend: Floats
    score: float
    shown: float
    slots: Mapping[str, Any]
    vain: int


class _Found(NamedTuple):
    """Of each object: pose, covariance, score, points shown, how many of them speak for it, unrest, trend;
    whether it was found elsewhere."""

    poses: Floats
    covariance: Floats
    scores: Floats
    shown: Floats
    gains: Floats
    unrest: Floats
    trend: Floats
    better: NDArray[np.bool_]


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
            had not moved), "covariance", "unrest", "usual" (score), "controls", "slots", "vain" and "id".
        camera: (6, 6) inverse covariance of the camera's error; None where its pose is exact.
        intrinsics: (4,) fx, fy, cx, cy in pixels.
        options: how far things go.

    Returns:
        What the camera's error does to all poses (4, 4), and each object's estimate; None
        where nothing is expected in the image.
    """
    controls = gathered([item["controls"] for item in objects])
    slots = [of_mapping(item["slots"]) for item in objects]
    memory = recalled(slots, controls, image.shape[2])
    predicted = np.stack([item["pose"] for item in objects])
    covariance = np.stack([item["covariance"] for item in objects])
    unrest = np.array([_with_motion(item) for item in objects])
    trend = np.array([item["trend"] for item in objects])
    prior = Prior(covariance, options.motion, unrest, trend, camera)
    free = prior._replace(unrest=np.maximum(prior.unrest, _LEAST_FREEDOM))
    start = Start(predicted, inverse(free.spread()), camera)
    calm = float(free.unrest.max()) <= _LEAST_FREEDOM and float(covariance[:, :3, :3].max()) < _SETTLED_M**2
    near, far = (search._replace(noise_px=options.error_px) for search in (_CALM if calm else _NEAR, _FAR))
    together = align(image, controls, start, intrinsics, memory, near)
    if together is None:
        return None
    fused = fuse(together, prior)
    shift = exp_many(fused.shift[None])[0]
    found = _Found(
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
    if doubtful:
        found = _searched(image, controls, memory, objects, shift, found, doubtful, prior, intrinsics, far)
    learned = _learned(together, found, controls, slots, doubtful, intrinsics)
    vain = [item["vain"] + 1 if at in doubtful else 0 for at, item in enumerate(objects)]
    vain = [0 if found.better[at] else count for at, count in enumerate(vain)]
    return shift, _estimates(found, learned, vain)


def _is_doubtful(found: _Found, at: int, item: Mapping[str, Any], options: Options) -> bool:
    if found.shown[at] < _LEAST_SHOWN:
        return False
    enough = min(options.sure_score, item["usual"] - options.usual_drop)
    return bool(found.scores[at] < enough or (found.unrest[at] == 1.0 and item["unrest"] < 1.0))


def _searched(
    image: Image,
    controls: Controls,
    memory: Memory,
    objects: Sequence[Mapping[str, Any]],
    shift: Floats,
    found: _Found,
    doubtful: list[int],
    prior: Prior,
    intrinsics: Array,
    search: Search,
) -> _Found:
    """The same, with doubtful objects where they are best explained."""
    loose = prior._replace(unrest=np.ones(len(objects)))
    spread = loose.spread()
    tries: list[int] = []
    starts = []
    for at in doubtful:
        found_starts = _starts(objects[at], shift, spread[at], _in_turn(objects[at]))
        starts += found_starts
        tries += [at] * len(found_starts)
    several = controls.of(tries)
    rows = np.concatenate([np.nonzero(controls.owners == at)[0] for at in tries])
    recall = Memory(*(part[rows] for part in memory))
    start = Start(np.stack(starts), inverse(spread)[tries])
    aligned = align(image, several, start, intrinsics, recall, search)
    if aligned is None:
        return found
    poses, covariance, scores, _, gains, unrest, trend, better = (part.copy() for part in found)
    away = log_many(invert_many(shift @ np.stack([objects[at]["pose"] for at in tries])) @ aligned.poses)
    tight = inverse(prior.spread())[tries]
    squares = np.einsum("mi,mij,mj->m", away, tight, away)
    unlikely = np.minimum(0.5 * squares, _UNLIKELIEST * (found.scores * found.shown)[tries])
    worth = aligned.gains - unlikely
    for number, at in enumerate(tries):
        if worth[number] > gains[at] + _BETTER * found.shown[at]:
            poses[at], scores[at], gains[at] = aligned.poses[number], aligned.scores[number], worth[number]
            covariance[at] = inverse(start.information[number] + aligned.blocks[number, 6:, 6:])
            unrest[at], trend[at], better[at] = 1.0, 0.0, True
    return _Found(poses, covariance, scores, found.shown, gains, unrest, trend, better)


def _in_turn(item: Mapping[str, Any]) -> bool:
    """Whether it is searched for widely: at first always, later, when that was in vain, now and then."""
    vain = int(item["vain"])
    return vain < _VAIN_AT_ONCE or (vain + int(item["id"])) % _VAIN_EVERY == 0


def _starts(item: Mapping[str, Any], shift: Floats, spread: Floats, wide: bool) -> list[Floats]:
    """Where an object may be: on its way from where it was, and around where it was expected."""
    motion = log_many(invert_many(item["before"][None]) @ item["pose"][None])[0]
    moves = np.array([1.0] if np.linalg.norm(motion) < 1e-4 else _FARTHER)
    ways = [shift @ item["before"] @ way for way in exp_many(moves[:, None] * motion)]
    if not wide:
        return ways
    around = _AROUND @ np.linalg.cholesky(spread).T
    if float(np.trace(spread[:3, :3])) > _VAGUE_M**2:
        around = np.concatenate((around, _across(spread)))
    return ways + [shift @ item["pose"] @ near for near in exp_many(around)]


def _across(spread: Floats) -> Floats:
    """Twists (n, 6) on a grid along the two directions that are least certain."""
    scale = np.array([1.0] * 3 + [_LEVER_M] * 3)
    _, vectors = np.linalg.eigh(spread * np.outer(scale, scale))
    variances = np.einsum("ik,ij,jk->k", vectors, spread * np.outer(scale, scale), vectors)
    grid: Floats = _GRID @ (vectors * np.sqrt(np.maximum(variances, 0.0)))[:, -2:].T / scale
    return grid


def _with_motion(item: Mapping[str, Any]) -> float:
    """How much an object that moves may change its motion: the faster it is, the more."""
    motion = log_many(invert_many(item["before"][None]) @ item["pose"][None])[0]
    least = _CHANGE_PER_M * float(np.linalg.norm(motion[:3])) + _CHANGE_PER_RAD * float(np.linalg.norm(motion[3:]))
    return max(float(item["unrest"]), min(least, _MOST_CHANGE))


def _learned(
    together: Aligned,
    found: _Found,
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


def _estimates(found: _Found, learned: list[dict[str, Any]], vain: list[int]) -> list[Estimate]:
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
        )
        for at, slots in enumerate(learned)
    ]
