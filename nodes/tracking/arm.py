"""The arm node: poses of objects relative to its camera, corrected by edges in the image (theory, example 3).

The node has no models. What it knows of the objects' shapes is the expected edges that it
takes from the context, a segmented depth image; without context its objects are lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.tracking.edges import NO_EDGES, visible_edges
from hierax.nodes.tracking.geometry import Array, Floats, exp_se3, invert, log_se3, transform
from hierax.nodes.tracking.matching import Image, Match, match, shifted, smoothed
from hierax.runtime import Elements, Node, Value

TRACKED = "tracked"
EXPECTED = "expected"
LOST = "lost"

_WIDER_STARTS = (1.0, 0.0, 0.5, 1.5, 2.0)
_WIDER_VARIANCE = 9.0
_BETTER = 0.05

_SURPRISED = 1.5
_CALMING = 0.85
_LEAST_UNREST = 0.1

Tracked = dict[str, Any]


class ArmNode(Node):
    """Tracks objects with the camera of an arm.

    The belief: ``camera`` (world_from_camera, (4, 4); None before the first image),
    ``intrinsics`` ((4,) fx, fy, cx, cy), ``size`` (w, h), ``frame`` (the newest image's
    number) and ``objects``, a tuple of

    - ``id``: label in this scene, 1 to 255; ``obj_id``: number of the model;
    - ``pose``: camera_from_object, seen from ``camera``; ``before``: the same an image earlier;
      ``covariance``: (6, 6) of the pose's error as a twist in the object's frame (m², rad²);
    - ``score``: 0 to 1; ``status``: ``tracked`` (the newest image supports the pose),
      ``expected`` (known from prediction alone) or ``lost``; ``misses``: images in a row without support;
      ``unrest``: 0.1 to 1, how much of `motion_m` and `motion_rad` its latest motion asks for;
    - ``edges``: (n, 2, 3) ends of the edges expected to be seen, object's frame, metres;
      ``kinds``: (n,) uint8, see `hierax.nodes.tracking.edges`.

    Args:
        objects: ``id``, ``obj_id`` and ``pose`` (camera_from_object in the first frame) of each.
        start_m, start_rad: standard deviation of the first poses, in each axis.
        motion_m, motion_rad: of the objects' deviation from their prediction within a frame.
        error_px: standard deviation of a match, as if its control points erred by this independently; they
            err together, along an edge and from image to image, so it is larger than one of them errs.
        sure_score: a match that scores less is also looked for farther away.
        kept_score: an image that scores a pose below this does not support it.
        found_score: a lost object is found again at this score.
        patience: images in a row without support until an object is lost.

    Raises:
        ValueError: ids are doubled or out of range, a pose is no 4 × 4 matrix, or an option is out of range.
    """

    def __init__(
        self,
        objects: Sequence[Mapping[str, Any]],
        start_m: float = 0.005,
        start_rad: float = 0.035,
        motion_m: float = 0.010,
        motion_rad: float = 0.06,
        error_px: float = 0.5,
        sure_score: float = 0.8,
        kept_score: float = 0.35,
        found_score: float = 0.6,
        patience: int = 10,
    ) -> None:
        deviations = {"start_m": start_m, "start_rad": start_rad, "motion_m": motion_m, "motion_rad": motion_rad}
        deviations["error_px"] = error_px
        for name, number in deviations.items():
            if not number > 0.0:
                raise ValueError(f"{name} is {number}; expected a positive number")
        if not 0.0 <= kept_score <= found_score <= 1.0:
            raise ValueError(f"expected 0 <= kept_score <= found_score <= 1, got {kept_score} and {found_score}")
        if patience < 1:
            raise ValueError(f"patience is {patience}; expected at least 1 image")
        start = _covariance(start_m, start_rad)
        self._objects = tuple(_first_belief(item, start) for item in objects)
        ids = [item["id"] for item in self._objects]
        if len(set(ids)) != len(ids) or not all(1 <= number <= 255 for number in ids):
            raise ValueError(f"ids must be different and from 1 to 255, got {ids}")
        self._motion = _covariance(motion_m, motion_rad)
        self._error_px = error_px
        self._sure_score = sure_score
        self._kept_score = kept_score
        self._found_score = found_score
        self._patience = patience

    def initial_belief(self) -> Value:
        """The objects where they are said to be; no camera, no edges yet."""
        return {"camera": None, "intrinsics": None, "size": None, "frame": None, "objects": self._objects}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ: each object's predicted pose, seen from where the camera is now, corrected by the image.

        Args:
            observations: one element {"image", "camera", "intrinsics", "frame"}, or none.
            belief: as `predict` left it.
        """
        if not observations:
            return belief
        seen = observations[0]
        image = seen["image"]
        camera = np.asarray(seen["camera"], dtype=np.float64)
        moved = np.eye(4) if belief["camera"] is None else invert(camera) @ belief["camera"]
        wanted = any(len(item["edges"]) for item in belief["objects"])
        soft = smoothed(image) if wanted else None
        predicted = [
            {**item, "pose": moved @ item["pose"], "before": moved @ item["before"]} for item in belief["objects"]
        ]
        objects = tuple(self._corrected(item, soft, seen["intrinsics"]) for item in predicted)
        height, width = image.shape[:2]
        return {
            "camera": camera,
            "intrinsics": np.asarray(seen["intrinsics"], dtype=np.float64),
            "size": (width, height),
            "frame": seen["frame"],
            "objects": objects,
        }

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: where the objects will be, and which of their edges will be seen, both from the context.

        Args:
            context: one element as `hierax.nodes.tracking.render.SegmentedDepth` gives it, or
                none: then the arm knows no shapes, and every object is lost.
            actions: none.
            belief: as `observe` left it.
        """
        expected = {item["id"]: item for item in context[0]["poses"]} if context else {}
        objects = tuple(
            self._imagined(item, expected[item["id"]], context[0], belief["camera"])
            if item["id"] in expected
            else {**item, **_no_edges(), "score": 0.0, "status": LOST}
            for item in belief["objects"]
        )
        return {**belief, "objects": objects}

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """How many objects are tracked, and the mean score."""
        objects = belief["objects"]
        scores = [item["score"] for item in objects]
        return {
            "tracked": float(sum(item["status"] == TRACKED for item in objects)),
            "lost": float(sum(item["status"] == LOST for item in objects)),
            "score_mean": float(np.mean(scores)) if scores else 0.0,
        }

    def _corrected(self, item: Tracked, image: Image | None, intrinsics: Array) -> Tracked:
        """One object after the image: matched with a prior that allows for any motion, then filtered."""
        if image is None:
            return item
        found = self._matched(item, image, intrinsics)
        needed = self._found_score if item["status"] == LOST else self._kept_score
        if found is None or found.score < needed:
            return self._missed(item, found)
        return {**item, **self._filtered(item, found), "score": found.score, "status": TRACKED, "misses": 0}

    def _matched(self, item: Tracked, image: Image, intrinsics: Array) -> Match | None:
        """The best match near the prediction or, where that is not sure, farther along its motion."""
        loose = item["covariance"] + self._motion
        best = match(image, item["edges"], item["pose"], loose, intrinsics)
        if (best is not None and best.score >= self._sure_score) or not len(item["edges"]):
            return best
        motion = log_se3(invert(item["before"]) @ item["pose"])
        for part in _WIDER_STARTS:
            start = shifted(image, item["edges"], item["before"] @ exp_se3(part * motion), intrinsics)
            found = match(image, item["edges"], start, _WIDER_VARIANCE * loose, intrinsics)
            if found is not None and (best is None or found.score > best.score + _BETTER):
                best = found
        return best

    def _filtered(self, item: Tracked, found: Match) -> Tracked:
        """The prediction and the match, each as far as it is certain (a Kalman filter's update).

        How far an object may leave its prediction is learned from how far it did: something
        at rest is averaged over many images, something that is pushed is believed at once.
        """
        twist = log_se3(invert(item["pose"]) @ found.pose)
        error = np.linalg.inv(found.information) * self._error_px**2
        unrest = item["unrest"]
        predicted = item["covariance"] + unrest**2 * self._motion
        surprise = float(np.sqrt(twist @ np.linalg.solve(predicted + error, twist) / 6.0))
        if surprise > _SURPRISED:
            unrest = 1.0
            predicted = item["covariance"] + self._motion
        gain = np.linalg.solve(predicted + error, predicted).T
        covariance = (np.eye(6) - gain) @ predicted
        return {
            "pose": item["pose"] @ exp_se3(gain @ twist),
            "covariance": 0.5 * (covariance + covariance.T),
            "unrest": float(np.clip(unrest * max(_CALMING, surprise), _LEAST_UNREST, 1.0)),
        }

    def _missed(self, item: Tracked, found: Match | None) -> Tracked:
        """One object that the image does not support: its prediction stands, until patience ends."""
        misses = item["misses"] + 1
        lost = item["status"] == LOST or misses >= self._patience
        score = 0.0 if lost or found is None else found.score
        return {
            **item,
            "score": score,
            "status": LOST if lost else EXPECTED,
            "misses": misses,
            "unrest": 1.0,
            "covariance": item["covariance"] + self._motion,
        }

    def _imagined(self, item: Tracked, expected: Mapping[str, Any], seen: Mapping[str, Any], camera: Floats) -> Tracked:
        """One object's prediction and its visible edges."""
        drawn_from = invert(seen["camera"]) @ expected["pose"]
        edges = visible_edges(seen["depth"], seen["labels"], item["id"], seen["intrinsics"])
        return {
            **item,
            "before": item["pose"],
            "pose": invert(camera) @ expected["pose"],
            "covariance": expected["covariance"],
            "edges": transform(invert(drawn_from), edges.segments),
            "kinds": edges.kinds,
        }


def poses_seen(belief: Value) -> Elements:
    """φ of the arm: where its objects are in the world, and its camera.

    Returns:
        Of each object {"id", "obj_id", "pose": world_from_object, "covariance", "score",
        "status"}, then {"camera": world_from_camera, "intrinsics", "size", "frame"}; none
        before the first image.
    """
    camera = belief["camera"]
    if camera is None:
        return ()
    kept = ("id", "obj_id", "covariance", "score", "status")
    objects = tuple({**{key: item[key] for key in kept}, "pose": camera @ item["pose"]} for item in belief["objects"])
    return (*objects, {key: belief[key] for key in ("camera", "intrinsics", "size", "frame")})


def _first_belief(item: Mapping[str, Any], covariance: Floats) -> Tracked:
    pose = np.asarray(item["pose"], dtype=np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"object {item['id']}: pose: expected a 4 × 4 matrix of finite numbers")
    return {
        "id": int(item["id"]),
        "obj_id": int(item["obj_id"]),
        "pose": pose,
        "before": pose,
        "covariance": covariance,
        "score": 1.0,
        "status": EXPECTED,
        "misses": 0,
        "unrest": 1.0,
        **_no_edges(),
    }


def _no_edges() -> Tracked:
    return {"edges": NO_EDGES.segments, "kinds": NO_EDGES.kinds}


def _covariance(length_m: float, angle_rad: float) -> Floats:
    return np.diag([length_m**2] * 3 + [angle_rad**2] * 3)
