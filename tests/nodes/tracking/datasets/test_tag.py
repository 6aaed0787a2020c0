"""The camera's pose by a tag on the table: as true as it should be, and enough to track by."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.tags import draw_tag

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.datasets.tag import find, tag_of
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors, object_errors
from hierax.nodes.tracking.generator.kinds import INTRINSICS, SIZE
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.nodes.tracking.math.geometry import exp_se3, exp_so3, invert, looking_down, make_pose, pose_error
from hierax.nodes.tracking.world import spatial, world
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run

SEED = 5
SIDE_M = 0.08
APRILTAG = cv2.aruco.DICT_APRILTAG_36h11
FRAMES = 24


def table(rng: np.random.Generator) -> Any:
    grey = cv2.GaussianBlur(rng.normal(130.0, 60.0, (SIZE[1], SIZE[0])), (0, 0), 3.0)
    return np.clip(grey + rng.normal(0.0, 2.5, grey.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("elevation_deg", [25, 40, 60, 80])
@pytest.mark.parametrize(("name", "tag"), [("36h11", (APRILTAG, 7)), ("5x5_50", (cv2.aruco.DICT_5X5_50, 3))])
def test_from_half_a_metre_it_tells_the_camera_by_a_millimetre(
    elevation_deg: int, name: str, tag: tuple[int, int]
) -> None:
    rng = np.random.default_rng([SEED, elevation_deg])
    asked = tag_of(1000 * SIDE_M, name)
    assert asked is not None
    for _ in range(3):
        beside = np.append(rng.uniform(-0.06, 0.06, 2), 0.0)
        camera = looking_down(rng.uniform(-3, 3), np.radians(elevation_deg), 0.5, beside)
        camera = camera @ exp_se3(np.append(np.zeros(5), rng.uniform(-3, 3)))
        seen = find(asked, draw_tag(table(rng), camera, INTRINSICS, SIDE_M, rng, tag), INTRINSICS, "picture")
        assert seen is not None, f"seed {SEED}"
        distance, angle = pose_error(invert(seen.camera), invert(camera))
        assert (seen.number, distance < 0.001, angle < np.radians(0.3)) == (tag[1], True, True), (distance, angle)


def test_what_is_no_tag_of_these_is_none() -> None:
    rng = np.random.default_rng(SEED)
    camera = looking_down(0.3, 0.8, 0.5, np.zeros(3))
    picture = draw_tag(table(rng), camera, INTRINSICS, SIDE_M, rng, (APRILTAG, 7))
    for name, there in (("36h11:7", True), ("36h11:8", False), ("25h9", False), ("4x4_50", False)):
        asked = tag_of(80.0, name)
        assert asked is not None
        assert (find(asked, picture, INTRINSICS, "picture") is not None) == there
    both = draw_tag(picture, make_pose(np.eye(3), [-0.12, 0.0, 0.0]) @ camera, INTRINSICS, SIDE_M, rng, (APRILTAG, 9))
    asked = tag_of(80.0)
    assert asked is not None
    with pytest.raises(DataError, match=re.escape("picture: shows several tags: 36h11 ")):
        find(asked, both, INTRINSICS, "picture")
    assert find(asked._replace(number=9), both, INTRINSICS, "picture") is not None


@pytest.mark.parametrize(
    ("side_mm", "name", "message"),
    [
        (0.0, "36h11", "tag_mm is 0.0; expected millimetres from 1 to 10000"),
        (-40.0, "36h11", "tag_mm is -40.0"),
        (float("nan"), "36h11", "tag_mm is nan"),
        (40.0, "36h12", "tag is '36h12'; expected FAMILY or FAMILY:NUMBER, of the families 4x4_100, "),
        (40.0, "36h11:", "tag is '36h11:'"),
        (40.0, "36h11:x", "tag is '36h11:x'"),
        (40.0, "36h11:587", "tag is 587; expected a number of the family 36h11 from 0 to 586"),
    ],
)
def test_options_that_are_no_tag_are_told(side_mm: float, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        tag_of(side_mm, name)


def test_the_simulated_world_has_no_tag_and_a_folder_without_one_is_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected it with a scene folder or a camera alone"):
        world(tag_mm=40.0)
    scene = write_scene(tmp_path, "scattered", 1, 2, True, 1)
    with pytest.raises(DataError, match=re.escape("no tag 36h11:3 is seen well enough in its first 2 pictures")):
        spatial(str(scene), table=True, tag_mm=40.0, tag="36h11:3")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of three objects, with a drifting camera, and a tag that lies on its table."""
    out = tmp_path_factory.mktemp("tagged")
    scene = write_scene(out, "scattered", 5, FRAMES, False, 3)
    cameras = json.loads((out / "truth" / "000001" / "scene_camera.json").read_text())
    world_from_tag = make_pose(exp_so3(np.array([0.0, 0.0, 0.4])), np.array([-0.07, -0.08, 0.0]))
    rng = np.random.default_rng(SEED)
    for frame, told in cameras.items():
        file = scene / "rgb" / f"{int(frame):06d}.png"
        rotation = np.array(told["cam_R_w2c"]).reshape(3, 3)
        camera = invert(make_pose(rotation, np.array(told["cam_t_w2c"]) / 1000.0))
        picture = cv2.imread(str(file), cv2.IMREAD_COLOR)
        seen = draw_tag(picture, invert(world_from_tag) @ camera, INTRINSICS, SIDE_M, rng, (APRILTAG, 7))
        cv2.imwrite(str(file), seen)
    return scene


def untold(scene: Path, to: Path) -> Path:
    """The scene without camera poses."""
    shutil.copytree(scene.parent.parent, to)
    copy = to / "test" / scene.name
    path = copy / "scene_camera.json"
    cameras = json.loads(path.read_text())
    path.write_text(json.dumps({frame: {"cam_K": each["cam_K"]} for frame, each in cameras.items()}))
    return copy


def errors_of(scene: Path, poses: Path, *settings: str) -> list[ObjectErrors]:
    told = [f"scene={scene}", "table=true", f"output={poses}", *settings]
    run(read_deployment("tracking", told), epochs=None, seed=0)
    return list(object_errors(read_results(poses), read_truth(scene.parent.parent / "truth" / scene.name)))


@pytest.mark.slow
def test_a_scene_without_camera_poses_is_tracked_by_its_tag_as_with_them(scene: Path, tmp_path: Path) -> None:
    with_poses = errors_of(scene, tmp_path / "with.csv")
    silent = untold(scene, tmp_path / "untold")
    by_tag = errors_of(silent, tmp_path / "tag.csv", f"tag_mm={1000 * SIDE_M}")
    # where poses are told, in another world, the tag alone tells where its table is
    both = errors_of(scene, tmp_path / "both.csv", f"tag_mm={1000 * SIDE_M}")
    for told, tagged, each in zip(with_poses, by_tag, both, strict=True):
        assert told.within((5.0, 5.0))[1:].all()
        assert tagged.within((2.0, 2.0))[2:].all(), tagged.distance_mm
        assert np.median(each.distance_mm[1:]) < np.median(told.distance_mm[1:]) + 1.5


@pytest.mark.slow
def test_with_a_tag_an_object_is_found_where_neither_camera_nor_poses_are_told(scene: Path, tmp_path: Path) -> None:
    silent = untold(scene, tmp_path / "untold")
    found = errors_of(silent, tmp_path / "found.csv", f"tag_mm={1000 * SIDE_M}", "tag=36h11:7", "start=search")
    # where camera poses are told, too, the search is sure of the last one alone in so few pictures
    assert found[2].distance_mm[FRAMES - 1] < 2.0, [each.distance_mm[FRAMES - 1] for each in found]
