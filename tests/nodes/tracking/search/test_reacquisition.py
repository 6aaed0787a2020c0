"""Objects that were out of sight: the poses that are imagined of them compete for the image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, photograph
from support.drawn import BOXES, FIRST, SECOND, expected

from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.math.geometry import Floats, exp_se3, exp_so3, make_pose, pose_error
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.search.association import Estimate, Options, associate

OPTIONS = Options(np.diag([0.01**2] * 3 + [0.06**2] * 3), 0.75)
WIDE = np.diag([0.04**2] * 3 + [0.8**2] * 3)
AWAY = exp_se3(np.array([0.05, 0.03, 0.02, 0.3, -0.5, 0.4]))
NEAR = exp_se3(np.array([0.004, -0.003, 0.002, 0.05, -0.04, 0.06]))
CUBE = Box(1, (0.07, 0.07, 0.07), FIRST.pose)
QUARTER = make_pose(exp_so3(np.array([0.0, 0.0, np.pi / 2])), [0.0, 0.0, 0.0])


def imagined(box: Box, pose: Floats, kept: bool = False) -> dict[str, Any]:
    mesh = box_mesh(box.size)
    controls = controls_of(shape_of(mesh.vertices, mesh.faces), pose, INTRINSICS, SIZE)
    return {"pose": pose, "controls": controls._asdict(), "kept": kept}


def looked_for(box: Box, others: list[dict[str, Any]], seen: list[Box], seed: int) -> Estimate:
    """What is found of a box that is lost, in an image of some boxes."""
    item = {**expected(box, box.pose @ AWAY), "covariance": WIDE, "status": "lost", "score": 0.0}
    beside = [expected(other, other.pose) for other in seen if other.label != box.label]
    image = smoothed(photograph(seen, 2.0, np.random.default_rng(seed)))
    found = associate(image, [{**item, "others": tuple(others)}, *beside], None, INTRINSICS, OPTIONS)
    assert found is not None
    return found.estimates[0]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kept", [False, True])
def test_the_pose_that_explains_the_image_is_found_among_others(seed: int, kept: bool) -> None:
    twists = np.array([[0.03, 0.0, 0.0, 0.0, 0.7, 0.0], [-0.03, 0.0, 0.0, 0.0, -0.7, 0.0]])
    wrong = [imagined(FIRST, FIRST.pose @ exp_se3(twist)) for twist in twists]
    estimate = looked_for(FIRST, [*wrong, imagined(FIRST, FIRST.pose @ NEAR, kept)], list(BOXES), seed)
    distance, angle = pose_error(estimate.pose, FIRST.pose)
    assert estimate.sure, f"seed {seed}"
    assert distance < 0.002, f"seed {seed}"
    assert angle < np.radians(0.7), f"seed {seed}"


def test_of_two_poses_that_look_alike_none_is_believed_and_both_are_kept() -> None:
    others = [imagined(CUBE, CUBE.pose @ NEAR), imagined(CUBE, CUBE.pose @ QUARTER @ NEAR)]
    estimate = looked_for(CUBE, others, [CUBE], 1)
    assert not estimate.sure
    assert pose_error(estimate.pose, CUBE.pose)[0] > 0.02
    turns = sorted(pose_error(guess, CUBE.pose)[1] for guess in estimate.guesses)
    assert turns[0] < np.radians(2.0)
    assert any(abs(turn - np.pi / 2) < np.radians(2.0) for turn in turns)


def test_edges_that_are_another_objects_speak_for_nothing() -> None:
    twin = Box(1, SECOND.size, SECOND.pose)
    there = [imagined(twin, SECOND.pose @ NEAR)]
    alone = looked_for(twin, there, [twin], 2)
    assert pose_error(alone.pose, SECOND.pose)[0] < 0.002
    estimate = looked_for(twin, there, [SECOND], 2)
    assert pose_error(estimate.pose, SECOND.pose)[0] > 0.005
    assert len(estimate.guesses) == 0


@pytest.mark.parametrize(("hangs", "nearer", "turn"), [(0, 0.93, 0.1), (4, 0.93, 0.1), (4, 0.9, 0.2)])
def test_what_is_tracked_where_the_image_does_not_have_it_is_found_among_others(
    hangs: int, nearer: float, turn: float
) -> None:
    off = make_pose(SECOND.pose[:3, :3], nearer * SECOND.pose[:3, 3]) @ exp_se3(
        np.array([0.0, 0.0, 0.0, turn, 0.0, 0.0])
    )
    sure = np.diag([0.001**2] * 3 + [0.01**2] * 3)
    item = {
        **expected(SECOND, off),
        "covariance": sure,
        "hangs": hangs,
        "others": (imagined(SECOND, SECOND.pose @ NEAR),),
    }
    image = smoothed(photograph([SECOND], 2.0, np.random.default_rng(4)))
    found = associate(image, [item], None, INTRINSICS, OPTIONS)
    assert found is not None
    assert found.estimates[0].elsewhere
    assert pose_error(found.estimates[0].pose, SECOND.pose)[0] < 0.002
