"""The simulated world: its camera, its physics, and that it is a function of its belief."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.math.geometry import invert, pose_error, project, transform
from hierax.nodes.tracking.simworld.world import (
    DRIVEN_ID,
    LOOK_AT_M,
    SCENE,
    SimWorld,
    camera_at,
    drive_at,
    picture_seen,
)
from hierax.runtime import Tick
from hierax.schemas.values import decode_value, encode_value


def after(world: SimWorld, frames: int) -> Any:
    belief = world.initial_belief()
    for _ in range(frames):
        belief = world.predict((), (), belief)
    return belief


def test_it_ends_after_its_frames_and_counts_the_time() -> None:
    world = SimWorld(cubes=1, frames=4, fps=20.0)
    belief = world.initial_belief()
    times = []
    while not world.finished(belief):
        times.append(world.time_s(belief, len(times) + 1))
        belief = world.predict((), (), belief)
    assert times == pytest.approx([0.0, 0.05, 0.10, 0.15])
    assert belief["frame"] == 4


def test_only_the_driven_cube_moves() -> None:
    world = SimWorld()
    start, end = world.initial_belief(), after(world, 60)
    for before, now in zip(start["bodies"], end["bodies"], strict=True):
        distance, angle = pose_error(before["pose"], now["pose"])
        if before["id"] == DRIVEN_ID:
            assert 0.05 < distance < 0.10
        else:
            assert distance < 0.001
            assert angle < np.radians(0.5)


def test_the_thread_draws_softly_and_only_for_a_while() -> None:
    assert drive_at(0.0) is None
    assert drive_at(1.9) is None
    early, middle = drive_at(0.41), drive_at(1.1)
    assert early is not None
    assert middle is not None
    assert np.linalg.norm(early) < 0.01 < np.linalg.norm(middle)


def test_the_camera_looks_at_the_scene_and_moves_smoothly() -> None:
    poses = [camera_at(frame / 30) for frame in range(121)]
    for pose in poses:
        rotation = pose[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        ahead = transform(invert(pose), LOOK_AT_M)
        np.testing.assert_allclose(ahead[:2], 0.0, atol=1e-12)
        assert 0.4 < ahead[2] < 0.7
        assert rotation[2, 1] < 0
    steps = [pose_error(first, second) for first, second in pairwise(poses)]
    assert max(angle for _, angle in steps) < np.radians(1.5)
    assert max(distance for distance, _ in steps) < 0.015


@pytest.mark.parametrize("frame", [0, 30, 59])
def test_all_cubes_are_in_the_picture(frame: int) -> None:
    belief = after(SimWorld(), frame)
    np.testing.assert_array_equal(belief["camera"], camera_at(frame / 30))
    for body in belief["bodies"]:
        seen = invert(belief["camera"]) @ body["pose"]
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * body["side_m"] / 2
        pixels = project(transform(seen, corners), belief["intrinsics"])
        assert (pixels > 5).all()
        assert (pixels < (634, 474)).all()


def picture(belief: Any, seed: int) -> Any:
    (element,) = picture_seen(belief, Tick(seed=seed, subject="world->arm", operator="sense", epoch=1))
    return element


def test_the_picture_is_a_function_of_belief_and_tick() -> None:
    belief = SimWorld(width=160, height=120).initial_belief()
    first, second = picture(belief, 5), picture(decode_value(encode_value(belief)), 5)
    assert encode_value(first) == encode_value(second)
    assert not np.array_equal(first["image"], picture(belief, 6)["image"])
    assert first["image"].shape == (120, 160, 3)
    assert first["image"].dtype == np.uint8
    assert first["frame"] == 0


def test_without_noise_no_random_numbers_are_drawn() -> None:
    belief = SimWorld(width=160, height=120, noise=0.0).initial_belief()
    np.testing.assert_array_equal(picture(belief, 5)["image"], picture(belief, 6)["image"])


def test_a_frame_done_again_is_equal_to_the_bit() -> None:
    world = SimWorld()
    belief = after(world, 20)
    assert encode_value(world.predict((), (), belief)) == encode_value(world.predict((), (), belief))
    assert encode_value(SimWorld().predict((), (), decode_value(encode_value(belief)))) == encode_value(
        world.predict((), (), belief)
    )


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"cubes": 0}, "cubes"),
        ({"cubes": len(SCENE) + 1}, "cubes"),
        ({"frames": 0}, "frames"),
        ({"width": 10}, "width"),
        ({"noise": -1.0}, "noise"),
        ({"blur_px": -0.1}, "blur_px"),
        ({"fps": 0.0}, "fps"),
    ],
)
def test_options_out_of_range_are_named(options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        SimWorld(**options)
