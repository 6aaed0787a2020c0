"""The arm with the paper's update: what it corrects, loses and finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, photograph

from hierax.nodes.tracking.arm import poses_seen
from hierax.nodes.tracking.math.geometry import exp_so3, invert, make_pose, pose_error
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.paper.arm import PaperArmNode
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.world import arm
from hierax.schemas.values import decode_value, encode_value

CUBE = (0.08, 0.08, 0.08)
MESH = box_mesh(CUBE)
WORLD_FROM_OBJECT = make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.02, -0.01, 0.5])
NEXT_CAMERA = make_pose(exp_so3(np.array([0.02, -0.03, 0.01])), [0.03, 0.01, 0.0])


def picture(camera: np.ndarray, there: bool, seed: int) -> dict[str, Any]:
    boxes = [Box(3, CUBE, invert(camera) @ WORLD_FROM_OBJECT)] if there else []
    image = photograph(boxes, 2.0, np.random.default_rng(seed))
    return {"image": image, "camera": camera, "intrinsics": INTRINSICS, "frame": seed}


def imagined(camera: np.ndarray, pose: np.ndarray) -> tuple[Any, ...]:
    body = {"id": 3, "obj_id": 1, "pose": pose, "covariance": np.eye(6) * 1e-4, "status": "tracked"}
    body.update(support=np.zeros(3), stands=False, hangs=0, others=np.zeros((0, 4, 4)), kept=0)
    body["model"] = {"vertices": MESH.vertices, "faces": MESH.faces}
    return SegmentedDepth()(
        {"camera": camera, "intrinsics": INTRINSICS, "size": SIZE, "bodies": (body,), "sweeping": None}
    )


def node(**options: Any) -> PaperArmNode:
    return PaperArmNode([{"id": 3, "obj_id": 1, "pose": WORLD_FROM_OBJECT}], **options)


def after_first_epoch(paper: PaperArmNode, predicted: np.ndarray = WORLD_FROM_OBJECT) -> Any:
    belief = paper.observe((picture(np.eye(4), True, 1),), paper.initial_belief())
    return paper.predict(imagined(np.eye(4), predicted), (), belief)


def test_a_prediction_is_corrected_while_the_camera_moves() -> None:
    paper = node()
    assert poses_seen(paper.initial_belief()) == ()
    wrong = WORLD_FROM_OBJECT @ make_pose(exp_so3(np.array([0.02, -0.02, 0.03])), [0.004, -0.003, 0.004])
    belief = after_first_epoch(paper, wrong)
    assert len(belief["objects"][0]["edges"]) >= 6
    belief = paper.observe((picture(NEXT_CAMERA, True, 2),), belief)
    seen, camera = poses_seen(belief)
    assert (seen["status"], camera["frame"], camera["size"]) == ("tracked", 2, SIZE)
    distance, angle = pose_error(seen["pose"], WORLD_FROM_OBJECT)
    assert distance < 0.006
    assert angle < np.radians(2.5)
    assert np.linalg.eigvalsh(seen["covariance"]).min() > 0


def test_without_context_everything_is_lost() -> None:
    paper = node()
    belief = paper.predict((), (), paper.observe((picture(np.eye(4), True, 1),), paper.initial_belief()))
    belief = paper.observe((picture(np.eye(4), True, 2),), belief)
    assert paper.metrics(belief) == {"tracked": 0.0, "lost": 1.0, "score_mean": 0.0}


def test_what_vanishes_is_lost_and_what_returns_is_found() -> None:
    paper = node(patience=3)
    belief = after_first_epoch(paper)
    statuses = []
    for epoch, there in enumerate([True, False, False, False, False, True]):
        belief = paper.observe((picture(np.eye(4), there, epoch),), belief)
        statuses.append(belief["objects"][0]["status"])
        belief = paper.predict(imagined(np.eye(4), WORLD_FROM_OBJECT), (), belief)
    assert statuses == ["tracked", "expected", "expected", "lost", "lost", "tracked"]


def test_operators_are_pure_and_beliefs_are_values() -> None:
    paper = node()
    belief = after_first_epoch(paper)
    kept = encode_value(belief)
    seen = picture(NEXT_CAMERA, True, 2)
    assert encode_value(paper.observe((seen,), belief)) == encode_value(node().observe((seen,), decode_value(kept)))
    assert encode_value(belief) == kept
    blind = paper.observe((), belief)
    assert (blind["frame"], {item["status"] for item in blind["objects"]} <= {"expected", "lost"}) == (None, True)


def test_a_deployment_chooses_the_method() -> None:
    assert isinstance(arm(cubes=2, method="paper", patience=4), PaperArmNode)
    with pytest.raises(ValueError, match="method is 'magic'; expected one of robust, paper"):
        arm(cubes=2, method="magic")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"error_px": 0.0}, "error_px is 0.0; expected a positive"),
        ({"kept_score": 1.5}, "kept_score is 1.5; expected a number from 0 to 1"),
        ({"patience": 0}, "patience is 0"),
    ],
)
def test_bad_options(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        node(**options)


def test_bad_objects() -> None:
    with pytest.raises(ValueError, match="from 1 to 255"):
        PaperArmNode([{"id": 1, "obj_id": 1, "pose": np.eye(4)}, {"id": 1, "obj_id": 1, "pose": np.eye(4)}])
    with pytest.raises(ValueError, match="object 4: pose"):
        PaperArmNode([{"id": 4, "obj_id": 1, "pose": np.eye(3)}])
