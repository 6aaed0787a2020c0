"""Looking for objects that are not where they were expected: many starts, the best explained one wins.

An object may be on its way from where it was, faster or slower than thought, or anywhere that its uncertainty allows.
All starts are aligned roughly at once, the best few of each object finely. One that more control points speak for takes
the place of the expected explanation; the more unlikely it was before the image, the more."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.joint_alignment import Task
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.palette import dyed, is_another
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.estimation.tracked import motion_of
from hierax.nodes.tracking.math.batched import exp_many, inverse, invert_many, log_many, only
from hierax.nodes.tracking.math.geometry import Array, Floats, unit
from hierax.nodes.tracking.model.controls import Indices
from hierax.nodes.tracking.model.symmetry import LEVER_M, about, alike
from hierax.nodes.tracking.schema import TRACKED, TrackedObject

ROUGH = Search(
    const.ROUGH_REACH_PX,
    const.ROUGH_SCALE_PX,
    const.TRY_ITERATIONS,
    const.ROUGH_LAST_PX,
    const.ROUGH_LAST_ITERATIONS,
    support_px=const.ROUGH_SUPPORT_PX,
)
FINE = Search(const.FINE_REACH_PX, const.FINE_SCALE_PX, const.TRY_ITERATIONS)
_FIRST = ROUGH._replace(iterations=const.FIRST_ITERATIONS)
_NEAR = Search(const.CALM_REACH_PX, const.CALM_SCALE_PX, const.TRY_ITERATIONS)  # the best of many starts are nearer


def held(motion: Floats, support: Floats, upwards: float, tilting: float) -> Floats:
    """(6, 6) how far something may move that stands on something else.

    Args:
        motion: (6, 6) covariance of how far it may if nothing carries it, twist in its frame.
        support: (3,) unit vector upwards in its frame; zeros where nothing carries it.
        upwards, tilting: shares of that motion (as standard deviations) upwards, and about level axes.
    """
    kept = np.eye(6)
    kept[:3, :3] -= (1.0 - upwards) * np.outer(support, support)
    kept[3:, 3:] -= (1.0 - tilting) * (float(support @ support) * np.eye(3) - np.outer(support, support))
    result: Floats = kept @ motion @ kept
    return result


class Found(NamedTuple):
    """What is found of the objects in an image."""

    poses: Floats  # (m, 4, 4) camera_from_object
    covariance: Floats  # (m, 6, 6) twist in the object's frame
    scores: Floats  # (m,) 0 to 1
    shown: Floats  # (m,) how many control points should be seen
    gains: Floats  # (m,) how many of them speak for the pose
    nats: Floats  # (m,) by how much the pose explains the image better than clutter does
    colours: Floats  # (m,) nats of these that are said by what colours it has there
    motion_scale: Floats  # (m,) how much of a push the latest motion asks for
    trend: Floats  # (m, 6) see `hierax.nodes.tracking.estimation.fusion.Prior`
    elsewhere: NDArray[np.bool_]  # (m,) whether it was found elsewhere than expected
    sure: NDArray[np.bool_]  # (m,) false where another pose explains the image nearly as well
    guesses: list[Floats]  # of each object the (n, 4, 4) poses that explain the image best besides

    def copied(self) -> "Found":
        """The same, to be changed."""
        return Found._make(part.copy() for part in self)

    def put(self, at: int, pose: Floats, covariance: Floats) -> None:
        """Change where an object is found: elsewhere than expected."""
        self.poses[at], self.covariance[at] = pose, covariance
        self.motion_scale[at], self.trend[at], self.elsewhere[at] = 1.0, 0.0, True


class Looking(NamedTuple):
    """What the search works on."""

    task: Task  # the image, and what is known of the objects' edges and poses
    objects: Sequence[TrackedObject]  # as for `hierax.nodes.tracking.search.association.associate`
    shift: Floats  # (4, 4) what the camera's error does to all poses
    falling: Floats  # (m, 6, 6) how far each object may leave its prediction within a frame, falling over included


def search_elsewhere(looking: Looking, found: Found, doubtful: Sequence[int]) -> Found:
    """The same as found, but for doubtful objects that are better explained elsewhere.

    Args:
        looking: what the search works on; found: where the objects were expected and found.
        doubtful: which of them to look for.
    """
    objects, prior = looking.objects, looking.task.prior
    free = prior._replace(motion=looking.falling)
    spread = free._replace(motion_scale=np.ones(len(objects))).spread()
    startled = inverse(spread)
    seen = np.array([len(item["slots"]["keys"]) > 0 for item in objects])
    pushed = inverse(free._replace(motion_scale=np.where(seen, 1.0, prior.motion_scale)).spread())
    for at in doubtful:
        if _is_astray(objects[at]):
            spread[at] += held(const.ASTRAY, objects[at]["support"], const.FALLING, 1.0)
    tries: list[int] = []
    starts: list[Floats] = []
    for at in doubtful:
        own = _starts(objects[at], looking.shift, spread[at])
        starts += own
        tries += [at] * len(own)
    information = inverse(spread)
    rough = aligned_each(looking.task, tries, Start(np.stack(starts), information[tries]), _FIRST, const.FEW_POINTS)
    if rough is None:
        return found
    kept = best_of(rough.gains, np.array(tries), doubtful)
    tries = [tries[number] for number in kept]
    start = Start(rough.poses[kept], information[tries])
    fine = aligned_each(looking.task, tries, start, _NEAR, const.POINTS_MAX)
    if fine is None:
        return found
    fine = as_predicted(looking, tries, fine)
    away = away_by(looking, tries, fine.poses)
    squares = squared(away, inverse(prior.spread())[tries])
    loose = squared(away, startled[tries])
    still = prior.camera is None
    worse = np.array([still and _is_worse(found.scores[at], item) for at, item in enumerate(objects)])
    # Where something happens to an object the light on it changes, too: then its looks say little.
    found = found._replace(gains=np.where(worse, found.scores * found.shown, found.gains))
    support = (found.scores * found.shown)[tries]
    event = np.where(worse[tries], const.EVENT_SEEN, const.EVENT) * support
    unlikely = np.minimum(0.5 * squares, np.minimum(0.5 * loose + event, const.UNLIKELIEST * support))
    worth = np.where(worse[tries], fine.scores * found.shown[tries], fine.gains) - unlikely
    within_reach = squared(away, pushed[tries]) <= const.PUSH_SQUARED
    much_better = seen[tries] & (fine.gains > found.gains[tries] + const.MUCH * found.shown[tries])
    worth[(found.scores[tries] >= const.KEPT_SCORE) & ~within_reach & ~much_better] = -np.inf
    colours = dyed(fine, looking.task.palette, tries)
    worth[is_another(colours)] = -np.inf
    return _chosen(found, tries, start, fine, worth, colours)


def aligned_each(task: Task, tries: Sequence[int], start: Start, search: Search, most: int) -> Aligned | None:
    """Several starts of the same objects, each aligned as if it were an object of its own.

    Args:
        task: the image, and what is known of the objects' edges.
        tries: (n,) which object's control points each start has; start: of each; search: how.
        most: how many control points each has at most.
    """
    places = task.controls.rows_of(tries, most)
    memory = only(task.memory, np.concatenate(places))
    return align(task.image, task.controls.of(places), start, task.intrinsics, memory, search)


def as_predicted(looking: Looking, owners: Sequence[int], aligned: Aligned) -> Aligned:
    """The same, of poses that look alike those nearest to where the objects are predicted."""
    poses = aligned.poses.copy()
    for number, at in enumerate(owners):
        if "symmetry" in (item := looking.objects[at]):
            poses[number] = alike(item["symmetry"], poses[number, None], looking.shift @ item["pose"])[0]
    return aligned._replace(poses=poses)


def best_of(worth: Floats, owners: Array, wanted: Sequence[int]) -> Indices:
    """The numbers of each wanted object's best few candidates, ascending."""
    best = []
    for at in wanted:
        own = np.nonzero(owners == at)[0]
        best.append(own[np.argsort(-worth[own], kind="stable")[: const.TRIES_KEPT]])
    return np.sort(np.concatenate(best))


def away_by(looking: Looking, owners: Sequence[int], poses: Floats) -> Floats:
    """Twists (n, 6) by which poses of objects are away from where these are predicted, in the objects' frames."""
    predicted = np.stack([looking.shift @ looking.objects[at]["pose"] for at in owners])
    return log_many(invert_many(predicted) @ poses)


def squared(away: Floats, information: Floats) -> Floats:
    """(n,) the squares of twists, in variances."""
    return np.asarray(np.einsum("mi,mij,mj->m", away, information, away), dtype=np.float64)


def _chosen(found: Found, tries: Sequence[int], start: Start, fine: Aligned, worth: Floats, colours: Floats) -> Found:
    after, nats = found.copied(), explains(fine) + colours
    for number, at in enumerate(tries):
        if fine.shown[number] < const.LEAST_FOUND or worth[number] <= after.gains[at] + const.BETTER * found.shown[at]:
            continue
        after.put(at, fine.poses[number], inverse(start.information[number] + fine.blocks[number, 6:, 6:]))
        after.scores[at], after.gains[at] = fine.scores[number], worth[number]
        after.nats[at], after.colours[at] = nats[number], colours[number]
    return after


def in_turn(item: TrackedObject, every: int = 1) -> bool:
    """Whether an object is looked for in this image: at once, in one of so many, but when that was without success,
    only now and then."""
    failed_searches = int(item["failed_searches"])
    if failed_searches < const.FAILED_AT_ONCE:
        return failed_searches % every == 0
    return (failed_searches + int(item["id"])) % const.FAILED_EVERY == 0


def _is_worse(score: float, item: TrackedObject) -> bool:
    return bool(item["status"] == TRACKED and score < const.LESS * item["score"])


def _is_astray(item: TrackedObject) -> bool:
    return bool(item["failed_searches"] >= const.FAILED_AT_ONCE or item["probation"] > 0)


def _starts(item: TrackedObject, shift: Floats, spread: Floats) -> list[Floats]:
    """Where an object may be: on its way from where it was, and around where it was expected."""
    motion = motion_of(item)
    moves = np.array([1.0] if np.linalg.norm(motion) < 1e-4 else const.FARTHER)
    ways = [shift @ item["before"] @ way for way in exp_many(moves[:, None] * motion)]
    turn = (int(item["failed_searches"]) + int(item["id"])) // const.FAILED_EVERY
    around = const.AROUND[turn % len(const.AROUND)] @ np.linalg.cholesky(spread).T
    if float(np.trace(spread[:3, :3])) > const.GRID_M**2:
        around = np.concatenate((around, _across(spread)))
    over = _tipped(item) if item["stands"] else []
    return ways + [shift @ item["pose"] @ near for near in (*exp_many(around), *over)]


def _tipped(item: TrackedObject) -> list[Floats]:
    """How something that stands may begin to fall: (4, 4) turns in its frame about edges of its foot."""
    up, points = item["support"], item["controls"]["points"]
    if not len(points) or not up.any():
        return []
    low, high = points.min(axis=0), points.max(axis=0)
    corners = (low + high) / 2 + const.BOX_CORNERS * (high - low)
    heights = corners @ up
    foot = corners[heights <= heights.min() + max(const.FOOT * float(np.ptp(heights)), const.FLAT_M)]
    first = unit(np.cross(up, np.eye(3)[np.abs(up).argmin()]))
    ways = [np.cos(turn) * first + np.sin(turn) * np.cross(up, first) for turn in const.TIPPED_WAYS]
    return [about(np.cross(up, way), foot[(foot @ way).argmax()], angle) for way in ways for angle in const.TIPPED_RAD]


def _across(spread: Floats) -> Floats:
    """Twists (n, 6) on a grid along the two directions that are least certain."""
    scale = np.array([1.0] * 3 + [LEVER_M] * 3)
    scaled = spread * np.outer(scale, scale)
    _, vectors = np.linalg.eigh(scaled)
    variances = np.einsum("ik,ij,jk->k", vectors, scaled, vectors)
    grid: Floats = const.GRID @ (vectors * np.sqrt(np.maximum(variances, 0.0)))[:, -2:].T / scale
    return grid
