"""The world over a BOP scene."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import ReadAhead, read_image
from hierax.nodes.tracking.datasets.bop_world import BopWorld, frame_seen


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "test" / "000001"
    (folder / "gray").mkdir(parents=True)
    cameras = {}
    for number in (4, 5):
        cv2.imwrite(str(folder / "gray" / f"{number:06d}.pgm"), np.full((6, 8), number, dtype=np.uint8))
        cameras[str(number)] = {"cam_K": [500.0, 0.0, 4.0, 0.0, 500.0, 3.0, 0.0, 0.0, 1.0]}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder


def test_every_frame_is_seen_once(scene: Path) -> None:
    world = BopWorld(str(scene), fps=20.0)
    belief = world.initial_belief()
    seen = []
    while not world.finished(belief):
        (element,) = frame_seen(belief)
        seen.append((element["frame"], int(element["image"][0, 0]), world.time_s(belief, 1)))
        belief = world.predict((), (), belief)
    assert seen == [(4, 4, 0.0), (5, 5, 0.05)]
    assert frame_seen(belief) == ()
    assert world.predict((), (), belief) == belief


def test_elements_are_as_the_arm_expects_them(scene: Path) -> None:
    (element,) = frame_seen(BopWorld(str(scene)).initial_belief())
    assert element["image"].dtype == np.uint8
    assert np.array_equal(element["camera"], np.eye(4))
    assert element["intrinsics"].tolist() == [500.0, 500.0, 4.0, 3.0]


def test_bad_parameters(tmp_path: Path, scene: Path) -> None:
    with pytest.raises(DataError, match="no such folder"):
        BopWorld(str(tmp_path / "none"))
    with pytest.raises(ValueError, match="fps must be positive"):
        BopWorld(str(scene), fps=0.0)


def test_images_read_ahead_are_those_asked_for_in_any_order(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.pgm" for number in range(12)]
    for number, path in enumerate(paths):
        cv2.imwrite(str(path), np.full((6, 8), number, dtype=np.uint8))
    images = ReadAhead(paths, read_image, depth=3)
    order = [0, 1, 2, 2, 1, 7, 8, 8, 0, 11, 10, 11]
    assert [int(images.read(index)[0, 0]) for index in order] == order


def test_what_is_wrong_with_an_image_is_said_when_it_is_asked_for(tmp_path: Path) -> None:
    paths = [tmp_path / "0.pgm", tmp_path / "1.pgm"]
    cv2.imwrite(str(paths[0]), np.zeros((6, 8), dtype=np.uint8))
    images = ReadAhead(paths, read_image)
    assert images.read(0).shape == (6, 8)
    for _ in range(2):
        with pytest.raises(DataError, match=r"1\.pgm: no such file"):
            images.read(1)
        images.read(0)
