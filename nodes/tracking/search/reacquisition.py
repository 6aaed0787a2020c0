"""Finding objects again that were out of sight, or lost: poses that are imagined of them compete for the image.

Every candidate comes with the control points that would be seen of the object there. One is believed when the image
speaks for it clearly more than for the expected pose and for any other; until then the best ones are sent up, to be
imagined again for the next image, where they have moved to by then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking.estimation.alignment import Aligned, Start
from hierax.nodes.tracking.estimation.appearance import Memory, recalled
from hierax.nodes.tracking.estimation.fusion import Prior
from hierax.nodes.tracking.estimation.profiles import Controls, Indices, gathered, lines_of
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.imagery.controls import POINTS_MAX
from hierax.nodes.tracking.math.batched import inverse, invert_many, log_many
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.schema import TRACKED, ControlPoints, TrackedObject
from hierax.nodes.tracking.search.multistart import (
    FINE,
    ROUGH,
    ROUGH_POINTS,
    Found,
    Looking,
    aligned_each,
    search_elsewhere,
)

GUESSES = 3  # so many candidates of an object are kept from one image to the next
_KEPT = 4
# What a control point speaks for a pose by chance: what is seen where it should be speaks for a pose, what is not,
# against it.
_CHANCE = 0.5

_FAMILIAR = 0.3  # what one that looks as it is remembered speaks for it besides

# So large a share of the control points that should be seen must speak for a pose beyond that, however unlikely it was
# before.
_UNLIKELIEST = 0.25

_CLEARLY = 1.5  # by so many control points a candidate must be better than any that differs from it

# A candidate with this score, and so many control points that are no other object's edges, may be the object.
_FOUND_SCORE = 0.7
_LEAST_FOUND = 18.0

# What is surely seen of an object with this score claims what the image shows so near to it, in that direction.
_SEEN = 0.5
_SUPPORTED = 0.5
_CLAIM_PX = 2.5
_CLAIM_ALONG_PX = 4.0
_PARALLEL = 0.9

_NEAR_PX = 3.0
_STRANGE = 0.5

_APART_M = 0.008
_APART_RAD = 0.14


class _Candidates(NamedTuple):
    """Poses that objects may have."""

    owners: Indices  # (n,) whose
    views: Indices  # (n,) which of the controls are those that would be seen of it there
    starts: Floats  # (n, 4, 4) camera_from_object
    settled: Array  # (n,) whether it was found in an earlier image, or is the expected one
    expected: Array  # (n,) whether it is that

    def only(self, chosen: Array) -> _Candidates:
        parts: list[Any] = [part[chosen] for part in self]
        return _Candidates(*parts)


def look_elsewhere(
    looking: Looking,
    objects: Sequence[TrackedObject],
    shift: Floats,
    found: Found,
    doubtful: Sequence[int],
    prior: Prior,
) -> Found:
    """The same as found, but for doubtful objects that are better explained elsewhere; arguments: see `find_again`."""
    near = [at for at in doubtful if not objects[at]["others"]]
    gone = [at for at in doubtful if objects[at]["others"]]
    if near:
        found = search_elsewhere(looking, objects, shift, found, near, prior)
    return find_again(looking, objects, shift, found, gone, prior) if gone else found


def find_again(
    looking: Looking, objects: Sequence[TrackedObject], shift: Floats, found: Found, sought: Sequence[int], prior: Prior
) -> Found:
    """The same as found, but for objects of which a pose that was imagined besides explains the image clearly best.

    Args:
        looking: the image, and what is known of the objects' edges.
        objects: as for `hierax.nodes.tracking.search.association.associate`.
        shift: (4, 4) what the camera's error does to all poses.
        found: where the objects were expected and found.
        sought: which of them to look for; they have "others".
        prior: what was known before the image.
    """
    candidates, controls, memory = _candidates(looking, objects, shift, found, sought)
    imagined = looking._replace(controls=controls, memory=memory)
    covariance = prior._replace(unrest=np.ones(len(objects))).spread()
    information = inverse(covariance)

    def aligned(which: _Candidates, search: Search, most: int) -> Aligned | None:
        start = Start(which.starts, information[which.owners])
        return aligned_each(imagined, [int(view) for view in which.views], start, search, most)

    fresh = candidates.only(~candidates.settled)
    rough = aligned(fresh, ROUGH, ROUGH_POINTS) if len(fresh.owners) else None
    if rough is not None:
        worth = rough.gains - _CHANCE * rough.shown
        best = np.sort(np.concatenate([_best(worth, fresh.owners == at) for at in sought]))
        fresh = fresh._replace(starts=rough.poses).only(best)
    both = (candidates.only(candidates.settled), fresh)
    joined: list[Any] = [np.concatenate(parts) for parts in zip(*both, strict=True)]
    candidates = _Candidates(*joined)
    fine = aligned(candidates, FINE, POINTS_MAX)
    if fine is None:
        return found
    predicted = np.stack([shift @ objects[at]["pose"] for at in candidates.owners])
    away = log_many(invert_many(predicted) @ fine.poses)
    squares = np.einsum("mi,mij,mj->m", away, information[candidates.owners], away)
    evidence, shown = _evidence(looking, found, fine, controls, memory, candidates)
    worth = evidence - np.minimum(0.5 * squares, _UNLIKELIEST * shown)
    eligible = (fine.scores >= _FOUND_SCORE) & (shown >= _LEAST_FOUND)
    tracked = np.array([item["status"] == TRACKED for item in objects])
    return _chosen(found, candidates, fine, worth, eligible, information, sought, tracked)


def _candidates(
    looking: Looking, objects: Sequence[TrackedObject], shift: Floats, found: Found, sought: Sequence[int]
) -> tuple[_Candidates, Controls, Memory]:
    """What may be, with all their controls, and what is remembered beside those."""
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
    columns: list[Any] = [np.array(column) for column in zip(*rows, strict=True)]
    controls = gathered(seen)
    memory = recalled([objects[at]["slots"] for at in owners], controls, looking.image.shape[2])
    memory = memory._replace(factor=np.full(len(controls.owners), looking.memory.factor[0], dtype=np.float32))
    return _Candidates(*columns), controls, memory


def _best(worth: Floats, own: Array) -> Indices:
    numbers = np.nonzero(own)[0]
    best: Indices = numbers[np.argsort(-worth[numbers], kind="stable")[:_KEPT]]
    return best


def _evidence(
    looking: Looking, found: Found, fine: Aligned, controls: Controls, memory: Memory, candidates: _Candidates
) -> tuple[Floats, Floats]:
    """(n,) how much the image speaks for each candidate, in control points, and how many of those are its own."""
    places = controls.rows_of([int(view) for view in candidates.views], POINTS_MAX)
    rows = np.concatenate(places)[fine.lines.rows]
    numbers = np.repeat(np.arange(len(places)), [len(own) for own in places])[fine.lines.rows]
    matches = fine.matches
    part = np.minimum(np.abs(matches.pixels) / _NEAR_PX, 1.0)
    gain = (1.0 - part * part) ** 2 * np.exp(-_STRANGE * matches.strange) - _CHANCE
    known = (memory.precision[rows] > 0).any(axis=1) & matches.supported & (matches.strange < 1.0)
    own = controls.visible[rows] * ~_claimed(looking, found, fine, candidates.owners[numbers])
    count = len(candidates.owners)

    def summed(values: Floats) -> Floats:
        return np.asarray(np.bincount(numbers, weights=values, minlength=count), dtype=np.float64)

    return summed(own * (gain + _FAMILIAR * known)), summed(own)


def _claimed(looking: Looking, found: Found, fine: Aligned, owners: Indices) -> Array:
    """(n,) of each line whether what it found in the image is rather an edge of another object that is seen there."""
    controls = looking.controls
    chosen = (controls.visible > _SEEN) & (found.scores >= _SUPPORTED)[controls.owners]
    lines = lines_of(controls, found.poses, looking.intrinsics, looking.image.shape)
    kept = chosen[lines.rows]
    claims, normals, whose = lines.pixels[kept], lines.normals[kept], controls.owners[lines.rows[kept]]
    places = fine.profiles.places[np.arange(len(owners)), fine.matches.columns]
    middle = fine.lines.pixels + np.where(np.isfinite(places), places, 0.0)[:, None] * fine.lines.normals
    away = middle[:, None, :] - claims[None]
    across = np.abs(np.einsum("nmk,mk->nm", away, normals)) < _CLAIM_PX
    along = np.abs(away[..., 0] * normals[None, :, 1] - away[..., 1] * normals[None, :, 0]) < _CLAIM_ALONG_PX
    parallel = np.abs(fine.lines.normals @ normals.T) > _PARALLEL
    claimed: Array = (across & along & parallel & (owners[:, None] != whose[None])).any(axis=1)
    return claimed


def _chosen(
    found: Found,
    candidates: _Candidates,
    fine: Aligned,
    worth: Floats,
    eligible: Array,
    information: Floats,
    sought: Sequence[int],
    tracked: Array,
) -> Found:
    """What is found, with the best candidates of each object besides."""
    after = found.copied()
    for at in sought:
        own = np.nonzero(candidates.owners == at)[0]
        ranked = _different(fine.poses, own[np.argsort(-worth[own], kind="stable")])
        first = ranked[0]
        second = worth[ranked[1]] if len(ranked) > 1 else -np.inf
        after.sure[at] = worth[first] > max(second + _CLEARLY, 0.0)
        rivals = [number for number in ranked[: GUESSES + 1] if worth[number] > 0.0]
        kept = own[candidates.expected[own]][0]
        known = tracked[at] and worth[first] > worth[kept] + _CLEARLY
        if not candidates.expected[first] and eligible[first] and (known or (not tracked[at] and after.sure[at])):
            after.poses[at] = fine.poses[first]
            after.covariance[at] = inverse(information[at] + fine.blocks[first, 6:, 6:])
            after.scores[at], after.gains[at], after.shown[at] = (
                fine.scores[first],
                fine.gains[first],
                fine.shown[first],
            )
            after.unrest[at], after.trend[at], after.elsewhere[at] = 1.0, 0.0, True
        guesses = [fine.poses[number] for number in rivals[int(after.sure[at]) :][:GUESSES]]
        after.guesses[at] = np.stack(guesses) if guesses else np.zeros((0, 4, 4))
    return after


def _different(poses: Floats, ranked: Indices) -> list[int]:
    """Those of some poses, best first, that are apart from all better ones."""
    chosen: list[int] = []
    for number in ranked:
        if chosen:
            apart = log_many(invert_many(poses[chosen]) @ poses[number])
            near = np.linalg.norm(apart[:, :3], axis=1) < _APART_M
            if (near & (np.linalg.norm(apart[:, 3:], axis=1) < _APART_RAD)).any():
                continue
        chosen.append(int(number))
    return chosen
