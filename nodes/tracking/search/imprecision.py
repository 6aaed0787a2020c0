"""How far an object's model may be wrong, judged by the first image that shows enough of it.

That image is explained with an exact model and with imprecise ones, whose edges are looked for one by one before the
pose is refitted; the likelihoods say which it is."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.bending import bent_after
from hierax.nodes.tracking.estimation.joint_alignment import Explained, Task
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.math.batched import exp_many, inverse, invert_many, log_many, only
from hierax.nodes.tracking.schema import LOST, Looks, TrackedObject
from hierax.nodes.tracking.search.multistart import Found, squared


class _Tried(NamedTuple):
    """One alternative of one object."""

    worth: float  # nats, and how likely its pose was before
    nats: float
    tolerance: float
    aligned: Aligned  # of all objects that were tried with it
    at: int  # which of those it is


def with_models_judged(
    task: Task, best: Explained, objects: Sequence[TrackedObject], found: Found, given: float | None
) -> tuple[Found, dict[int, Looks]]:
    """What is found of objects whose models had not been judged, and what is then known of their edges.

    Args:
        task: the image; best: how exact models explain it; objects: all of them; found: what was found that way.
        given: the tolerance in metres, None where it is to be learned.
    """
    asked = [
        at
        for at, item in enumerate(objects)
        if found.shown[at] >= const.LEAST_JUDGED and _is_asked(item, found.scores[at], given)
    ]
    tolerances = const.TOLERANCES_M if given is None else (given,)
    if not asked or tolerances == (0.0,):
        return found, {at: {**objects[at]["slots"], "tolerance": 0.0} for at in asked}
    tried: dict[int, list[_Tried]] = {at: [] for at in asked}
    start = Start(exp_many(best.fused.shift[None])[0] @ task.start.poses, inverse(task.prior.spread()))
    loose = [(at, tolerance) for tolerance in tolerances if tolerance for at in asked]
    exact = [(at, 0.0) for at in range(len(objects))] if 0.0 in tolerances else []
    for which, aligned in ((exact, best.aligned), (loose, _aligned(task, loose, start))):
        if aligned is None or not which:
            continue
        rows = [at for at, _ in which]
        away = log_many(invert_many(start.poses[rows]) @ aligned.poses)
        nats = explains(aligned)
        worth = nats - 0.5 * squared(away, start.information[rows])
        for number, (at, tolerance) in enumerate(which):
            if at in tried:
                tried[at].append(_Tried(float(worth[number]), float(nats[number]), tolerance, aligned, number))
    after, looks = found.copied(), {}
    for at, alternatives in tried.items():
        first = max(alternatives, key=lambda each: each.worth + const.RATHER * (each.tolerance > 0.0), default=None)
        if first is None or (first.worth < 0.0 and given is None):
            continue
        known: Looks = {**objects[at]["slots"], "tolerance": first.tolerance, "judged": const.JUDGED_EVERY}
        if first.tolerance > 0.0:
            pose, blocks = first.aligned.poses[first.at], first.aligned.blocks[first.at, 6:, 6:]
            after.poses[at], after.covariance[at] = pose, inverse(start.information[at] + blocks)
            after.scores[at], after.gains[at] = first.aligned.scores[first.at], first.aligned.gains[first.at]
            after.nats[at] = first.nats
            known = bent_after(known, first.aligned, first.at, pose, task.intrinsics)
        looks[at] = known
    return after, looks


def _is_asked(item: TrackedObject, score: float, given: float | None) -> bool:
    """Whether an object's model is judged in this image: at once; one that does not do well as exact, now and then.

    Where nobody knows where the object is, its pose is to be found first; where it cannot rest, a better one."""
    looks = item["slots"]
    if item["others"] or item["status"] == LOST:
        return False
    if looks["tolerance"] is None:
        return True
    doubted = looks["tolerance"] == 0.0 and score < const.DOING_WELL and not item["hangs"]
    return given is None and doubted and looks["judged"] == 0


def _aligned(task: Task, loose: Sequence[tuple[int, float]], start: Start) -> Aligned | None:
    """Some objects, each alone, with models that are as imprecise as that: all of them at once."""
    asked = [at for at, _ in loose]
    places = task.controls.rows_of(asked, const.POINTS_MAX)
    memory = only(task.memory, np.concatenate(places))
    variances = np.repeat([tolerance**2 for _, tolerance in loose], [len(rows) for rows in places])
    memory = memory._replace(slack=variances[:, None, None] * np.eye(3))
    search = Search(voted=True)
    begin = Start(start.poses[asked], start.information[asked])
    return align(task.image, task.controls.of(places), begin, task.intrinsics, memory, search)
