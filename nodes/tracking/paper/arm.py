"""The arm node with the paper's update: each object's pose by line segments and solvePnP, nothing else remembered."""

from collections.abc import Mapping, Sequence

import numpy as np

from hierax.nodes.tracking import schema
from hierax.nodes.tracking.errors import check_between, check_positive
from hierax.nodes.tracking.estimation.tracked import check_ids, diagonal_covariance, first_pose, tracked_metrics
from hierax.nodes.tracking.math.geometry import NO_POSES, Array, Floats, invert, transform
from hierax.nodes.tracking.paper.lines import expected_lines, image_lines, match_lines
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED, PaperArmBelief, PaperObject
from hierax.runtime import Node

_NO_EDGES = np.zeros((0, 2, 3))
_LEAST_INFORMATION = 1e-2  # of the first pose's, counted as seen, so that what no line shows stays finite


class PaperArmNode(Node):
    """Tracks objects with the camera of an arm as the paper has it; takes the place of `ArmNode` in a deployment.

    The belief is a `PaperArmBelief`, see `hierax.nodes.tracking.schema`.

    Args:
        objects: ``id``, ``obj_id`` and ``pose`` (camera_from_object in the first frame) of each.
        start_m, start_rad: standard deviation of the first poses, in each axis.
        error_px: by how much an end point of a line errs across it.
        kept_score: an image in which less of the edges is found does not support a pose.
        patience: images in a row without support until an object is lost.
        camera: as for `ArmNode`.

    Raises ValueError: ids are doubled or out of range, a pose is no 4 × 4 matrix, or an option is out of range."""

    def __init__(
        self,
        objects: Sequence[schema.FirstPose],
        start_m: float = 0.005,
        start_rad: float = 0.035,
        error_px: float = 1.5,
        kept_score: float = 0.35,
        patience: int = 10,
        camera: Floats | None = None,
    ) -> None:
        check_positive(start_m=start_m, start_rad=start_rad, error_px=error_px)
        check_between(0, 1, "a number", kept_score=kept_score)
        if patience < 1:
            raise ValueError(f"patience is {patience}; expected at least 1 image")
        self._start = diagonal_covariance(start_m, start_rad)
        self._error_px = error_px
        self._kept_score = kept_score
        self._patience = patience
        self._first_camera = camera
        self._objects = tuple(self._first(item) for item in objects)
        check_ids(self._objects)

    def initial_belief(self) -> PaperArmBelief:
        """The objects where they are said to be; no camera, no edges yet."""
        return {"camera": self._first_camera, "intrinsics": None, "size": None, "frame": None, "objects": self._objects}

    def observe(self, observations: tuple[schema.Picture, ...], belief: PaperArmBelief) -> PaperArmBelief:
        """τ: each object's expected edges matched to the image's line segments, its pose by solvePnP."""
        if not observations:
            unseen: tuple[PaperObject, ...] = tuple(
                {**item, "status": EXPECTED if item["status"] == TRACKED else item["status"]}
                for item in belief["objects"]
            )
            return {**belief, "frame": None, "objects": unseen}
        seen = observations[0]
        camera = np.asarray(seen["camera"], dtype=np.float64)
        intrinsics = np.asarray(seen["intrinsics"], dtype=np.float64)
        moved = np.eye(4) if belief["camera"] is None else invert(camera) @ belief["camera"]
        wanted = any(len(item["edges"]) for item in belief["objects"])
        lines = image_lines(seen["image"]) if wanted else None
        objects: list[PaperObject] = [{**item, "pose": moved @ item["pose"]} for item in belief["objects"]]
        height, width = seen["image"].shape[:2]
        return {
            "camera": camera,
            "intrinsics": intrinsics,
            "size": (width, height),
            "frame": seen["frame"],
            "objects": tuple(item if lines is None else self._corrected(item, lines, intrinsics) for item in objects),
        }

    def predict(
        self, context: tuple[schema.Imagery, ...], actions: schema.Nothing, belief: PaperArmBelief
    ) -> PaperArmBelief:
        """γ: where the objects will be, and which of their edges will be seen, both from the context that
        `hierax.nodes.tracking.render.SegmentedDepth` gives; without any the arm knows no shapes, and every object is
        lost."""
        camera = belief["camera"]
        if belief["intrinsics"] is None:  # nothing was ever seen
            return belief
        expected = {item["id"]: item for item in context[0]["poses"]} if context else {}
        objects: tuple[PaperObject, ...] = tuple(
            {**item, "edges": _NO_EDGES, "score": 0.0, "status": LOST}
            if camera is None or item["id"] not in expected
            else _imagined(item, expected[item["id"]], context[0], camera)
            for item in belief["objects"]
        )
        return {**belief, "objects": objects}

    def metrics(self, belief: PaperArmBelief) -> Mapping[str, float]:
        """How many objects are tracked, and the mean score."""
        return tracked_metrics(belief["objects"])

    def _first(self, item: schema.FirstPose) -> PaperObject:
        return {
            "id": int(item["id"]),
            "obj_id": int(item["obj_id"]),
            "pose": first_pose(item),
            "covariance": self._start,
            "score": 1.0,
            "status": EXPECTED,
            "misses": 0,
            "motion_scale": 1.0,
            "sought": False,
            "guesses": NO_POSES,
            "edges": _NO_EDGES,
        }

    def _corrected(self, item: PaperObject, lines: Floats, intrinsics: Array) -> PaperObject:
        """One object after the image; where that does not support it, its prediction stands, until patience ends."""
        found = match_lines(lines, item["edges"], item["pose"], intrinsics)
        if found is None or found.score < self._kept_score:
            misses = item["misses"] + 1
            lost = item["status"] == LOST or misses >= self._patience
            score = 0.0 if lost or found is None else found.score
            wider = item["covariance"] + self._start
            return {**item, "score": score, "status": LOST if lost else EXPECTED, "misses": misses, "covariance": wider}
        information = found.information / self._error_px**2 + _LEAST_INFORMATION * np.linalg.inv(self._start)
        return {
            **item,
            "pose": found.pose,
            "covariance": np.linalg.inv(information),
            "score": found.score,
            "status": TRACKED,
            "misses": 0,
        }


def _imagined(item: PaperObject, expected: schema.ExpectedObject, seen: schema.Imagery, camera: Floats) -> PaperObject:
    """One object's prediction and its visible edges."""
    drawn_from = invert(seen["camera"]) @ expected["pose"]
    lines = expected_lines(seen["depth"], seen["labels"], item["id"], seen["intrinsics"])
    return {
        **item,
        "pose": invert(camera) @ expected["pose"],
        "covariance": expected["covariance"],
        "edges": transform(invert(drawn_from), lines),
    }
