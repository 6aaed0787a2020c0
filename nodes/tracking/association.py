"""Which edges of the image are whose: the poses of all objects at once, and more hypotheses where that is not sure.

First all objects are aligned together, each within what its prediction leaves open, with the
camera's error as a common unknown. An object that this leaves without support, or that was
pulled farther than its prediction allows, is then looked for alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking import encoding
from hierax.nodes.tracking.alignment import Aligned, Start, align, offsets_at
from hierax.nodes.tracking.appearance import (
    Memory,
    measured,
    moved,
    of_mapping,
    only_found,
    recalled,
    remembered,
    sought,
)
from hierax.nodes.tracking.crowding import apartness
from hierax.nodes.tracking.fusion import SURPRISED, Fused, Prior, fuse
from hierax.nodes.tracking.geometry import Array, Floats
from hierax.nodes.tracking.profiles import EDGE_SLOTS, Controls, Image, gathered
from hierax.nodes.tracking.rigid import exp_many, inverse, invert_many, log_many, solved
from hierax.nodes.tracking.searching import Found, Looking, in_turn, search_elsewhere
from hierax.nodes.tracking.stages import NEAREST_M, Search

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

_JUMP_PX = 2.0
"""A camera's error that moves an object's origin by more is large."""

_CHANGE_PER_M = 50.0
_CHANGE_PER_RAD = 4.0
_MOST_CHANGE = 0.5

_FAMILIAR_UNREST = 0.3
_SURE_SEEN = 0.9
_LEARNED_UNREST = 0.1
_LEARNED_SCORE = 0.6
_FOUND_PX = 1.0


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
    slots = [of_mapping(item["slots"]) for item in objects]
    task = _task(image, objects, slots, camera, intrinsics, options)
    together = _aligned(task, task.start)
    if together is None:
        return None
    together, fused = _unless_held(together, task)
    together, fused = _once_more(together, fused, task, objects, options)
    shift = exp_many(fused.shift[None])[0]
    found = _found(together, fused, shift @ task.start.poses)
    doubtful = [at for at, item in enumerate(objects) if _is_doubtful(found, at, item, options)]
    searched = sorted((at for at in doubtful if in_turn(objects[at])), key=lambda at: objects[at]["vain"])
    searched = sorted(searched[:_SEARCHED_AT_ONCE])
    if searched:
        looking = Looking(image, task.controls, task.memory, intrinsics, options.error_px)
        found = _if_expected(search_elsewhere(looking, objects, shift, found, searched, task.prior), found, task, shift)
    learned = _learned(together, found, task, slots, doubtful)
    vain = [item["vain"] + 1 if at in doubtful else max(0, item["vain"] - 1) for at, item in enumerate(objects)]
    vain = [0 if found.elsewhere[at] else count for at, count in enumerate(vain)]
    return shift, _estimates(found, learned, vain)


class _Task(NamedTuple):
    """What is aligned: the image, the control points, what is remembered of them, where they are expected, how far the
    image is searched, what is known before it; and of light's encoding, the factor and its information."""

    image: Image
    controls: Controls
    memory: Memory
    intrinsics: Array
    start: Start
    search: Search
    prior: Prior
    encoding: tuple[float, float]


def _task(
    image: Image,
    objects: Sequence[Mapping[str, Any]],
    slots: list[dict[str, Any]],
    camera: Floats | None,
    intrinsics: Array,
    options: Options,
) -> _Task:
    controls = gathered([item["controls"] for item in objects])
    # The light on what moves changes.
    known = [
        part if item["unrest"] < _FAMILIAR_UNREST else only_found(part)
        for part, item in zip(slots, objects, strict=True)
    ]
    factor = encoding.believed([part["encoding"] for part in slots])
    predicted = np.stack([item["pose"] for item in objects])
    memory = recalled(known, controls, image.shape[2])
    memory = memory._replace(
        factor=np.full(len(controls.owners), factor[0], dtype=np.float32),
        apart=apartness(controls, predicted, intrinsics).astype(np.float32),
    )
    covariance = np.stack([item["covariance"] for item in objects])
    unrest = np.array([_with_motion(item) for item in objects])
    trend = np.array([item["trend"] for item in objects])
    prior = Prior(covariance, options.motion, unrest, trend, camera)
    free = prior._replace(unrest=np.maximum(prior.unrest, _LEAST_FREEDOM))
    calm = float(free.unrest.max()) <= _LEAST_FREEDOM and float(covariance[:, :3, :3].max()) < _SETTLED_M**2
    near = (_CALM if calm else _NEAR)._replace(noise_px=options.error_px)
    start = Start(predicted, inverse(free.spread()), camera)
    return _Task(image, controls, memory, intrinsics, start, near, prior, factor)


def _aligned(task: _Task, start: Start) -> Aligned | None:
    """What the image says of the poses, when light's encoding is not known better than it is."""
    found = align(task.image, task.controls, start, task.intrinsics, task.memory, task.search)
    if found is None:
        return None
    told = np.where(found.scores[:, None] < _LEARNED_SCORE, 0.0, found.told)
    blocks, slopes = encoding.allowed_for(found.tone, told, *task.encoding)
    return found._replace(blocks=found.blocks + blocks, slopes=found.slopes + slopes)


def _found(together: Aligned, fused: Fused, expected: Floats) -> Found:
    """What is found where objects are expected, the camera's error corrected."""
    return Found(
        expected @ exp_many(fused.own),
        fused.covariance,
        together.scores,
        together.shown,
        together.gains,
        fused.unrest,
        fused.trend,
        np.zeros(len(expected), dtype=bool),
    )


def _once_more(
    together: Aligned, fused: Fused, task: _Task, objects: Sequence[Mapping[str, Any]], options: Options
) -> tuple[Aligned, Fused]:
    """The same from where the camera's error puts the objects, when it is large and that leaves one in doubt.

    Far from its edges an object may have taken others; what the rest of them says of the camera brings it near.
    """
    shift = exp_many(fused.shift[None])[0]
    expected = shift @ task.start.poses
    if task.prior.camera is None:
        return together, fused
    found = _found(together, fused, expected)
    doubtful = [at for at, item in enumerate(objects) if _is_doubtful(found, at, item, options)]
    jumps = _flat(expected[doubtful]) - _flat(task.start.poses[doubtful])
    if np.abs(jumps * task.intrinsics[:2]).max(initial=0.0) < _JUMP_PX:
        return together, fused
    again = _aligned(task, task.start._replace(poses=expected))
    if again is None or (again.gains - together.gains)[doubtful].sum() <= 0.0:
        return together, fused
    return _unless_held(again._replace(shift=again.shift @ shift), task)


def _flat(poses: Floats) -> Floats:
    flat: Floats = poses[:, :2, 3] / np.maximum(poses[:, 2:3, 3], NEAREST_M)
    return flat


def _unless_held(free: Aligned, task: _Task) -> tuple[Aligned, Fused]:
    """What is surprising of an object at rest is only believed where resting explains the image clearly less well.

    Args:
        free: found with room for motion.
        task: to do it again.
    """
    prior = task.prior
    fused = fuse(free, prior)
    held = (fused.unrest == 1.0) & (prior.unrest < _AT_REST)
    calm = inverse(prior.spread())
    for _ in range(2):  # all of them, then those alone of which resting explains enough
        information = np.where(held[:, None, None], calm, task.start.information)
        tried = _aligned(task, task.start._replace(information=information)) if held.any() else None
        if tried is None:
            return free, fused
        explained = held & (tried.gains >= free.gains - _CLEARLY * free.shown)
        if (explained == held).all():
            return tried, fuse(tried, prior, held)
        held = explained
    return free, fused


def _if_expected(after: Found, before: Found, task: _Task, shift: Floats) -> Found:
    """What was found elsewhere, but no farther away than predictions err, did not move: it is averaged as ever."""
    spread = task.prior.spread()
    expected = shift @ task.start.poses
    away = log_many(invert_many(expected) @ after.poses)
    both = spread + after.covariance
    squares = np.einsum("mi,mi->m", away, solved(both, away[..., None])[..., 0])
    same = after.elsewhere & (squares < 6.0 * SURPRISED**2)
    if not same.any():
        return after
    known, seen = inverse(spread), inverse(after.covariance)
    covariance = inverse(known + seen)
    own = (covariance @ (seen @ away[..., None]))[..., 0]
    return after._replace(
        poses=np.where(same[:, None, None], expected @ exp_many(own), after.poses),
        covariance=np.where(same[:, None, None], covariance, after.covariance),
        unrest=np.where(same, task.prior.unrest, after.unrest),
        trend=np.where(same[:, None], before.trend, after.trend),
        elsewhere=after.elsewhere & ~same,
    )


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
    task: _Task,
    slots: list[dict[str, Any]],
    doubtful: list[int],
) -> list[dict[str, Any]]:
    """What is remembered of the looks of those objects that are surely where they were expected."""
    controls, lines, profiles, matches = task.controls, together.lines, together.profiles, together.matches
    seen = controls.visible[lines.rows] > _SURE_SEEN
    sure = matches.supported & seen
    offsets = offsets_at(together, controls, found.poses, task.intrinsics)
    learned = []
    for at, known in enumerate(slots):
        if at in doubtful or found.scores[at] < _LEARNED_SCORE:
            learned.append(known)
            continue
        chosen = np.nonzero(sure & (controls.owners[lines.rows] == at))[0]
        every = np.nonzero(seen & (controls.owners[lines.rows] == at))[0]
        near = sure[every] & (np.abs(offsets[every]) < _FOUND_PX)
        known = sought(known, controls.slots[lines.rows[every], 0], near)
        columns = matches.columns[chosen]
        colours = np.stack((profiles.inside[chosen, columns], profiles.outside[chosen, columns]), axis=1)
        known = remembered(known, controls, lines.rows[chosen], colours)
        if found.unrest[at] < _LEARNED_UNREST:
            known = measured(known, controls.slots[lines.rows[chosen], 0] // EDGE_SLOTS, offsets[chosen])
        else:
            known = moved(known)
        learned.append(
            {**known, "encoding": encoding.remembered(known["encoding"], together.told[at], task.encoding[0])}
        )
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
