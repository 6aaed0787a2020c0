"""Objects of which nobody knows where they are: first poses, and those that were lost.

In each image one of them is looked for everywhere (`sweep`); the poses that the image speaks for most go up as guesses,
aligned or as they were. They come down for the next image with the control points that would be seen there, and are
judged in nats. Of all missing objects those poses are chosen together that explain the image best without two being in
one place; one is believed when any other choice for its object explains the image clearly less well.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.appearance import only_found
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.joint_alignment import flat
from hierax.nodes.tracking.estimation.likelihood import explains, shares
from hierax.nodes.tracking.estimation.palette import dyed, dyed_as, is_another, painted, palette_of
from hierax.nodes.tracking.estimation.profiles import Image
from hierax.nodes.tracking.estimation.stages import Search
from hierax.nodes.tracking.math.batched import inverse, invert_many, log_many, only, pixels_of
from hierax.nodes.tracking.math.geometry import NO_POSES, Array, Floats, exp_so3, make_pose, transform
from hierax.nodes.tracking.model.controls import gathered
from hierax.nodes.tracking.model.symmetry import alike
from hierax.nodes.tracking.schema import LOST, TRACKED, Alternative, ControlPoints, Looks, Sweep, TrackedObject
from hierax.nodes.tracking.search.multistart import FINE, ROUGH, held, squared
from hierax.nodes.tracking.search.reacquisition import different, is_near
from hierax.nodes.tracking.search.sweep import Maps, maps_of, stands_out, swept, uncovered
from hierax.nodes.tracking.search.together import (
    Judged,
    Together,
    carriers_of,
    conflicts_of,
    hidden_of,
    is_in,
    look_alike,
)


class Sighting(NamedTuple):
    """What an image says of a missing object, or of one that was found just now."""

    guesses: Floats  # (n, 4, 4) camera_from_object where it may be
    pose: Floats | None = None  # camera_from_object where it is; None: that is not known
    covariance: Floats | None = None  # (6, 6)
    score: float = 0.0
    nats: float = 0.0  # by how much it explains the image better than clutter does
    lead: float = 0.0  # nats by which the image is explained better with it there than by any other choice
    again: bool = False  # whether the image before said the same
    known: bool = False  # whether it is clear by its colours that it is this one


def look_for_missing(
    image: Image,
    objects: Sequence[TrackedObject],
    missing: Mapping[int, Sequence[Alternative]],
    sweeps: Sequence[Sweep],
    intrinsics: Array,
    level: Floats,
) -> dict[int, Sighting]:
    """What an image says of the missing objects, by their index; nothing of those that it was not looked for.

    Args:
        image: of `hierax.nodes.tracking.estimation.profiles.smoothed`.
        objects: all of them, those that are seen where this image has them.
        missing: by the index of those that are missing, what would be seen of them where they may be.
        sweeps: of some that are missing; intrinsics: (4,) fx, fy, cx, cy in pixels.
        level: (4,) unit vector upwards, camera's frame, and how high the camera is above the table, m.
    """
    if not sweeps and not any(missing.values()):
        return {}
    image, intrinsics, thinned = _reduced(image, intrinsics)
    objects = [{**item, "controls": thinned(item["controls"])} for item in objects]
    missing = {at: [{**each, "controls": thinned(each["controls"])} for each in own] for at, own in missing.items()}
    recent = [at for at, item in enumerate(objects) if item["status"] == TRACKED and item["probation"]]
    shown = dict(missing)
    for at in recent:
        shown[at] = [{"pose": objects[at]["pose"], "controls": objects[at]["controls"], "kept": True}]
    search = _Search(image, intrinsics, level, palette_of(image, [item["slots"] for item in objects]))
    maps = maps_of(image)
    settled = [item for at, item in enumerate(objects) if at not in recent]
    beside = maps.without(_outlines(settled, intrinsics))
    judged = _judged(search, beside, objects, shown) if any(missing.values()) else None
    found = _decided(judged, objects, list(missing), recent, level) if judged is not None else {}
    places = {objects[at]["id"]: at for at in missing}
    maps = maps.without(_outlines(objects, intrinsics))
    for sweep in sweeps:
        if sweep["id"] not in places:  # it is seen again
            continue
        at = places[sweep["id"]]
        known = found.get(at, Sighting(NO_POSES))
        if known.lead > const.CLEAR_NATS:
            continue
        fresh = _fresh(search, maps, objects, at, sweep)
        found[at] = known._replace(guesses=np.concatenate((known.guesses, fresh)))
    return found


def _reduced(image: Image, intrinsics: Array) -> tuple[Image, Array, Callable[[ControlPoints], ControlPoints]]:
    """The image as large as images are that the search is made for, or not much larger; with (fx, fy, cx, cy) of that,
    and what thins control points out as much, which are as far apart in pixels in every image."""
    times = round(image.shape[1] / const.SEARCHED_WIDE_PX)
    if times <= 1:
        return image, intrinsics, lambda controls: controls
    wide, high = image.shape[1] // times, image.shape[0] // times
    small = cv2.resize(image[: high * times, : wide * times], (wide, high), interpolation=cv2.INTER_AREA)
    lens = intrinsics / times + np.array([0.0, 0.0, 1.0, 1.0]) * (0.5 / times - 0.5)

    def thinned(controls: ControlPoints) -> ControlPoints:
        parts: dict[str, Any] = {**controls}
        fields: Any = {name: part[::times] for name, part in parts.items()}
        found: ControlPoints = fields
        return found

    return np.asarray(small, np.float32).reshape(high, wide, -1), lens, thinned


class _Search(NamedTuple):
    image: Image
    intrinsics: Array
    level: Floats
    palette: Floats | None

    def aligned(
        self,
        controls: Sequence[ControlPoints],
        looks: list[Looks],
        poses: Floats,
        how: Search,
        most: int,
        rough_m: float = 0.0,
    ) -> tuple[Aligned, Floats, Floats] | None:
        """Poses (n, 4, 4), each with its control points and what is remembered of its object, aligned to the image;
        how unlikely that is (n,), nats, and the covariances (n, 6, 6)."""
        every = gathered(controls)
        places = every.rows_of(range(len(controls)), most)
        chosen = every.of(places)
        memory = memory_of(looks, every, self.image.shape[2])
        supports = poses[:, :3, :3].transpose(0, 2, 1) @ self.level[:3]
        off = np.stack([held(const.RESTING_OFF, support, const.OFF_UPWARDS, const.OFF_TILTING) for support in supports])
        off[:, :3, :3] += rough_m**2 * np.einsum("ni,nj->nij", supports, supports)
        information = inverse(off)
        rows = only(memory, np.concatenate(places))
        found = align(self.image, chosen, Start(poses, information), self.intrinsics, rows, how)
        if found is None:
            return None
        away = log_many(invert_many(poses) @ found.poses)
        return found, 0.5 * squared(away, information), inverse(information + found.blocks[:, 6:, 6:])


def _judged(
    search: _Search, maps: Maps, objects: Sequence[TrackedObject], missing: Mapping[int, Sequence[Alternative]]
) -> Judged | None:
    """The guesses of the missing objects, each aligned with what would be seen of it."""
    rows = [(at, other) for at, others in missing.items() for other in others if len(other["controls"]["points"])]
    if not rows:
        return None
    controls = [other["controls"] for _, other in rows]
    looks = [only_found(objects[at]["slots"]) for at, _ in rows]
    whose, poses = np.array([at for at, _ in rows]), np.stack([other["pose"] for _, other in rows])
    found = search.aligned(controls, looks, poses, FINE, const.POINTS_MAX)
    if found is None:
        return None
    nats = explains(found[0])
    jump = _jump(poses, found[0], nats, whose, search.intrinsics)
    again = None if jump is None else search.aligned(controls, looks, jump @ poses, FINE, const.POINTS_MAX)
    if again is not None:
        after = explains(again[0])
        if _best_of_each(after, whose) > _best_of_each(nats, whose):
            found, nats = again, after
    fine, unlikely, covariance = found
    told = shares(fine)
    beside = painted(fine) + stands_out(maps, fine.poses, controls, search.intrinsics)
    colours, *others = dyed_as(fine, search.palette, [whose, *([at] * len(rows) for at in missing)])
    bearers = sum(each > const.CLEAR_NATS for each in others)  # of how many of them each has the colours
    known = (colours > const.CLEAR_NATS) & (bearers == 1) & (fine.scores >= const.SURE_SCORE)
    beside += colours
    boxes = np.stack([_box(each) for each in controls])
    lines = np.concatenate((fine.stage.lines.pixels, fine.stage.lines.normals), axis=1)
    owners = fine.stage.controls.owners
    edges = [lines[(owners == row) & fine.supported] for row in range(len(rows))]
    worth = nats + beside - unlikely
    worth[is_another(colours)] = -np.inf
    seen = np.array([objects[at]["slots"]["tolerance"] is not None for at in whose])
    fits = fine.scores >= np.where(seen, const.FOUND_SCORE, const.LEARNED_SCORE)
    said = told.peaks + told.looks
    return Judged(whose, fine, nats, worth, covariance, boxes, edges, said, beside, colours, known, fits)


def _jump(poses: Floats, fine: Aligned, nats: Floats, owners: Array, intrinsics: Array) -> Floats | None:
    """(4, 4) how the camera is turned beside what was reported, by where the likeliest poses (n, 4, 4) of all objects
    were found, each beside where it came; None where that is so little that all found their own edges. A report that is
    off by some pixels puts all guesses beside other edges; as long as nothing is tracked nothing else tells that."""
    likeliest = [own[nats[own].argmax()] for own in _of_each(owners)]
    sure = [row for row in likeliest if fine.scores[row] >= const.SURE_SCORE]
    if not sure:
        return None
    across, down = np.median(flat(fine.poses[sure]) - flat(poses[sure]), axis=0)
    if np.hypot(across, down) * intrinsics[0] < const.JUMP_PX:
        return None
    return make_pose(exp_so3(np.array([-down, across, 0.0])), np.zeros(3))


def _best_of_each(nats: Floats, owners: Array) -> float:
    """Nats (n,) of the likeliest pose of each object, together."""
    return float(sum(max(nats[own].max(), 0.0) for own in _of_each(owners)))


def _of_each(owners: Array) -> list[Array]:
    """Of each object the rows of its poses."""
    return [np.nonzero(owners == at)[0] for at in np.unique(owners)]


def _decided(
    judged: Judged, objects: Sequence[TrackedObject], missing: Sequence[int], recent: Sequence[int], level: Floats
) -> dict[int, Sighting]:
    """What is believed of the missing objects, and of those that were found just now: these give way."""
    fine, worth = judged.fine, judged.worth
    placed = [_placed(item) for at, item in enumerate(objects) if item["status"] == TRACKED and at not in recent]
    staying = [each for each in placed if each is not None]
    free = [not any(is_in(fine.poses[row], judged.boxes[row], *each) for each in staying) for row in range(len(worth))]
    possible = np.array(free) & (fine.scores >= const.KEPT_SCORE) & (fine.shown >= const.LEAST_FOUND)
    ranked: dict[int, list[int]] = {}
    for at in missing:
        own = np.nonzero((judged.owners == at) & possible)[0]
        ranked[at] = different(fine.poses, own[np.argsort(-worth[own], kind="stable")], const.OLD + 1)
    together = _together(judged, ranked, recent, staying, level)
    least = np.where(fine.scores > const.SURE_SCORE, const.LEAST_NATS, const.SURE_NATS)
    best, chosen = together.best(())
    never_seen = [objects[at] for at in missing if objects[at]["slots"]["tolerance"] is None]
    ready = all(item["failed_searches"] >= const.SWEEPS_FIRST for item in never_seen if item["status"] == LOST)
    found = {at: Sighting(NO_POSES) for at in recent if together.options[at] and at not in chosen and ready}
    for at in missing:
        row = chosen.get(at)
        gained = 0.0 if row is None else together.hidden.gain(row, chosen.values())
        sure = (
            row is not None
            and (ready or judged.known[row])
            and worth[row] + gained > least[row]
            and judged.nats[row] + judged.colours[row] + gained > const.LEAST_EDGES
            and fine.shown[row] > const.LEAST_IN_SIGHT
        )
        lead, known = 0.0, False
        if row is not None and sure:
            lead = best - together.best(look_alike(judged, row, together.options[at]))[0]
            known = bool(judged.known[row]) and lead > const.CLEAR_NATS
            sure = known or (ready and lead > const.CLEAR_NATS / const.CONFIRMED)
        kept = [other for other in ranked[at] if other != row or not sure][: const.OLD]
        guesses = fine.poses[kept] if kept else NO_POSES
        found[at] = Sighting(guesses)
        if row is not None and sure:
            said = float(fine.scores[row]), float(judged.nats[row] + judged.colours[row]), lead
            again = _is_again(fine.poses[row], objects[at])
            found[at] = Sighting(guesses, fine.poses[row], judged.covariance[row], *said, again, known)
    return found


def _together(
    judged: Judged,
    ranked: Mapping[int, list[int]],
    recent: Sequence[int],
    staying: Sequence[tuple[Floats, Floats]],
    level: Floats,
) -> Together:
    """What is chosen of: for each of the missing objects that images say most of its best rows, if others that hide
    parts of it could make them likely; and those that were found just now."""
    worth = judged.worth
    first = sorted(ranked, key=lambda at: -max(worth[ranked[at]], default=-np.inf))[: const.RIVALS]
    options = {at: np.nonzero(judged.owners == at)[0].tolist() for at in recent}
    options |= {at: [row for row in ranked[at] if judged.fits[row]] for at in first}
    hidden = hidden_of(judged, [row for own in options.values() for row in own])

    def most(row: int) -> float:
        gains = [max((hidden.gain(row, (other,)) for other in own), default=0.0) for own in options.values()]
        return float(worth[row]) + sum(gain for gain in gains if gain > 0.0)

    options |= {at: [row for row in options[at] if most(row) > const.LEAST_NATS] for at in first}
    rows = [row for own in options.values() for row in own]
    carriers, conflicts = carriers_of(judged, rows, staying, level), conflicts_of(judged, rows, level)
    return Together(options, np.maximum(worth, 1.0), conflicts, carriers, len(ranked) + len(recent), hidden)


def _is_again(pose: Floats, item: TrackedObject) -> bool:
    """Whether the image before had a missing object there, too: at the first of its guesses."""
    if not item["lead"] or not item["others"]:
        return False
    before = item["others"][0]["pose"]
    return is_near(before, alike(item["symmetry"], pose[None], before)[0] if "symmetry" in item else pose)


def _placed(item: TrackedObject) -> tuple[Floats, Floats] | None:
    """Where an object is, and its box; None of one of which nothing is to be seen."""
    return (item["pose"], _box(item["controls"])) if len(item["controls"]["points"]) else None


def _box(controls: ControlPoints) -> Floats:
    return np.array([controls["points"].min(axis=0), controls["points"].max(axis=0)])


def _outlines(objects: Sequence[TrackedObject], intrinsics: Array) -> list[Floats]:
    """Of each object that is seen, the pixels (n, 2) of its edges."""
    seen = [item for item in objects if item["status"] == TRACKED and len(item["controls"]["points"])]
    return [pixels_of(transform(item["pose"], item["controls"]["points"]), intrinsics) for item in seen]


def _fresh(search: _Search, maps: Maps, objects: Sequence[TrackedObject], at: int, sweep: Sweep) -> Floats:
    """(n, 4, 4) the poses of a sweep, of one of the objects, that explain the image best."""
    if not len(sweep["places"]):
        return NO_POSES
    proposed = swept(maps, sweep, search.intrinsics)
    controls = [sweep["templates"][number]["controls"] for number in proposed.templates]
    seen = uncovered(maps, proposed.poses, controls, search.intrinsics)
    looks = [only_found(objects[at]["slots"])] * len(seen)
    found = search.aligned(seen, looks, proposed.poses, ROUGH, const.ROUGH_POINTS, sweep["rough_m"])
    if found is None:
        return NO_POSES
    rough, unlikely, _ = found
    worth = explains(rough) + stands_out(maps, rough.poses, controls, search.intrinsics) - unlikely
    worth += dyed(rough, search.palette, [at] * len(worth))
    # By turns the best by all that speaks for them, and those that faces alone had before the others: these as they
    # were, as edges of what is dark, and beside its shadow, lead astray; but for heights, which are known about.
    count = len(worth)
    order = np.stack((np.argsort(-worth, kind="stable"), count + np.arange(count)), axis=1).ravel()
    every = np.concatenate((rough.poses, rough.poses if sweep["rough_m"] else proposed.poses))
    return np.asarray(every[different(every, order, const.FRESH)])
