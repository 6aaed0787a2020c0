"""The arm node below a builder: it knows cubes by their colours, and does not take one for another for long.

By edges alone a cube that is nearer looks like a larger one that is farther away. A cube that somebody has knocked down
was so believed to hover over another one, in whose image its edges lie, and that one to be gone."""

from collections.abc import Sequence
from typing import Any, cast

import cv2
import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.tracker import KNOWN, PickArm, first_poses
from hierax.nodes.tracking.arm import unseen
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, project, transform
from hierax.nodes.tracking.schema import LOST, TRACKED, ControlPoints, TrackedObject
from hierax.runtime import Elements, Value

BESIDE_M = 0.005  # so far from its edges a face's colour is read
SURE_SEEN, LEAST_POINTS = 0.9, 40  # chance of a control point that surely nothing hides; of so many a colour is told
LEARNED_NATS, LEARNED_EPOCHS = 8.0, 10  # seen as surely as this, in so many images, one tells its colour
# A place has a cube's colour if it is that near, in chromaticity from 0 to 1. What has another cube's colour in more
# than the first share of its places, and its own in less than the second, is that one, not merely partly hidden by it;
# after so many images in a row it is lost.
ALIKE, ANOTHERS, OWN, MISTAKEN_EPOCHS = 0.08, 0.5, 0.1, 4


class TowerArm(PickArm):
    """An arm node that remembers the colours of what it tracks.

    The belief is that of `PickArm`, with ``colours``, of each object {"id", "chromaticity": (3,), red, green and blue
    by their sum, "epochs": from how many images that is known, "mistaken": in how many images in a row it was taken for
    what has another one's colour}. In such an image it is not seen; after `MISTAKEN_EPOCHS` of them, or if it had been
    lost before, it is lost."""

    def initial_belief(self) -> Value:
        """The belief of `PickArm`; no colour is known."""
        known = super().initial_belief()
        nothing = {"chromaticity": np.zeros(3), "epochs": 0, "mistaken": 0}
        return {**known, "colours": tuple({"id": item["id"], **nothing} for item in known["objects"])}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ of `PickArm`, but that what has another object's colour is not seen. The image is RGB."""
        felt = super().observe(observations, belief)
        if not observations:
            return felt
        image, intrinsics = cv2.blur(observations[0]["image"], (3, 3)), observations[0]["intrinsics"]
        before, known = belief["objects"], belief["colours"]
        pairs = zip(felt["objects"], before, strict=True)
        seen = [chromaticities(image, intrinsics, item, _controls(item, was)) for item, was in pairs]
        every = zip(known, felt["objects"], seen, strict=True)
        colours = tuple(_compared(own, item, colour, known) for own, item, colour in every)
        moved = np.eye(4) if belief["camera"] is None else invert(felt["camera"]) @ belief["camera"]
        objects = tuple(
            self._denied(own["mistaken"], was, moved) if own["mistaken"] and item["status"] == TRACKED else item
            for own, item, was in zip(colours, felt["objects"], before, strict=True)
        )
        return {**felt, "objects": objects, "colours": colours}

    def _denied(self, mistaken: int, before: Value, moved: Floats) -> Value:
        """An object that was taken for another one, as if the image had not been: where it was expected, or lost."""
        expected = {**before, "pose": moved @ before["pose"], "before": moved @ before["before"], "others": ()}
        unsupported = self._blind(cast(TrackedObject, expected))
        is_gone = mistaken >= MISTAKEN_EPOCHS or before["status"] == LOST
        return unseen(unsupported) if is_gone else unsupported


def _controls(item: Value, before: Value) -> ControlPoints:
    """What is seen of an object: of one that was just found, what was expected at the nearest place where it might
    be."""
    if len(item["controls"]["points"]) or not before["others"]:
        return cast(ControlPoints, item["controls"])
    place = item["pose"][:3, 3]
    nearest = min(before["others"], key=lambda other: float(np.linalg.norm(other["pose"][:3, 3] - place)))
    return cast(ControlPoints, nearest["controls"])


def chromaticities(image: Array, intrinsics: Array, item: Value, controls: ControlPoints) -> Floats | None:
    """(n, 3) what colours a tracked object's faces have beside their edges, red, green and blue by their sum; None
    where too little of it is seen.

    Args: image: (h, w, 3) uint8, RGB; intrinsics: (4,) fx, fy, cx, cy in pixels; item: one of an arm's objects, and
        its control points."""
    if item["status"] != TRACKED or len(controls["points"]) < LEAST_POINTS:
        return None
    sure = controls["visible"] > SURE_SEEN
    beside = transform(item["pose"], (controls["points"] + BESIDE_M * controls["inwards"])[sure])
    places = np.rint(project(beside, intrinsics)).astype(int)
    inside = ((places >= 0) & (places < (image.shape[1], image.shape[0]))).all(axis=1)
    if np.count_nonzero(inside) < LEAST_POINTS:
        return None
    columns, rows = places[inside].T
    seen = image[rows, columns].astype(np.float64) + 1.0
    return np.asarray(seen / seen.sum(axis=1, keepdims=True))


def _compared(known: Value, item: Value, seen: Floats | None, every: Sequence[Value]) -> Value:
    """What is known of an object's colour after an image, and whether it was taken for another one in that."""
    if seen is None:
        return {**known, "mistaken": 0}
    if known["epochs"] < LEARNED_EPOCHS:
        sure = item["nats"] >= LEARNED_NATS and not item["probation"]
        mean = (known["chromaticity"] * known["epochs"] + np.median(seen, axis=0)) / (known["epochs"] + 1)
        return {**known, "chromaticity": mean, "epochs": known["epochs"] + 1} if sure else known
    others = [other for other in every if other["id"] != known["id"] and other["epochs"] == LEARNED_EPOCHS]
    anothers = max((_share(seen, other["chromaticity"]) for other in others), default=0.0)
    is_other = anothers > ANOTHERS and _share(seen, known["chromaticity"]) < OWN
    return {**known, "mistaken": known["mistaken"] + 1 if is_other else 0}


def _share(seen: Floats, colour: Floats) -> float:
    """In what share of places a colour is seen."""
    return float((np.linalg.norm(seen - colour, axis=1) < ALIKE).mean())


def arm(scene: int = 0, cubes: int = CUBES, **options: Any) -> TowerArm:
    """The arm node as `hierax.nodes.picking.tracker.arm` has it, below a builder."""
    return TowerArm(first_poses(scene, cubes), **KNOWN | options)
