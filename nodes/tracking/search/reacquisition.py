"""Finding objects again that were out of sight, or lost: poses that are imagined of them compete for the image.

Every candidate comes with the control points that would be seen of the object there. One is believed when the image
speaks for it clearly more than for the expected pose and for any other; until then the best ones are sent up, to be
imagined again for the next image, where they have moved to by then.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.joint_alignment import Task
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.palette import dyed, is_another
from hierax.nodes.tracking.estimation.profiles import lines_of
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.math.batched import inverse, invert_many, joined, log_many, only, summed, tukey
from hierax.nodes.tracking.math.geometry import NO_POSES, Array, Floats
from hierax.nodes.tracking.model.controls import Indices, gathered
from hierax.nodes.tracking.schema import TRACKED, ControlPoints
from hierax.nodes.tracking.search.multistart import (
    FINE,
    ROUGH,
    Found,
    Looking,
    aligned_each,
    as_predicted,
    away_by,
    best_of,
    search_elsewhere,
    squared,
)


class _Candidates(NamedTuple):
    """Poses that objects may have."""

    owners: Indices  # (n,) whose
    views: Indices  # (n,) which of the controls are those that would be seen of it there
    starts: Floats  # (n, 4, 4) camera_from_object
    settled: Array  # (n,) whether it was found in an earlier image, or is the expected one
    expected: Array  # (n,) whether it is that


def look_elsewhere(looking: Looking, found: Found, doubtful: Sequence[int]) -> Found:
    """The same as found, but for doubtful objects that are better explained elsewhere; arguments: see `find_again`."""
    near = [at for at in doubtful if not looking.objects[at]["others"]]
    gone = [at for at in doubtful if looking.objects[at]["others"]]
    if near:
        found = search_elsewhere(looking, found, near)
    return find_again(looking, found, gone) if gone else found


def find_again(looking: Looking, found: Found, sought: Sequence[int]) -> Found:
    """The same as found, but for objects of which a pose that was imagined besides explains the image clearly best.

    Args:
        looking: what the search works on; found: where the objects were expected and found.
        sought: which of them to look for; they have "others".
    """
    objects, prior = looking.objects, looking.task.prior
    candidates, imagined = _candidates(looking, found, sought)
    information = inverse(prior._replace(motion_scale=np.ones(len(objects))).spread())

    def aligned(which: _Candidates, search: Search, most: int) -> Aligned | None:
        start = Start(which.starts, information[which.owners])
        return aligned_each(imagined, which.views.tolist(), start, search, most)

    fresh = only(candidates, ~candidates.settled)
    rough = aligned(fresh, ROUGH, const.ROUGH_POINTS) if len(fresh.owners) else None
    if rough is not None:
        best = best_of(rough.gains - const.CHANCE * rough.shown, fresh.owners, sought)
        fresh = only(fresh._replace(starts=rough.poses), best)
    candidates = joined((only(candidates, candidates.settled), fresh))
    fine = aligned(candidates, FINE, const.POINTS_MAX)
    if fine is None:
        return found
    fine = as_predicted(looking, candidates.owners.tolist(), fine)
    away = away_by(looking, candidates.owners.tolist(), fine.poses)
    evidence, shown = _evidence(looking, found, fine, candidates)
    colours = dyed(fine, looking.task.palette, candidates.owners)
    unlikely = 0.5 * squared(away, information[candidates.owners])
    # Of what is seen where it cannot rest, nobody knows where it is; where much of it is in sight, the image tells.
    hangs = np.array([item["hangs"] > 0 for item in objects]) & (found.shown > const.LEAST_IN_SIGHT)
    unlikely[hangs[candidates.owners]] = 0.0
    worth = evidence + colours - np.minimum(unlikely, const.UNLIKELIEST * shown)
    worth[is_another(colours)] = -np.inf
    # What is farther away than that is as one of which nothing is known: `missing` decides.
    worth[candidates.settled & (unlikely > const.LEAST_NATS)] = -np.inf
    eligible = (fine.scores >= const.FOUND_SCORE) & (shown >= const.LEAST_FOUND) & ~is_another(colours)
    tracked = np.array([item["status"] == TRACKED for item in objects])
    return _chosen(found, candidates, fine, worth, colours, eligible, information, sought, tracked, hangs)


def _candidates(looking: Looking, found: Found, sought: Sequence[int]) -> tuple[_Candidates, Task]:
    """What may be, and the task with all their controls and what is remembered beside those."""
    task, objects, shift = looking.task, looking.objects, looking.shift
    rows: list[tuple[int, int, Floats, bool, bool]] = []
    seen: list[ControlPoints] = []
    owners: list[int] = []
    for at in sought:
        item = objects[at]
        rows.append((at, len(seen), found.poses[at], True, True))
        rows += [(at, len(seen), shift @ pose, False, False) for pose in (item["before"], item["pose"])]
        seen.append(item["controls"])
        for other in item["others"]:
            if len(other["controls"]["points"]):
                rows.append((at, len(seen), shift @ other["pose"], other["kept"], False))
                seen.append(other["controls"])
        owners += [at] * (len(seen) - len(owners))
    candidates = _Candidates._make(np.array(column) for column in zip(*rows, strict=True))
    controls = gathered(seen)
    looks = [objects[at]["slots"] for at in owners]
    return candidates, task._replace(controls=controls, memory=memory_of(looks, controls, task.image.shape[2]))


def _evidence(looking: Looking, found: Found, fine: Aligned, candidates: _Candidates) -> tuple[Floats, Floats]:
    """(n,) how much the image speaks for each candidate, in control points, and how many of those are its own."""
    stage, matches, count = fine.stage, fine.matches, len(candidates.owners)
    numbers = stage.controls.owners
    gain = (
        tukey(matches.pixels, 2.0 * const.SUPPORT_PX) * np.exp(-const.STRANGE_WEIGHT * matches.strange) - const.CHANCE
    )
    own = stage.controls.visible * ~_claimed(looking, found, fine, candidates.owners[numbers])
    return summed(numbers, own * gain, count), summed(numbers, own, count)


def _claimed(looking: Looking, found: Found, fine: Aligned, owners: Indices) -> Array:
    """(n,) of each line whether what it found in the image is rather an edge of another object that is seen there."""
    task, mine = looking.task, fine.stage.lines
    chosen = (task.controls.visible > 0.5) & (found.scores >= 0.5)[task.controls.owners]
    lines = lines_of(task.controls, found.poses, task.intrinsics, task.image.shape)
    kept = chosen[lines.rows]
    claims, normals, whose = lines.pixels[kept], lines.normals[kept], task.controls.owners[lines.rows[kept]]
    places = fine.stage.profiles.places[np.arange(len(owners)), fine.matches.columns]
    middle = mine.pixels + np.where(np.isfinite(places), places, 0.0)[:, None] * mine.normals
    away = middle[:, None, :] - claims[None]
    across = np.abs(np.einsum("nmk,mk->nm", away, normals)) < const.CLAIM_PX
    along = np.abs(away[..., 0] * normals[None, :, 1] - away[..., 1] * normals[None, :, 0]) < const.SPACING_PX
    parallel = np.abs(mine.normals @ normals.T) > const.PARALLEL
    claimed: Array = (across & along & parallel & (owners[:, None] != whose[None])).any(axis=1)
    return claimed


def _chosen(
    found: Found,
    candidates: _Candidates,
    fine: Aligned,
    worth: Floats,
    colours: Floats,
    eligible: Array,
    information: Floats,
    sought: Sequence[int],
    tracked: Array,
    hangs: Array,
) -> Found:
    """What is found, with the best candidates of each object besides."""
    after, nats = found.copied(), explains(fine) + colours
    for at in sought:
        own = np.nonzero(candidates.owners == at)[0]
        ranked = different(fine.poses, own[np.argsort(-worth[own], kind="stable")])
        first = ranked[0]
        second = worth[ranked[1]] if len(ranked) > 1 else -np.inf
        after.sure[at] = worth[first] > max(second + const.CLEARLY, 0.0)
        rivals = [number for number in ranked[: const.GUESSES + 1] if worth[number] > 0.0]
        kept = own[candidates.expected[own]][0]
        # Aligned alone, it may turn out to be elsewhere than where all objects together have it.
        stays = is_near(found.poses[at], fine.poses[kept])
        clearly = not stays or worth[first] > worth[kept] + const.CLEARLY
        if hangs[at] or not stays:
            clearly &= nats[first] > (nats[kept] if stays else found.nats[at]) + const.CLEARLY
        known = clearly if tracked[at] else after.sure[at]
        if known and eligible[first] and not (first == kept and stays):
            after.put(at, fine.poses[first], inverse(information[at] + fine.blocks[first, 6:, 6:]))
            after.scores[at], after.gains[at] = fine.scores[first], fine.gains[first]
            after.shown[at], after.nats[at], after.colours[at] = fine.shown[first], nats[first], colours[first]
        guesses = [fine.poses[number] for number in rivals[int(after.sure[at]) :][: const.GUESSES]]
        after.guesses[at] = np.stack(guesses) if guesses else NO_POSES
    return after


def different(poses: Floats, ranked: Indices, most: int | None = None) -> list[int]:
    """Those of some poses, best first, that are apart from all better ones; the first so many of them alone."""
    chosen: list[int] = []
    for number in ranked:
        if len(chosen) == most:
            break
        if chosen:
            apart = log_many(invert_many(poses[chosen]) @ poses[number])
            near = np.linalg.norm(apart[:, :3], axis=1) < const.APART_M
            if (near & (np.linalg.norm(apart[:, 3:], axis=1) < const.APART_RAD)).any():
                continue
        chosen.append(int(number))
    return chosen


def is_near(pose: Floats, other: Floats) -> bool:
    """Whether two poses are not apart."""
    return len(different(np.stack((pose, other)), np.arange(2))) == 1
