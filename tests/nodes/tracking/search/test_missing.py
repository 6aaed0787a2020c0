"""What a report of the camera that is off does to guesses, as long as nothing is tracked that would tell it."""

from __future__ import annotations

import numpy as np
import pytest
from support.drawn import seen_of

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.estimation.likelihood import explains
from hierax.nodes.tracking.estimation.profiles import Image, smoothed
from hierax.nodes.tracking.math.batched import pixels_of
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, looking_down, make_pose, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.schema import ControlPoints
from hierax.nodes.tracking.search.missing import _jump, _Search
from hierax.nodes.tracking.search.multistart import FINE
from hierax.nodes.tracking.simworld.scene import develop, draw
from hierax.nodes.tracking.simworld.shapes import Thing, cube

SIZE, SIDES_M = (320, 240), (0.05, 0.04, 0.045)
INTRINSICS = np.array([400.0, 400.0, 159.5, 119.5])
CAMERA = looking_down(0.4, 0.75, 0.5, np.zeros(3))
LEVEL = CAMERA[2]
POSES = [
    make_pose(exp_so3(np.array([0.0, 0.0, turn])), np.array([x, y, side / 2]))
    for turn, x, y, side in zip((0.3, 1.1, 0.8), (0.0, 0.09, -0.06), (-0.08, 0.02, 0.06), SIDES_M, strict=True)
]


def image() -> Image:
    """Three cubes on the table."""
    colours = ((200, 60, 50), (60, 160, 80), (70, 80, 190))
    things = [Thing(pose, cube(side), colour) for pose, side, colour in zip(POSES, SIDES_M, colours, strict=True)]
    light = draw(things, CAMERA, INTRINSICS, SIZE)
    return smoothed(develop(light, 0.7, 2.0, np.random.default_rng(0)))


def controls(number: int, pose: Floats) -> ControlPoints:
    return seen_of([SIDES_M[number]] * 3, pose, INTRINSICS, SIZE)


def turned(across_px: float, down_px: float) -> Floats:
    """A turn of the camera that moves all things in its image so far."""
    return make_pose(exp_so3(np.array([-down_px, across_px, 0.0]) / INTRINSICS[0]), np.zeros(3))


@pytest.mark.parametrize("off_px", [(4.0, -3.0), (-2.0, 5.0)])
def test_guesses_that_all_came_beside_where_they_are_tell_where_the_camera_looks(off_px: tuple[float, float]) -> None:
    true = [invert(CAMERA) @ pose for pose in POSES]
    came = np.stack([turned(*off_px) @ pose for pose in true])
    # Of the last object there is another guess, where nothing is: it says nothing of the camera.
    poses = np.concatenate((came, came[2:] @ make_pose(np.eye(3), np.array([0.03, 0.04, 0.0]))))
    owners, search = np.array([0, 1, 2, 2]), _Search(image(), INTRINSICS, LEVEL, None)
    every = [controls(number, pose) for number, pose in zip(owners, poses, strict=True)]
    found = search.aligned(every, [NOTHING] * len(every), poses, FINE, const.POINTS_MAX)
    assert found is not None
    jump = _jump(poses, found[0], explains(found[0]), owners, INTRINSICS)
    assert jump is not None
    for number, pose in enumerate(true):
        corners = box_mesh([SIDES_M[number]] * 3).vertices
        seen, back = (pixels_of(transform(each, corners), INTRINSICS) for each in (pose, jump @ came[number]))
        assert np.linalg.norm(seen - back, axis=1).max() < 1.0
    # From there all find their own edges, and nothing is left to be told.
    again = search.aligned(every, [NOTHING] * len(every), jump @ poses, FINE, const.POINTS_MAX)
    assert again is not None
    assert _jump(jump @ poses, again[0], explains(again[0]), owners, INTRINSICS) is None


def test_where_no_guess_is_sure_none_tells_where_the_camera_looks() -> None:
    poses = np.stack([invert(CAMERA) @ POSES[0] @ make_pose(np.eye(3), np.array([0.05, 0.06, 0.0]))])
    search, every = _Search(image(), INTRINSICS, LEVEL, None), [controls(0, poses[0])]
    found = search.aligned(every, [NOTHING], poses, FINE, const.POINTS_MAX)
    assert found is not None
    assert _jump(poses, found[0], explains(found[0]), np.array([0]), INTRINSICS) is None
