"""Drawn images of boxes with the control points that are expected of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.schema import ControlPoints
from support.boxes import INTRINSICS, SIZE, Box

START = np.diag([0.005**2] * 3 + [0.035**2] * 3)
FIRST = Box(1, (0.08, 0.07, 0.09), make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [-0.07, -0.01, 0.5]))
SECOND = Box(2, (0.06, 0.09, 0.07), make_pose(exp_so3(np.array([0.7, -0.4, 0.3])), [0.08, 0.02, 0.55]))
BOXES = (FIRST, SECOND)


def expected(box: Box, predicted: np.ndarray[Any, Any]) -> dict[str, Any]:
    """An object as the arm's belief has it before an image."""
    return believed(box.label, predicted, seen_of(box.size, predicted))


def seen_of(
    sides_m: Sequence[float],
    pose: Floats,
    intrinsics: np.ndarray[Any, Any] = INTRINSICS,
    size: tuple[int, int] = SIZE,
) -> ControlPoints:
    """What would be seen of a box at a pose, camera_from_object."""
    mesh = box_mesh(sides_m)
    controls = controls_of(shape_of(mesh.vertices, mesh.faces), pose, intrinsics, size)
    return controls.sent(controls.visible.astype(np.float32))


def believed(number: int, pose: Floats, controls: ControlPoints) -> dict[str, Any]:
    """The same of any object, with what would be seen of it at a pose."""
    return {
        "id": number,
        "pose": pose,
        "before": pose,
        "covariance": START,
        "motion_scale": 0.2,
        "trend": np.zeros(6),
        "probation": 0,
        "lead": 0.0,
        "others": (),
        "support": np.zeros(3),
        "stands": False,
        "hangs": 0,
        "score": 1.0,
        "status": "tracked",
        "failed_searches": 0,
        "slots": NOTHING,
        "controls": controls,
    }


def all_expected(boxes: Sequence[Box], predicted: Sequence[np.ndarray[Any, Any]]) -> list[dict[str, Any]]:
    """Several objects."""
    return [expected(box, pose) for box, pose in zip(boxes, predicted, strict=True)]
