"""Steps of an arm that believes in one square, for probes."""

from __future__ import annotations

from typing import Any

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, make_pose
from hierax.runtime import Step, Value

INTRINSICS = np.array([200.0, 200.0, 79.5, 59.5])
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * 0.05
EDGES = np.stack((SQUARE, np.roll(SQUARE, -1, axis=0)), axis=1)


def placed(x: float) -> Floats:
    return make_pose(np.eye(3), np.array([x, 0.0, 0.4]))


def arm_belief(frame: int | None, x: float = 0.0, status: str = "tracked") -> dict[str, Any]:
    item = {"id": 1, "obj_id": 7, "pose": placed(x), "score": 0.75, "status": status, "edges": EDGES}
    return {"camera": np.eye(4), "intrinsics": INTRINSICS, "size": (160, 120), "frame": frame, "objects": (item,)}


def step(epoch: int, sensed: Value, image: Any = None, belief: Value = None, attempt: int = 0) -> Step:
    observations = () if image is None else ({"image": image},)
    return Step(
        epoch, attempt, 0.1 * epoch, observations, sensed, (), (), "default", (), sensed if belief is None else belief
    )
