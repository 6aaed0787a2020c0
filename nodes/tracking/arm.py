"""The arm node: poses of objects relative to its camera, corrected by edges in the image (theory, example 3).

The node has no models. What it knows of the objects' shapes are the control points on expected
edges that it takes from the context; without context its objects are lost.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking import schema
from hierax.nodes.tracking.display import arm_things
from hierax.nodes.tracking.errors import check_between, check_positive
from hierax.nodes.tracking.estimation.appearance import only_found
from hierax.nodes.tracking.estimation.certainty import right
from hierax.nodes.tracking.estimation.drift import joint_of, lasting
from hierax.nodes.tracking.estimation.fusion import Known
from hierax.nodes.tracking.estimation.ground import View, corrected, covered_by, told_by
from hierax.nodes.tracking.estimation.palette import is_another
from hierax.nodes.tracking.estimation.profiles import Image, smoothed
from hierax.nodes.tracking.estimation.sizes import sizes_of
from hierax.nodes.tracking.estimation.tracked import (
    NO_CONTROLS,
    check_ids,
    diagonal_covariance,
    first_belief,
    imagined,
    tracked_metrics,
)
from hierax.nodes.tracking.math.geometry import NO_POSES, Array, Floats, exp_se3, invert, log_se3
from hierax.nodes.tracking.model.symmetry import NONE, open_to
from hierax.nodes.tracking.search.association import Associated, Estimate, Options, associate
from hierax.nodes.tracking.search.missing import Sighting, look_for_missing
from hierax.nodes.tracking.search.multistart import held, in_turn
from hierax.runtime import NO_TICK, Node, Step, Tick, Value
from hierax.runtime.core.showing import Things

_Objects = tuple[schema.TrackedObject, ...]


_NO_TEXTURE: schema.Texture = {"covered": np.zeros((0, 0), dtype=np.uint8), "ground": None, "alike": 1.0}
_NO_IMAGE = np.zeros((0, 0, 1), dtype=np.float32)  # where nothing is expected that it could show


class ArmNode(Node):
    """Tracks objects with the camera of an arm.

    The belief is an `ArmBelief`, see `hierax.nodes.tracking.schema`.

    Args:
        objects: ``id``, ``obj_id`` and ``pose`` (camera_from_object in the first frame) of each.
        start_m, start_rad: standard deviation of the first poses, in each axis.
        motion_m, motion_rad: of the objects' deviation from their prediction within a frame, when they are pushed.
        camera_m, camera_rad: of the reported camera's deviation from its course, while it moves.
        drift_m, drift_rad: of how far that course is from the camera's in the long run; None: nothing bounds it.
        sure_score: a match that scores less is also looked for farther away.
        kept_score: an image that scores a pose below this does not support it.
        patience: images that speak against an object, none of which supports it, until it is lost.
        prior: false: an image corrects poses as if nothing were known of them but where to look.
        model_tolerance_mm: standard deviation of where edges are beside their models', in each axis; 0: models are
            exact, and as large as objects; None: the first image that shows enough of an object tells.
        waits: up to this epoch it waits for its first context, and objects stay where they are said to be: the spatial
            node may take part, or its predictions count, from a later epoch on only.
        camera: of a camera there might have been, world_from_camera, from which the first poses are seen; None: they
            are seen from the first image's.
        table_texture: whether the table's texture tells how the camera has moved, where it is not exactly where it is
            said to be.

    Raises ValueError: ids are doubled or out of range, a pose is no 4 × 4 matrix, or an option is out of range.
    """

    def __init__(
        self,
        objects: Sequence[schema.FirstPose],
        start_m: float = const.START_M,
        start_rad: float = const.START_RAD,
        motion_m: float = const.MOTION_M,
        motion_rad: float = const.MOTION_RAD,
        camera_m: float = const.CAMERA_M,
        camera_rad: float = const.CAMERA_RAD,
        drift_m: float | None = None,
        drift_rad: float | None = None,
        sure_score: float = const.SURE_SCORE,
        kept_score: float = const.KEPT_SCORE,
        patience: int = const.PATIENCE,
        prior: bool = True,
        model_tolerance_mm: float | None = None,
        waits: int = 0,
        camera: Floats | None = None,
        table_texture: bool = True,
    ) -> None:
        check_positive(start_m=start_m, start_rad=start_rad, motion_m=motion_m, motion_rad=motion_rad)
        check_positive(camera_m=camera_m, camera_rad=camera_rad)
        if not 0.0 <= kept_score <= const.FOUND_SCORE:
            raise ValueError(
                f"kept_score is {kept_score}; expected 0 to {const.FOUND_SCORE}, at which a lost one is found"
            )
        if patience < 1:
            raise ValueError(f"patience is {patience}; expected at least 1 image")
        start = diagonal_covariance(start_m, start_rad)
        self._objects = tuple(first_belief(item, start) for item in objects)
        check_ids(self._objects)
        if model_tolerance_mm is not None:
            check_between(0, 10, "millimetres", model_tolerance_mm=model_tolerance_mm)
        tolerance = None if model_tolerance_mm is None else model_tolerance_mm / 1000.0
        motion = diagonal_covariance(motion_m, motion_rad)
        self._options = Options(motion, sure_score, tolerance=tolerance)
        self._reports = diagonal_covariance(camera_m, camera_rad)
        self._lasts = np.repeat([lasting(camera_m, drift_m), lasting(camera_rad, drift_rad)], 3)
        self._sizes = const.SAME_SIZE if tolerance == 0.0 else const.SIZES
        self._kept_score = kept_score
        self._patience = patience
        self._prior = prior
        self._waits = waits
        self._first_camera = camera
        self._texture = table_texture and prior

    def initial_belief(self) -> schema.ArmBelief:
        """The objects where they are said to be; no camera, no edges yet."""
        return {
            "camera": self._first_camera,
            "reported": None,
            "drift": np.eye(4),
            "together": None,
            "intrinsics": None,
            "size": None,
            "frame": None,
            "objects": self._objects,
            "sweeps": None,
        }

    def observe(self, observations: tuple[schema.Picture, ...], belief: schema.ArmBelief) -> schema.ArmBelief:
        """τ: the objects' predicted poses, seen from where the camera is now, corrected by the image; without one
        nothing is tracked."""
        if not observations:
            begun = belief["intrinsics"] is not None
            unseen = tuple(self._blind(item) if begun else item for item in belief["objects"])
            return {**belief, "frame": None, "objects": unseen}
        seen = observations[0]
        reported = np.asarray(seen["camera"], dtype=np.float64)
        before, said = belief["camera"], belief["reported"]
        still = said is None or np.array_equal(said, reported)
        drift = belief["drift"] if still else self._left_of(belief["drift"])
        camera = reported @ drift if before is None or said is None or not still else before
        moved = np.eye(4) if before is None else invert(camera) @ before
        objects: _Objects = tuple(
            {
                **item,
                "pose": moved @ item["pose"],
                "before": moved @ item["before"],
                "others": tuple({**other, "pose": moved @ other["pose"]} for other in item["others"]),
            }
            for item in belief["objects"]
        )
        sweeps = _moved(belief["sweeps"], moved)
        present = tuple(item for item in objects if sweeps is None or not _is_missing(item))
        shown = sweeps is not None or _is_anything_expected(present)
        image = smoothed(seen["image"]) if shown else _NO_IMAGE
        view = None if still else View(seen["image"], camera, seen["intrinsics"])
        known, texture = self._known(present, belief, view)
        found = self._associated(present, image, seen["intrinsics"], known)
        corrected, shift = self._corrected(present, found), np.eye(4) if found is None else found.shift
        after = {item["id"]: item for item in corrected}
        guessed = {item["id"]: _guessed(item, shift) for item in objects}
        objects = tuple(after.get(item["id"]) or {**item, "others": guessed[item["id"]]} for item in objects)
        camera = camera @ invert(shift)
        sweeps = _moved(sweeps, shift)
        if sweeps is not None:
            objects = self._searched(image, objects, guessed, sweeps, seen["intrinsics"], camera[2])
        height, width = seen["image"].shape[:2]
        return {
            "camera": camera,
            "reported": reported,
            "drift": drift if found is None else drift @ exp_se3(-found.drift),
            "together": None if still else belief["together"] if found is None else found.together,
            "intrinsics": np.asarray(seen["intrinsics"], dtype=np.float64),
            "size": (width, height),
            "frame": seen["frame"],
            "objects": objects,
            "sweeps": None,
            **_texture_after(belief, texture, found, camera),
        }

    def predict(
        self,
        context: tuple[schema.Imagery, ...],
        actions: schema.Nothing,
        belief: schema.ArmBelief,
        tick: Tick = NO_TICK,
    ) -> schema.ArmBelief:
        """γ: where the objects will be, and which of their edges will be seen, both from the context that
        `hierax.nodes.tracking.render.SegmentedDepth` gives; without any the arm knows no shapes, and every object is
        lost."""
        camera = belief["camera"]
        if belief["intrinsics"] is None:  # nothing was ever seen
            return belief
        if not context and 0 < tick.epoch <= self._waits:
            return belief
        if camera is None or not context:
            return {**belief, "objects": tuple(_shapeless(item) for item in belief["objects"])}
        expected = {item["id"]: item for item in context[0]["poses"]}
        objects = tuple(
            imagined(item, expected[item["id"]], camera) if item["id"] in expected else _shapeless(item)
            for item in belief["objects"]
        )
        after: schema.ArmBelief = {**belief, "objects": objects, "sweeps": _moved(context[0]["sweeps"], invert(camera))}
        if not self._texture or context[0]["sweeps"] is None:
            return after
        known = belief.get("texture", _NO_TEXTURE)
        return {**after, "texture": {**known, "covered": covered_by(context[0])}}

    def metrics(self, belief: schema.ArmBelief) -> Mapping[str, float]:
        """How many objects are tracked, and the mean score."""
        return tracked_metrics(belief["objects"])

    def show(self, step: Step, before: Value) -> Things:
        """The image with edges, the camera, the scores, and what speaks for the poses."""
        return arm_things(step, before, self._options.motion)

    def _known(
        self, objects: _Objects, belief: schema.ArmBelief, view: View | None
    ) -> tuple[Known | None, schema.Texture | None]:
        """What is known of the camera and all objects together before an image, and, where there is a table, of its
        texture when that was looked at; view: None where the camera stands still, so that it is where it was."""
        texture = belief.get("texture")
        if view is None:
            return None, texture and {**texture, "ground": None}
        if not _is_anything_expected(objects):
            return None, texture
        together = belief["together"] if self._prior else None
        sizes = None if texture is None else sizes_of(objects, together, texture["alike"], self._sizes)
        joint = joint_of(self._believed(objects), together, self._reports, self._sizes, self._lasts, sizes)
        if texture is None or sizes is None:
            return Known(joint), None
        told = told_by(view, texture, joint)
        return told.known._replace(sizes=sizes.told), {**texture, "ground": told.ground, "alike": sizes.alike}

    def _associated(self, objects: _Objects, image: Image, intrinsics: Array, known: Known | None) -> Associated | None:
        """What the image says; None where nothing of any object is expected in it."""
        if not _is_anything_expected(objects):
            return None
        motion = np.stack([self._motion(item) for item in objects])
        falling = np.stack([held(self._options.motion, item["support"], const.FALLING, 1.0) for item in objects])
        options = self._options._replace(motion=motion, falling=falling)
        return associate(image, self._believed(objects), known, np.asarray(intrinsics), options)

    def _believed(self, objects: _Objects) -> _Objects:
        """The objects, of which nothing is known where there is to be no prior."""
        return objects if self._prior else tuple({**item, "covariance": const.UNKNOWN} for item in objects)

    def _left_of(self, drift: Floats) -> Floats:
        """What is left of a drift in the next image."""
        return drift if np.all(self._lasts == 1.0) else exp_se3(self._lasts * log_se3(drift))

    def _corrected(self, objects: _Objects, found: Associated | None) -> _Objects:
        """The objects after the image."""
        if found is None:
            return tuple(map(self._blind if _is_anything_expected(objects) else self._out_of_view, objects))
        seen = zip(objects, found.estimates, strict=True)
        return tuple(_sought(self._judged(item, found.shift @ item["pose"], each)) for item, each in seen)

    def _searched(
        self,
        image: Image,
        objects: _Objects,
        guessed: Mapping[int, tuple[schema.Alternative, ...]],
        sweeps: tuple[schema.Sweep, ...],
        intrinsics: Array,
        level: Floats,
    ) -> _Objects:
        """The objects after those that are missing, or looked for everywhere as well, were looked for."""
        swept = {sweep["id"] for sweep in sweeps}
        missing = {
            at: guessed[item["id"]]
            for at, item in enumerate(objects)
            if _is_missing(item) or (item["status"] == schema.EXPECTED and (item["id"] in swept or guessed[item["id"]]))
        }
        carried = any(_is_missing(item) for item in objects)  # by what is not found yet, maybe
        objects = tuple(_missing(item) if _is_refuted(item, carried) else item for item in objects)
        if not missing:
            return objects
        found = look_for_missing(image, objects, missing, sweeps, np.asarray(intrinsics), level)
        return tuple(
            _sighted(item, found[at], item["id"] in swept) if at in found else item for at, item in enumerate(objects)
        )

    def _motion(self, item: schema.TrackedObject) -> Floats:
        """(6, 6) how far it may leave its prediction within a frame: what stands slides, and turns where it is."""
        upwards, tilting = (const.UPWARDS, const.TILTING) if item["stands"] else (const.FALLING, 1.0)
        return held(self._options.motion, item["support"], upwards, tilting)

    def _judged(self, item: schema.TrackedObject, expected: Floats, estimate: Estimate) -> schema.TrackedObject:
        """One object after the image: where it was found, or where it was expected."""
        gone = _is_vague(item) or item["status"] == schema.LOST
        needed = const.FOUND_SCORE if gone else self._kept_score
        enough = const.LEAST_FOUND if gone else const.LEAST_SHOWN
        doubtful = _speaks_against(estimate) or (gone and not estimate.sure)
        # Of an imprecise model edges may be missing: it is not by their share that one of them is there.
        doubtful |= estimate.score < needed and (gone or not estimate.slots["tolerance"])
        if estimate.shown < enough or doubtful:
            # Not enough to say that it is there; but enough to look there, at what would be seen of it, next.
            searched = estimate.elsewhere and not item["others"]
            guess = estimate.pose if searched and estimate.score > self._kept_score else expected
            return self._missed(item, guess, estimate)
        return {
            **item,
            "pose": estimate.pose,
            "covariance": estimate.covariance,
            "motion_scale": estimate.motion_scale,
            "trend": estimate.trend,
            "score": estimate.score,
            "nats": estimate.nats,
            "probability": estimate.probability,
            "probation": const.PROBATION if gone else max(0, item["probation"] - 1),
            "lead": 0.0,
            "slots": estimate.slots,
            "failed_searches": _failed_searches(item, estimate),
            "guesses": estimate.guesses,
            "status": schema.TRACKED,
            "misses": 0,
            "denied": 0,
        }

    def _blind(self, item: schema.TrackedObject) -> schema.TrackedObject:
        """One object where there is no image: what it was expected to be."""
        return _sought(self._missed(item, item["pose"], None))

    def _out_of_view(self, item: schema.TrackedObject) -> schema.TrackedObject:
        """One object where nothing of any is expected in the image: what was tracked is seen no more, and what was
        guessed of an earlier image is not of this one."""
        return self._blind(item) if item["status"] == schema.TRACKED else {**item, "guesses": NO_POSES}

    def _missed(self, item: schema.TrackedObject, expected: Floats, estimate: Estimate | None) -> schema.TrackedObject:
        """One object that the image does not support: its prediction stands, until patience ends. That something which
        nothing is to be seen of is not seen says nothing against it, nor does an image that clutter explains no
        better."""
        hidden = estimate is None or float(item["controls"]["visible"].sum()) < const.LEAST_SHOWN
        denied = item["denied"] + int(not hidden and estimate is not None and _speaks_against(estimate))
        lost = item["status"] == schema.LOST or denied >= self._patience
        score = 0.0 if lost or estimate is None else estimate.score
        motion_scale = item["motion_scale"] if hidden or _is_vague(item) else 1.0
        return {
            **item,
            "pose": expected,
            "score": score,
            "nats": 0.0 if estimate is None else estimate.nats,
            "probability": 0.0,
            "lead": 0.0,
            "status": schema.LOST if lost else schema.EXPECTED,
            "misses": item["misses"] + (not hidden),
            "denied": denied,
            "motion_scale": motion_scale,
            "failed_searches": item["failed_searches"] if estimate is None else _failed_searches(item, estimate),
            "guesses": NO_POSES if estimate is None else estimate.guesses,
            "covariance": item["covariance"] + motion_scale**2 * self._motion(item),
        }


def _speaks_against(estimate: Estimate) -> bool:
    """Whether an image is explained better without an object, or shows something else in its place."""
    return estimate.nats < 0.0 or bool(is_another(estimate.colours))


def _sighted(item: schema.TrackedObject, sighting: Sighting, swept: bool) -> schema.TrackedObject:
    """An object after it was looked for; one that was found just now gives way to what explains its place better. It is
    not found before as many nats say so as so many images in a row that are clear, unless its colours say so."""
    pose, guesses = sighting.pose, sighting.guesses
    likely = guesses if pose is None else np.concatenate((pose[None], guesses))
    if item["status"] == schema.EXPECTED and sighting.lead <= const.CLEAR_NATS:  # where it is expected may be right
        return {**item, "guesses": np.concatenate((likely, item["guesses"]))}
    if pose is None or sighting.covariance is None:
        before = item["failed_searches"] if item["status"] == schema.LOST else 0
        return {**_missing(item), "guesses": likely, "failed_searches": before + swept}
    lead = min(sighting.lead, const.CLEAR_NATS) + item["lead"] * sighting.again
    if lead < const.CONFIRMED * const.CLEAR_NATS and not sighting.known:
        looked = max(item["failed_searches"], const.SWEEPS_FIRST)
        return {**_missing(item), "guesses": likely, "lead": lead, "failed_searches": looked}
    symmetry = item.get("symmetry", NONE)
    return {
        **item,
        "slots": only_found(item["slots"]),
        "pose": pose,
        "before": pose,
        "covariance": sighting.covariance,
        "score": sighting.score,
        "nats": sighting.nats,
        "probability": float(right(sighting.covariance[None], np.array([sighting.nats]), [symmetry])[0]),
        "motion_scale": 1.0,
        "trend": np.zeros(6),
        "status": schema.TRACKED,
        "misses": 0,
        "denied": 0,
        "probation": const.PROBATION,
        "lead": 0.0,
        "failed_searches": 0,
        "guesses": guesses,
    }


def _missing(item: schema.TrackedObject) -> schema.TrackedObject:
    """The same, of which nobody knows where it is."""
    return {**unseen(item), "probation": 0}


def _is_anything_expected(objects: _Objects) -> bool:
    return any(len(item["controls"]["points"]) for item in objects)


def _texture_after(
    belief: schema.ArmBelief, texture: schema.Texture | None, found: Associated | None, camera: Floats
) -> schema.MayKnowTexture:
    """What is known of the table's texture after an image; camera: as that has it."""
    if texture is None:
        return {}
    ground, before = texture["ground"], belief["texture"]["ground"]
    if found is None or ground is None:
        return {"texture": {**texture, "ground": ground and before}}
    return {"texture": {**texture, "ground": corrected(ground, camera, ground is not before, found.older)}}


def _moved(sweeps: tuple[schema.Sweep, ...] | None, by: Floats) -> tuple[schema.Sweep, ...] | None:
    """Sweeps, seen from another frame."""
    return sweeps and tuple({**sweep, "places": by @ sweep["places"]} for sweep in sweeps)


def _guessed(item: schema.TrackedObject, shift: Floats) -> tuple[schema.Alternative, ...]:
    """Where an object was guessed to be, seen from where the camera turned out to be: shift @ pose."""
    return tuple({**other, "pose": shift @ other["pose"]} for other in item["others"] if other["kept"])


def _is_missing(item: schema.TrackedObject) -> bool:
    """Whether nobody imagines where it is."""
    return item["status"] == schema.LOST and not len(item["controls"]["points"])


def _is_refuted(item: schema.TrackedObject, carried: bool) -> bool:
    """Whether images are explained better without an object that was found just now, or have it where it cannot rest:
    it was found where it can."""
    doubted = item["status"] == schema.TRACKED or item["misses"] >= const.CONFIRMED
    seen = float(item["controls"]["visible"].sum()) >= const.LEAST_SHOWN
    return (
        doubted
        and seen
        and item["probation"] > 0
        and (item["nats"] < 0.0 or (item["hangs"] > 3 * const.CONFIRMED and not carried))
    )


def _shapeless(item: schema.TrackedObject) -> schema.TrackedObject:
    """The same where nobody says what would be seen of it."""
    return {**unseen(item), "controls": NO_CONTROLS, "edges": np.zeros((0, 2, 3))}


def unseen(item: schema.TrackedObject) -> schema.TrackedObject:
    """The same where no image says anything of it, and nobody knows where it is."""
    return {**item, "score": 0.0, "nats": 0.0, "probability": 0.0, "lead": 0.0, "status": schema.LOST}


def _sought(item: schema.TrackedObject) -> schema.TrackedObject:
    """The same, with whether it is to be imagined elsewhere, too: it is not seen, or was found just now."""
    missing = item["status"] != schema.TRACKED or item["probation"] > 0
    return {**item, "sought": missing and in_turn(item), "others": ()}


def _failed_searches(item: schema.TrackedObject, estimate: Estimate) -> int:
    """For how many images it was not found elsewhere; that counts anew when something happens to it."""
    startled = estimate.motion_scale == 1.0 and item["motion_scale"] < 1.0
    startled |= len(estimate.guesses) > 0
    return 0 if startled or estimate.score < const.LESS * item["score"] else estimate.failed_searches


def _is_vague(item: schema.TrackedObject) -> bool:
    covariance = item["covariance"]
    if "symmetry" in item and len(item["symmetry"]["free"]):
        told = open_to(item["symmetry"])
        covariance = told @ covariance @ told
    turned = float(np.trace(covariance[3:, 3:])) > const.VAGUE_RAD**2
    return turned or float(np.trace(covariance[:3, :3])) > const.VAGUE_M**2


def poses_seen(belief: schema.ArmBelief) -> tuple[schema.Seen, ...]:
    """φ of the arm: where each of its objects is in the world, then its camera; none before the first image."""
    camera = belief["camera"]
    if camera is None or belief["intrinsics"] is None or belief["size"] is None or belief["frame"] is None:
        return ()
    objects = tuple(_seen_in_world(item, camera) for item in belief["objects"])
    seen: schema.SeenCamera = {
        "camera": camera,
        "intrinsics": belief["intrinsics"],
        "size": belief["size"],
        "frame": belief["frame"],
    }
    return (*objects, seen)


def _seen_in_world(item: schema.TrackedObject, camera: Floats) -> schema.SeenObject:
    return {
        "id": item["id"],
        "obj_id": item["obj_id"],
        "covariance": item["covariance"],
        "score": item["score"],
        "status": item["status"],
        "motion_scale": item["motion_scale"],
        "sought": item["sought"],
        "pose": camera @ item["pose"],
        "guesses": camera @ item["guesses"],
    }
