"""How far an object's model may be wrong, judged by the first image that shows enough of it.

That image is explained with an exact model and with imprecise ones, whose edges are looked for one by one before the
pose is refitted; the likelihoods say which it is."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.bending import bent_after
from hierax.nodes.tracking.estimation.drift import loosened
from hierax.nodes.tracking.estimation.fusion import fuse
from hierax.nodes.tracking.estimation.joint_alignment import Explained, Task
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.sizes import at_least_usual
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.math.batched import exp_many, inverse, invert_many, log_many, only
from hierax.nodes.tracking.math.geometry import Array
from hierax.nodes.tracking.schema import LOST, Looks, TrackedObject
from hierax.nodes.tracking.search.multistart import Found, squared

_OF_OBJECTS = ("poses", "own", "blocks", "slopes", "scores", "shown", "gains")  # what `Aligned` has of each object


class Verdict(NamedTuple):
    """What an image says of an object's model."""

    worth: float  # nats, and how likely its pose was before
    nats: float
    tolerance: float
    aligned: Aligned  # of all objects that were tried with it
    at: int  # which of those it is


def models_judged(
    task: Task, best: Explained, objects: Sequence[TrackedObject], found: Found, given: float | None
) -> dict[int, Verdict | None]:
    """What the image says of models that had not been judged, by their objects; None of one that is told to be exact.

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
        return dict.fromkeys(asked)
    tried: dict[int, list[Verdict]] = {at: [] for at in asked}
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
                tried[at].append(Verdict(float(worth[number]), float(nats[number]), tolerance, aligned, number))
    verdicts: dict[int, Verdict | None] = {}
    for at, alternatives in tried.items():
        first = max(alternatives, key=lambda each: each.worth + const.RATHER * (each.tolerance > 0.0), default=None)
        if first is not None and (first.worth >= 0.0 or given is not None):
            verdicts[at] = first
    return verdicts


def looks_after(
    verdicts: Mapping[int, Verdict | None], objects: Sequence[TrackedObject], intrinsics: Array
) -> dict[int, Looks]:
    """What is then known of the edges of the objects whose models were judged."""
    return {at: _looks(verdict, objects[at]["slots"], intrinsics) for at, verdict in verdicts.items()}


def _looks(verdict: Verdict | None, slots: Looks, intrinsics: Array) -> Looks:
    if verdict is None:
        return {**slots, "tolerance": 0.0}
    known: Looks = {**slots, "tolerance": verdict.tolerance, "judged": const.JUDGED_EVERY}
    if not verdict.tolerance:
        return known
    return bent_after(known, verdict.aligned, verdict.at, verdict.aligned.poses[verdict.at], intrinsics)


def explained_with(
    task: Task, best: Explained, verdicts: Mapping[int, Verdict | None], objects: Sequence[TrackedObject]
) -> Explained | None:
    """The image as it is explained with models that are as imprecise as they were judged to be: what that leaves open
    of how large objects are, the camera's error is not told by either. None: no model was judged to be imprecise."""
    loose = {at: verdict for at, verdict in verdicts.items() if verdict is not None and verdict.tolerance}
    if not loose:
        return None
    after = best.aligned._replace(**{name: getattr(best.aligned, name).copy() for name in _OF_OBJECTS})
    for at, verdict in loose.items():
        for name in _OF_OBJECTS:
            getattr(after, name)[at] = getattr(verdict.aligned, name)[verdict.at]
        expected = after.shift @ task.start.poses[at]
        after.own[at] = log_many(invert_many(expected[None]) @ after.poses[at][None])[0]
    prior = task.prior
    if prior.joint is not None:
        known = [item["slots"]["tolerance"] or 0.0 for item in objects]
        usual = at_least_usual([loose[at].tolerance if at in loose else was for at, was in enumerate(known)])
        prior = prior._replace(joint=loosened(prior.joint, objects, {at: usual[at] for at in verdicts}))
    return Explained(after, fuse(after, prior))


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
    # Where the camera is, all of them were told already; what they would say of it is asked.
    told = None if task.start.told is None else task.start.told[asked]
    begin = Start(start.poses[asked], start.information[asked], const.EXACTLY, told)
    return align(task.image, task.controls.of(places), begin, task.intrinsics, memory, search)
