"""Which edges of the image are whose: the poses of all objects at once, and more hypotheses where that is not sure.

First all objects are aligned together, each within what its prediction leaves open, with the
camera's error as a common unknown. An object that this leaves without support, or that was
pulled farther than its prediction allows, is then looked for alone."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import offsets_at
from hierax.nodes.tracking.estimation.appearance import measured, moved, remembered, sought
from hierax.nodes.tracking.estimation.bending import bent_after
from hierax.nodes.tracking.estimation.certainty import right
from hierax.nodes.tracking.estimation.drift import together_of
from hierax.nodes.tracking.estimation.fusion import Known, Prior
from hierax.nodes.tracking.estimation.joint_alignment import (
    Explained,
    Task,
    explained,
    explained_again,
    prior_of,
    task_of,
)
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.palette import coloured, dyed, with_colours
from hierax.nodes.tracking.estimation.profiles import Image
from hierax.nodes.tracking.estimation.tracked import motion_of
from hierax.nodes.tracking.math.batched import exp_many, inverse, invert_many, log_many, solved
from hierax.nodes.tracking.math.geometry import NO_POSES, Array, Floats
from hierax.nodes.tracking.model.controls import EDGE_SLOTS
from hierax.nodes.tracking.model.symmetry import NONE, alike, kept_free, moved_along
from hierax.nodes.tracking.schema import Looks, Together, TrackedObject
from hierax.nodes.tracking.search.imprecision import explained_with, looks_after, models_judged
from hierax.nodes.tracking.search.multistart import Found, Looking, in_turn
from hierax.nodes.tracking.search.reacquisition import look_elsewhere


class Options(NamedTuple):
    """How far things go."""

    # (6, 6) covariance of an object's deviation from its prediction within a frame, when it is pushed; or (m, 6, 6), of
    # each
    motion: Floats
    sure_score: float  # an object that scores less is also looked for farther away
    # So is one that was found again just now, or that something has happened to, and that scores less than this.
    certain_score: float = const.CERTAIN_SCORE
    falling: Floats | None = None  # as `motion`, falling over included; None: the same
    # standard deviation of where edges are beside their models', m; None: each model's is learned
    tolerance: float | None = None


class Estimate(NamedTuple):
    """One object after the image."""

    pose: Floats  # camera_from_object
    covariance: Floats  # (6, 6) twist in the object's frame
    motion_scale: float  # how much of `Options.motion` its latest motion asks for
    trend: Floats  # see `hierax.nodes.tracking.estimation.fusion.Prior`
    score: float  # 0 to 1
    shown: float  # how many control points should have been seen
    nats: float  # by how much it explains the image better than clutter does
    colours: float  # nats of these that are said by what colours it has there
    probability: float  # that the pose is right, see `hierax.nodes.tracking.estimation.certainty`
    slots: Looks  # what is remembered of its looks
    failed_searches: int  # for how many images in a row it was looked for elsewhere and not found there
    elsewhere: bool  # whether it was found there now
    sure: bool  # false where another pose explains the image nearly as well
    guesses: Floats  # (n, 4, 4) the poses that explain the image best besides


class Associated(NamedTuple):
    """All objects and the camera after the image."""

    shift: Floats  # (4, 4) what the camera's error does to all poses
    drift: Floats  # (6,) what is left of that in the next image, twist in its frame
    estimates: list[Estimate]  # of each object
    together: Together | None  # how errors go together, in the next image
    older: Floats  # (6,) error of the camera in an older image beside what was expected, twist in its frame


def associate(
    image: Image, objects: Sequence[TrackedObject], known: Known | None, intrinsics: Array, options: Options
) -> Associated | None:
    """The poses that explain an image.

    Args:
        image: of `hierax.nodes.tracking.estimation.profiles.smoothed`.
        objects: each with "pose" (predicted camera_from_object), "before" (where it would be if it
            had not moved), "covariance", "motion_scale", "probation", "controls", "slots", "failed_searches" and "id".
        known: of the camera's error and the objects' together; None where the camera's pose is exact.
        intrinsics: (4,) fx, fy, cx, cy in pixels; options: how far things go.

    Returns:
        None where nothing is expected in the image.
    """
    prior = prior_of(objects, options.motion, known)
    task = task_of(image, objects, prior, intrinsics)
    best = explained(task)
    if best is None:
        return None
    found = _found(best, task)
    doubtful = _doubtful(found, objects, options)
    again = explained_again(task, best, doubtful)
    if again is not None:
        best, found = again, _found(again, task)
        doubtful = _doubtful(found, objects, options)
    verdicts = models_judged(task, best, objects, found, options.tolerance)
    loosely = explained_with(task, best, verdicts, objects)
    if loosely is not None:
        best, found = loosely, _found(loosely, task)
        for at, verdict in verdicts.items():
            if verdict is not None:
                found.colours[at] = dyed(verdict.aligned, task.palette, [at] * len(verdict.aligned.poses))[verdict.at]
                found.nats[at] = verdict.nats + found.colours[at]
        doubtful = _doubtful(found, objects, options)
    judged = looks_after(verdicts, objects, intrinsics)
    shift, fused = exp_many(best.fused.shift[None])[0], found.poses
    # After an image with many starts about where an object was, which takes long, comes one without.
    turns = [at for at in doubtful if in_turn(objects[at], 1 if objects[at]["others"] else 2)]
    searched = sorted(turns, key=lambda at: objects[at]["failed_searches"])
    searched = sorted(searched[: const.SEARCHED_AT_ONCE])
    if searched:
        falling = np.broadcast_to(options.motion if options.falling is None else options.falling, (len(objects), 6, 6))
        elsewhere = look_elsewhere(Looking(task, objects, shift, falling), found, searched)
        found = _if_expected(elsewhere, found, prior, shift @ task.start.poses)
    found = _as_predicted(found, objects, shift)
    kept = [at for at in range(len(objects)) if np.allclose(found.poses[at], fused[at], atol=1e-9)]
    learned = _learned(best, found, task, objects, doubtful, judged, kept)
    counts = [max(0, item["failed_searches"] + (1 if at in doubtful else -1)) for at, item in enumerate(objects)]
    failed_searches = [0 if found.elsewhere[at] else count for at, count in enumerate(counts)]
    estimates = _estimates(found, objects, learned, failed_searches)
    together = together_of(objects, kept, best.fused.joint)
    return Associated(shift, best.fused.drift, estimates, together, best.fused.older)


def _found(explained: Explained, task: Task) -> Found:
    """What is found where objects are expected, the camera's error corrected."""
    (aligned, fused), predicted = explained, task.start.poses
    count = len(predicted)
    colours = dyed(aligned, task.palette, range(count))
    return Found(
        exp_many(fused.shift[None])[0] @ predicted @ exp_many(fused.own),
        fused.covariance,
        aligned.scores,
        aligned.shown,
        aligned.gains,
        explains(aligned) + colours,
        colours,
        fused.motion_scale,
        fused.trend,
        np.zeros(count, dtype=bool),
        np.ones(count, dtype=bool),
        [NO_POSES] * count,
    )


def _if_expected(after: Found, before: Found, prior: Prior, expected: Floats) -> Found:
    """What was found elsewhere, but no farther away than predictions err, did not move: it is averaged as ever."""
    spread = prior.spread()
    away = log_many(invert_many(expected) @ after.poses)
    both = spread + after.covariance
    squares = np.einsum("mi,mi->m", away, solved(both, away[..., None])[..., 0])
    same = after.elsewhere & (squares < 6.0 * const.SURPRISED**2) & (prior.motion_scale < const.FREEDOM)
    if not same.any():
        return after
    known, seen = inverse(spread), inverse(after.covariance)
    covariance = inverse(known + seen)
    own = (covariance @ (seen @ away[..., None]))[..., 0]
    return after._replace(
        poses=np.where(same[:, None, None], expected @ exp_many(own), after.poses),
        covariance=np.where(same[:, None, None], covariance, after.covariance),
        motion_scale=np.where(same, prior.motion_scale, after.motion_scale),
        trend=np.where(same[:, None], before.trend, after.trend),
        elsewhere=after.elsewhere & ~same,
    )


def _as_predicted(found: Found, objects: Sequence[TrackedObject], shift: Floats) -> Found:
    """The same, of poses that look alike those nearest to the prediction; of what no image tells, the prediction."""
    after = found.copied()
    for at, item in enumerate(objects):
        if "symmetry" not in item:
            continue
        symmetry, expected, pose = item["symmetry"], shift @ item["pose"], found.poses[at]
        after.poses[at] = alike(symmetry, pose[None], expected)[0]
        covariance = moved_along(found.covariance[at], pose, after.poses[at])
        after.covariance[at] = kept_free(symmetry, covariance, item["covariance"])
        after.guesses[at] = alike(symmetry, found.guesses[at], expected)
    return after


def _doubtful(found: Found, objects: Sequence[TrackedObject], options: Options) -> list[int]:
    return [at for at, item in enumerate(objects) if _is_doubtful(found, at, item, options)]


def _is_doubtful(found: Found, at: int, item: TrackedObject, options: Options) -> bool:
    if item["others"]:
        return True
    if found.shown[at] < const.LEAST_SHOWN:
        return False
    startled = found.motion_scale[at] == 1.0 and item["motion_scale"] < 1.0
    if item["probation"] or startled:
        return bool(found.scores[at] < options.certain_score)
    if item["slots"]["tolerance"]:  # of an imprecise model edges may be missing: their share says little
        return bool(found.nats[at] < 0.0)
    return bool(found.scores[at] < options.sure_score)


def _is_still(item: TrackedObject, motion_scale: float) -> bool:
    motion = motion_of(item)
    slow = np.linalg.norm(motion[:3]) < const.STILL_M and np.linalg.norm(motion[3:]) < const.STILL_RAD
    return bool(slow and motion_scale < const.AT_REST)


def _learned(
    best: Explained,
    found: Found,
    task: Task,
    objects: Sequence[TrackedObject],
    doubtful: list[int],
    judged: Mapping[int, Looks],
    kept: Sequence[int],
) -> list[Looks]:
    """What is remembered of the looks of those objects that are surely where they were expected."""
    aligned, sizes = best.aligned, np.zeros(len(objects))
    sizes[kept] = best.fused.sizes[kept]
    # As large as they were expected to be they would look the same somewhat nearer.
    poses = found.poses.copy()
    poses[:, :3, 3] *= 1.0 - sizes[:, None]
    controls, profiles = aligned.stage.controls, aligned.stage.profiles
    seen = controls.visible > const.SURE_SEEN
    sure = aligned.supported & seen
    offsets = offsets_at(aligned, poses)
    places, seen_colours = controls.slots[:, 0], coloured(aligned)
    learned = []
    for at, item in enumerate(objects):
        known = judged.get(at, {**item["slots"], "judged": max(0, item["slots"]["judged"] - 1)})
        known = {**known, "size": known["size"] * float(1.0 + sizes[at]) if at in kept else 1.0}
        # Where something cannot rest, it may be that it is elsewhere.
        least = const.CERTAIN_SCORE if item["hangs"] else const.LEARNED_SCORE
        if at in doubtful or found.scores[at] < least or (at in judged and known["tolerance"]):
            learned.append(known)
            continue
        known = bent_after(known, aligned, at, poses[at], task.intrinsics)
        chosen = np.nonzero(sure & (controls.owners == at))[0]
        every = np.nonzero(seen & (controls.owners == at))[0]
        near = sure[every] & (np.abs(offsets[every] - aligned.off[every]) < const.FOUND_PX)
        known = sought(known, places[every], near)
        columns = aligned.matches.columns[chosen]
        colours = np.stack((profiles.inside[chosen, columns], profiles.outside[chosen, columns]), axis=1)
        known = remembered(known, controls, chosen, colours)
        if at in kept and not item["probation"] and found.colours[at] >= 0.0:
            known = with_colours(known, seen_colours, at, found.nats[at] - found.colours[at])
        still = _is_still(item, found.motion_scale[at])
        exact = still and not known["tolerance"]
        known = measured(known, places[chosen] // EDGE_SLOTS, offsets[chosen]) if exact else known
        learned.append(known if still else moved(known))
    return learned


def _estimates(
    found: Found, objects: Sequence[TrackedObject], learned: list[Looks], failed_searches: list[int]
) -> list[Estimate]:
    probability = right(found.covariance, found.nats, [item.get("symmetry", NONE) for item in objects])
    return [
        Estimate(
            found.poses[at],
            found.covariance[at],
            float(found.motion_scale[at]),
            found.trend[at],
            float(found.scores[at]),
            float(found.shown[at]),
            float(found.nats[at]),
            float(found.colours[at]),
            float(probability[at]),
            slots,
            failed_searches[at],
            bool(found.elsewhere[at]),
            bool(found.sure[at]),
            found.guesses[at],
        )
        for at, slots in enumerate(learned)
    ]
