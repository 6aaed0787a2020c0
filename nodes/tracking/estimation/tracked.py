"""What the arm believes of one object, see `hierax.nodes.tracking.arm.ArmNode`: at first, and for the next image."""

from collections.abc import Mapping, Sequence

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking import schema
from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.estimation.bending import bent
from hierax.nodes.tracking.math.batched import invert_many, log_many
from hierax.nodes.tracking.math.geometry import NO_POSES, Floats, invert

NO_CONTROLS: schema.ControlPoints = {
    "points": np.zeros((0, 3)),
    "tangents": np.zeros((0, 3)),
    "inwards": np.zeros((0, 3)),
    "kinds": np.zeros(0, dtype=np.uint8),
    "edges": np.zeros(0, dtype=np.int32),
    "faces": np.zeros((0, 2), dtype=np.int32),
    "visible": np.zeros(0, dtype=np.float32),
}


def first_belief(item: schema.FirstPose, covariance: Floats) -> schema.TrackedObject:
    """An object before the first image, with the (6, 6) covariance of its pose's error. Raises ValueError: the pose is
    no 4 × 4 matrix of finite numbers."""
    pose = first_pose(item)
    return {
        "id": int(item["id"]),
        "obj_id": int(item["obj_id"]),
        "pose": pose,
        "before": pose,
        "covariance": covariance,
        "score": float(item["pose"] is not None),
        "nats": 0.0,
        "probability": 0.0,
        "probation": 0,
        "lead": 0.0,
        "status": schema.EXPECTED if item["pose"] is not None else schema.LOST,
        "misses": 0,
        "denied": 0,
        "motion_scale": const.FIRST_MOTION_SCALE,
        "trend": np.zeros(6),
        "failed_searches": 0,
        "support": np.zeros(3),
        "stands": False,
        "hangs": 0,
        "others": (),
        "guesses": NO_POSES,
        "sought": False,
        "controls": NO_CONTROLS,
        "edges": np.zeros((0, 2, 3)),
        "slots": NOTHING,
    }


def first_pose(item: schema.FirstPose) -> Floats:
    """(4, 4) camera_from_object in the first frame; the camera's own where it is not known. Raises ValueError: it is no
    4 × 4 matrix of finite numbers."""
    if item["pose"] is None:
        return np.eye(4)
    pose = np.asarray(item["pose"], dtype=np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"object {item['id']}: pose: expected a 4 × 4 matrix of finite numbers")
    return pose


def tracked_metrics(objects: Sequence[schema.TrackedObject] | Sequence[schema.PaperObject]) -> Mapping[str, float]:
    """How many objects are tracked and lost, and the mean score."""
    scores = [item["score"] for item in objects]
    return {
        "tracked": float(sum(item["status"] == schema.TRACKED for item in objects)),
        "lost": float(sum(item["status"] == schema.LOST for item in objects)),
        "score_mean": float(np.mean(scores)) if scores else 0.0,
    }


def motion_of(item: schema.TrackedObject) -> Floats:
    """(6,) twist in its frame by which an object is predicted to move from one image to the next."""
    return np.asarray(log_many(invert_many(item["before"][None]) @ item["pose"][None])[0])


def check_ids(objects: Sequence[schema.TrackedObject] | Sequence[schema.PaperObject]) -> None:
    """See that objects can be told apart in a label image. Raises ValueError: ids are doubled or out of range."""
    ids = [item["id"] for item in objects]
    if len(set(ids)) != len(ids) or not all(1 <= number <= 255 for number in ids):
        raise ValueError(f"ids must be different and from 1 to 255, got {ids}")


def diagonal_covariance(length_m: float, angle_rad: float) -> Floats:
    """(6, 6) of a pose whose standard deviations are these along and about each axis."""
    return np.diag([length_m**2] * 3 + [angle_rad**2] * 3)


def imagined(item: schema.TrackedObject, expected: schema.ExpectedObject, camera: Floats) -> schema.TrackedObject:
    """One object's prediction and its visible edges, by its entry in the context and world_from_camera. One that was
    lost is expected again, and one that is tracked is lost, where who knows more than the image says so."""
    controls = bent(expected["controls"], item["slots"])
    denied = expected["status"] == schema.LOST
    again = item["status"] == schema.LOST and expected["status"] == schema.EXPECTED
    return {
        **item,
        "status": schema.EXPECTED if again else schema.LOST if denied else item["status"],
        "misses": 0 if again else item["misses"],
        "denied": 0 if again else item["denied"],
        **schema.looking_alike(expected),
        "before": item["pose"],
        "pose": invert(camera) @ expected["pose"],
        "covariance": expected["covariance"],
        "support": expected["support"],
        "stands": expected["stands"],
        "hangs": expected["hangs"],
        "others": tuple(
            {**other, "pose": invert(camera) @ other["pose"], "controls": bent(other["controls"], item["slots"])}
            for other in expected["others"]
        ),
        "controls": controls,
        "edges": dashes(controls),
    }


def dashes(controls: schema.ControlPoints) -> Floats:
    """(n, 2, 3) a dash along the edge at each control point, m, object's frame."""
    half = const.DASH_M / 2.0 * controls["tangents"]
    return np.stack((controls["points"] - half, controls["points"] + half), axis=1)
