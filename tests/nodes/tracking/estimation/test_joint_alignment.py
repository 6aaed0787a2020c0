"""Objects that rest before a camera that moves: no side that turns away takes them along."""

from __future__ import annotations

import numpy as np
from support.boxes import INTRINSICS, Box, photograph
from support.drawn import BOXES, all_expected

from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.estimation.drift import joint_of
from hierax.nodes.tracking.estimation.fusion import Known
from hierax.nodes.tracking.estimation.joint_alignment import Explained, explained, explained_again, prior_of, task_of
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.math.batched import exp_many
from hierax.nodes.tracking.math.geometry import exp_se3, exp_so3, invert, make_pose, pose_error
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.spatial import SpatialNode
from hierax.runtime import Tick

MOTION = np.diag([0.01**2] * 3 + [0.06**2] * 3)
REPORTS = np.diag([0.0015**2] * 3 + [0.0025**2] * 3)
SIDE_M = 0.1
IMAGES = 16
BESIDE_RAD = 0.5


def test_an_open_box_stays_while_a_side_turns_away_and_the_pictures_edge_cuts_it() -> None:
    # As the camera goes to the left, the side on the right is seen ever more steeply, and then no more.
    mesh = box_mesh((SIDE_M,) * 3)
    back = (mesh.vertices[mesh.faces][:, :, 2] > 0).all(axis=1)
    model = {"vertices": mesh.vertices, "faces": mesh.faces[~back]}
    box = make_pose(exp_so3(np.array([-0.3, 0.0, 0.0])), [0.0, 0.0, 0.5])
    cameras = [
        make_pose(exp_so3(np.array([0.0, np.arctan2(-right, 0.5) + BESIDE_RAD, 0.0])), [right, 0.0, 0.0])
        for right in np.linspace(0.12, 0.0, IMAGES)
    ]
    first = {"id": 1, "obj_id": 1, "pose": invert(cameras[0]) @ box}
    arm, spatial = ArmNode([first]), SpatialNode([{**first, "pose": box, "model": model}])
    imagined = SegmentedDepth()
    low, high = arm.initial_belief(), spatial.initial_belief()
    worst = np.zeros(2)
    for number, camera in enumerate(cameras):
        true = invert(camera) @ box
        image = photograph([Box(1, (SIDE_M,) * 3, true)], 1.0, np.random.default_rng(number))
        seen = {"image": image, "camera": camera, "intrinsics": INTRINSICS, "frame": number}
        low = arm.observe((seen,), low)
        worst = np.maximum(worst, pose_error(low["objects"][0]["pose"], true))
        high = spatial.observe(poses_seen(low), high, Tick(epoch=number + 1, time_s=number / 30.0))
        high = spatial.predict((), (), high)
        low = arm.predict(imagined(high), (), low)
    assert low["objects"][0]["status"] == "tracked"
    assert worst[0] < 0.0012
    assert np.degrees(worst[1]) < 0.4


def one_off(shift: np.ndarray) -> tuple[Explained, Explained | None]:
    """Two boxes that are known well, seen by a camera that is elsewhere than reported; and what a second look changes,
    were the second box in doubt."""
    items = [{**item, "motion_scale": 0.02} for item in all_expected(BOXES, [shift @ box.pose for box in BOXES])]
    for item in items:
        item["covariance"] = np.diag([0.0004**2] * 3 + [0.004**2] * 3)
    prior = prior_of(items, MOTION, Known(joint_of(items, None, REPORTS)))
    image = smoothed(photograph(BOXES, 2.0, np.random.default_rng(4)))
    task = task_of(image, items, prior, INTRINSICS)
    assert task.search.reach_px == (8,)
    first = explained(task)
    assert first is not None
    return first, explained_again(task, first, [1])


def test_where_the_camera_is_as_reported_nothing_is_looked_at_again() -> None:
    first, again = one_off(np.eye(4))
    assert again is None
    assert first.aligned.scores.min() > 0.8


def test_a_camera_that_jumped_is_looked_through_again_from_where_it_is() -> None:
    shift = exp_se3(np.array([0.004, -0.003, 0.0, 0.003, 0.004, 0.002]))
    first, again = one_off(shift)
    assert again is not None
    assert again.aligned.gains.sum() > first.aligned.gains.sum()
    for explanation in (first, again):
        assert explanation.aligned.shift.shape == (4, 4)
    moved = exp_many(again.fused.shift[None])[0]
    for box in BOXES:
        off = pose_error(moved @ shift @ box.pose, box.pose)
        assert off[0] < 0.25 * pose_error(shift @ box.pose, box.pose)[0]
