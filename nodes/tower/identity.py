"""The arm node below a builder: it knows cubes by their colours, and does not take one for another for long.

By edges alone a cube that is nearer looks like a larger one that is farther away. A cube that somebody has knocked down
was so believed to hover over another one, in whose image its edges lie, and that one to be gone."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.tracker import PickArm, first_poses
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, project, transform
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED
from hierax.runtime import Elements, Value

BESIDE_M = 0.005  # so far from its edges a face's colour is read
SURE_SEEN, LEAST_POINTS = 0.9, 40  # chance of a control point that surely nothing hides; of so many a colour is told
LEARNED_NATS, LEARNED_EPOCHS = 8.0, 10  # seen as surely as this, in so many images, one tells its colour
# By so much of chromaticity, from 0 to 1, another cube's colour has to be nearer than its own, for so many images in a
# row: then it is taken for that one. Cubes of one colour are not told apart.
NEARER, MISTAKEN_EPOCHS = 0.04, 4


class TowerArm(PickArm):
    """An arm node that remembers the colours of what it tracks.

    The belief is that of `PickArm`, with ``colours``, of each object {"id", "chromaticity": (3,), red, green and blue
    by their sum, "epochs": of how many images, "mistaken": in how many just now it had another one's}. What has one is
    not seen where that is; what had one for `MISTAKEN_EPOCHS` is lost."""

    def initial_belief(self) -> Value:
        """The belief of `PickArm`; no colour is known."""
        known = super().initial_belief()
        nothing = {"chromaticity": np.zeros(3), "epochs": 0, "mistaken": 0}
        return {**known, "colours": tuple({"id": item["id"], **nothing} for item in known["objects"])}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ of `PickArm`, but that what has another object's colour is not seen."""
        felt = super().observe(observations, belief)
        if not observations:
            return felt
        image, intrinsics = observations[0]["image"], observations[0]["intrinsics"]
        seen = [chromaticity(image, intrinsics, item) for item in felt["objects"]]
        every = zip(belief["colours"], felt["objects"], seen, strict=True)
        colours = tuple(_compared(known, item, colour, belief["colours"]) for known, item, colour in every)
        pairs = zip(colours, belief["objects"], felt["objects"], strict=True)
        objects = tuple(
            _denied(known["mistaken"], item, belief["camera"] @ before["pose"], felt["camera"])
            if known["mistaken"]
            else item
            for known, before, item in pairs
        )
        return {**felt, "objects": objects, "colours": colours}


def chromaticity(image: Array, intrinsics: Array, item: Mapping[str, Any]) -> Floats | None:
    """(3,) what colour a tracked object's faces have beside their edges, red, green and blue by their sum; None where
    too little of it is seen.

    Args: image: (h, w, 3) uint8; intrinsics: (4,) fx, fy, cx, cy in pixels; item: one of an arm's objects."""
    controls = item["controls"]
    if item["status"] != TRACKED or len(controls["points"]) < LEAST_POINTS:
        return None
    sure = controls["visible"] > SURE_SEEN
    beside = transform(item["pose"], (controls["points"] + BESIDE_M * controls["inwards"])[sure])
    places = np.rint(project(beside, intrinsics)).astype(int)
    inside = ((places >= 0) & (places < (image.shape[1], image.shape[0]))).all(axis=1)
    if np.count_nonzero(inside) < LEAST_POINTS:
        return None
    columns, rows = places[inside].T
    colour = np.median(cv2.blur(image, (3, 3))[rows, columns].astype(np.float64), axis=0) + 1.0
    return np.asarray(colour / colour.sum())


def _compared(
    known: Mapping[str, Any], item: Mapping[str, Any], colour: Floats | None, every: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """What is known of an object's colour after an image, and whether that has it look like another one."""
    if colour is None:
        return {**known, "mistaken": 0}
    if known["epochs"] < LEARNED_EPOCHS:
        sure = item["nats"] >= LEARNED_NATS
        mean = (known["chromaticity"] * known["epochs"] + colour) / (known["epochs"] + 1)
        return {**known, "chromaticity": mean, "epochs": known["epochs"] + 1} if sure else dict(known)
    others = [other for other in every if other["id"] != known["id"] and other["epochs"] == LEARNED_EPOCHS]
    away = min((_apart(colour, other["chromaticity"]) for other in others), default=np.inf)
    is_other = away < _apart(colour, known["chromaticity"]) - NEARER
    return {**known, "mistaken": known["mistaken"] + 1 if is_other else 0}


def _denied(mistaken: int, item: Mapping[str, Any], expected: Floats, camera: Floats) -> dict[str, Any]:
    """An object that has another one's colour: where it was expected, in the world's frame, or lost."""
    status = LOST if mistaken >= MISTAKEN_EPOCHS else EXPECTED
    nothing = {"score": 0.0, "nats": 0.0, "probability": 0.0}
    return {**item, **nothing, "status": status, "pose": invert(camera) @ expected}


def _apart(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other))


def arm(scene: int = 0, cubes: int = CUBES, **options: Any) -> TowerArm:
    """The arm node as `hierax.nodes.picking.tracker.arm` has it, below a builder."""
    return TowerArm(first_poses(scene, cubes), **options)
