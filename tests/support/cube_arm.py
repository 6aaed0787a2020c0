"""An arm that sees one cube."""

from __future__ import annotations

from typing import Any

import numpy as np

from hierax.nodes.tracking.arm import ArmNode
from hierax.nodes.tracking.math.geometry import exp_so3, invert, make_pose
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.render import SegmentedDepth
from support.boxes import INTRINSICS, SIZE, Box, photograph

CUBE = (0.08, 0.07, 0.09)
MESH = box_mesh(CUBE)
WORLD_FROM_OBJECT = make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.02, -0.01, 0.5])
FIRST_CAMERA = np.eye(4)
NEXT_CAMERA = make_pose(exp_so3(np.array([0.02, -0.03, 0.01])), [0.03, 0.01, 0.0])


def picture(camera: np.ndarray, pose: np.ndarray | None, seed: int, frame: int = 0) -> dict[str, Any]:
    boxes = [] if pose is None else [Box(3, CUBE, invert(camera) @ pose)]
    image = photograph(boxes, 2.0, np.random.default_rng(seed))
    return {"image": image, "camera": camera, "intrinsics": INTRINSICS, "frame": frame}


def imagined(camera: np.ndarray, pose: np.ndarray, covariance: np.ndarray) -> tuple[Any, ...]:
    body = {"id": 3, "obj_id": 1, "pose": pose, "covariance": covariance, "status": "tracked"}
    body.update(support=np.zeros(3), stands=False, hangs=0, others=np.zeros((0, 4, 4)), kept=0)
    body["model"] = {"vertices": MESH.vertices, "faces": MESH.faces}
    return SegmentedDepth()(
        {"camera": camera, "intrinsics": INTRINSICS, "size": SIZE, "bodies": (body,), "sweeping": None}
    )


def node(**options: Any) -> ArmNode:
    first = invert(FIRST_CAMERA) @ WORLD_FROM_OBJECT
    return ArmNode([{"id": 3, "obj_id": 1, "pose": first}], **options)


def after_first_epoch(arm: ArmNode, predicted: np.ndarray = WORLD_FROM_OBJECT) -> Any:
    belief = arm.observe((picture(FIRST_CAMERA, WORLD_FROM_OBJECT, 1),), arm.initial_belief())
    return arm.predict(imagined(FIRST_CAMERA, predicted, belief["objects"][0]["covariance"]), (), belief)
