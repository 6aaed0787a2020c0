"""Tracking with a camera of one's own: as a scene folder is tracked, from a folder, a video, and a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support.cameras import filmed, settings
from support.launched import said_here
from support.tags import draw_tag

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image, write_picture
from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.generator.kinds import INTRINSICS
from hierax.nodes.tracking.math.geometry import looking_down, pose_error
from hierax.nodes.tracking.paper.arm import PaperArmNode
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.schema import ArmBelief, PaperArmBelief, SpatialBelief, fault
from hierax.nodes.tracking.world import arm, seen, spatial, world
from hierax.runtime import Tick
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run
from hierax.runtime.recording.reading import Recording
from hierax.schemas.values import encode_value

FRAMES = 6


@pytest.fixture(scope="module")
def filmed_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("filmed")
    filmed(out, FRAMES)
    return out


def states(recording: Path, *nodes: str) -> Iterator[list[bytes]]:
    for epoch in Recording.open(recording).epochs():
        yield [encode_value(tuple(epoch.nodes[name].state)) for name in nodes]


def recorded(path: Path, *told: str) -> Path:
    done = said_here("run", "tracking", *(word for each in told for word in ("--set", each)), "--record", str(path))
    assert done.returncode == 0, done.stderr
    return path


def test_poses_are_those_of_the_scene_folder_to_the_bit(filmed_scene: Path, tmp_path: Path) -> None:
    out = filmed_scene
    scene = recorded(tmp_path / "scene.mcap", f"scene={out / 'test' / '000001'}")
    video = recorded(tmp_path / "video.mcap", *settings(out, out / "video.avi"))
    folder = recorded(tmp_path / "folder.mcap", *settings(out, out / "frames"))
    again = recorded(tmp_path / "again.mcap", f"camera={video}", f"objects={out / 'objects.yaml'}")
    expected = list(states(scene, "arm", "spatial"))
    assert len(expected) == FRAMES
    for other in (video, folder, again):
        assert list(states(other, "arm", "spatial")) == expected, other.name
    # but for its settings, a run is the same: the world's states are, too
    for other in (folder, again):
        assert list(states(other, "world")) == list(states(video, "world")), other.name
    done = said_here("replay", str(video), "--verify")
    assert (done.returncode, "all results are alike" in done.stdout) == (0, True), done.stderr


def test_a_gray_video_is_a_gray_folder(tmp_path: Path) -> None:
    filmed(tmp_path, 3, objects=1, grey=True)
    scene = recorded(tmp_path / "scene.mcap", f"scene={tmp_path / 'test' / '000001'}")
    video = recorded(tmp_path / "video.mcap", *settings(tmp_path, tmp_path / "video.avi"))
    assert list(states(scene, "arm", "spatial")) == list(states(video, "arm", "spatial"))


def told(out: Path, **changes: Any) -> Path:
    """The objects' file with other entries beside it."""
    content = yaml.safe_load((out / "objects.yaml").read_text())
    path = out / "changed.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


def beliefs_of(out: Path, file: Path, epochs: int, **options: Any) -> list[tuple[Any, Any]]:
    """The arm's beliefs after its observations, and the spatial node's after its predictions."""
    shown = world(camera=str(out / "frames"), calibration=str(out / "camera.yaml"), objects=str(file), **options)
    nodes = arm(objects=str(file)), spatial(objects=str(file)), SegmentedDepth()
    beliefs: list[Any] = [each.initial_belief() for each in (shown, *nodes[:2])]
    found = []
    for epoch in range(1, epochs + 1):
        tick = Tick(epoch=epoch, time_s=shown.time_s(beliefs[0], epoch))
        beliefs[1] = nodes[0].observe(seen(beliefs[0]), beliefs[1])
        beliefs[2] = nodes[1].predict((), (), nodes[1].observe(poses_seen(beliefs[1]), beliefs[2], tick))
        found.append((beliefs[1], beliefs[2]))
        beliefs[1] = nodes[0].predict(nodes[2](beliefs[2]), (), beliefs[1])
        beliefs[0] = shown.predict((), (), beliefs[0])
    return found


def test_poses_may_be_told_in_the_worlds_frame(filmed_scene: Path) -> None:
    out = filmed_scene
    camera = looking_down(0.4, 0.9, 0.6, np.zeros(3))
    entries = yaml.safe_load((out / "objects.yaml").read_text())["objects"]
    plain = told(out, camera=camera.tolist())
    expected = beliefs_of(out, plain, 3)
    first = {**entries[0], "frame": "world", "pose": (camera @ np.array(entries[0]["pose"])).tolist()}
    mixed = told(out, camera=camera.tolist(), objects=[first, *entries[1:]])
    for (one, above), (other, its) in zip(expected, beliefs_of(out, mixed, 3), strict=True):
        np.testing.assert_allclose(one["camera"], camera, atol=0.01)
        for item, like in zip(one["objects"], other["objects"], strict=True):
            np.testing.assert_allclose(item["pose"], like["pose"], atol=1e-6)
        for body, like in zip(above["bodies"], its["bodies"], strict=True):
            np.testing.assert_allclose(body["pose"], like["pose"], atol=1e-6)


def test_a_tag_tells_the_camera_of_a_video(tmp_path: Path) -> None:
    """Poses told in the tag's frame and in the camera's come to the same; before it is seen nothing is observed."""
    seed, side_m = 6, 0.08
    scene = filmed(tmp_path, 4, objects=1)
    camera, rng = looking_down(0.5, 0.8, 0.6, np.array([0.1, 0.1, 0.0])), np.random.default_rng(seed)
    for number in range(1, 4):
        shot = tmp_path / "frames" / f"shot {number}.png"
        write_picture(shot, draw_tag(read_image(shot), camera, INTRINSICS, side_m, rng, (20, 7)))
    (entry,) = yaml.safe_load((tmp_path / "objects.yaml").read_text())["objects"]
    on_table = {**entry, "frame": "world", "pose": (camera @ np.array(entry["pose"])).tolist()}
    for name, told_as in (("camera", entry), ("world", on_table)):
        file = told(tmp_path, objects=[told_as])
        found = beliefs_of(tmp_path, file, 4, tag_mm=1000 * side_m)
        assert (found[0][0]["frame"], found[1][0]["frame"]) == (None, 1), f"{name}, seed {seed}"
        for sensed, imagined in found[1:]:
            distance, angle = pose_error(sensed["reported"], camera)
            assert (distance < 0.002, angle < np.radians(0.5)) == (True, True), f"{name}, seed {seed}"
            assert pose_error(sensed["objects"][0]["pose"], np.array(entry["pose"]))[0] < 0.03, f"{name}, seed {seed}"
            np.testing.assert_allclose(imagined["bodies"][0]["pose"][2, 3], on_table["pose"][2][3], atol=0.03)
    both = str(told(tmp_path, camera=np.eye(4).tolist()))
    with pytest.raises(ValueError, match=r"tag_mm is 80, and .* tells the camera's pose"):
        world(camera=str(scene / "rgb"), calibration="x", objects=both, tag_mm=80)


@pytest.mark.parametrize(("method", "kind"), [("robust", ArmBelief), ("paper", PaperArmBelief)])
def test_without_a_picture_nothing_is_tracked_and_it_is_said(filmed_scene: Path, method: str, kind: Any) -> None:
    out = filmed_scene
    files = {"objects": str(out / "objects.yaml")}
    shown = world(camera=str(out / "frames"), calibration=str(out / "camera.yaml"), **files)
    tracker, above, imagined = arm(method=method, **files), spatial(**files), SegmentedDepth()
    assert isinstance(tracker, ArmNode | PaperArmNode)
    beliefs: list[Any] = [each.initial_belief() for each in (shown, tracker, above)]
    statuses = []
    for epoch in range(1, 7):
        pictures = () if epoch in (1, 4, 5) else seen(beliefs[0])
        beliefs[1] = tracker.observe(pictures, beliefs[1])
        statuses.append({item["status"] for item in beliefs[1]["objects"]})
        objects = poses_seen(beliefs[1])
        assert (beliefs[1]["frame"] is None) == (objects == ()) == (not pictures)
        tick = Tick(epoch=epoch, time_s=epoch / 30.0)
        beliefs[2] = above.predict((), (), above.observe(objects, beliefs[2], tick))
        beliefs[1] = tracker.predict(imagined(beliefs[2]), (), beliefs[1])
        assert fault(beliefs[1], kind, "arm") == fault(beliefs[2], SpatialBelief, "spatial") == ""
        if pictures:
            beliefs[0] = shown.predict((), (), beliefs[0])
    assert statuses == [{"expected"}, {"expected"}, {"tracked"}, {"expected"}, {"expected"}, {"tracked"}]


def test_a_file_of_poses_has_no_lines_of_epochs_without_a_picture(filmed_scene: Path, tmp_path: Path) -> None:
    out = filmed_scene
    asked = settings(out, out / "video.avi", f"output={tmp_path / 'poses.csv'}")
    run(read_deployment("tracking", asked), epochs=None, seed=0)
    results = read_results(tmp_path / "poses.csv")
    assert [result.im_id for result in results] == [frame for frame in range(FRAMES) for _ in range(2)]
    first = np.array(yaml.safe_load((out / "objects.yaml").read_text())["objects"][0]["pose"])
    np.testing.assert_allclose(results[0].pose, first, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"calibration": "x"}, "calibration is given and camera is not; expected it with a camera alone"),
        ({"objects": "x"}, "objects is given and camera is not"),
        ({"camera": 0}, "camera is 0 and objects is not given"),
        ({"camera": 0, "objects": "x"}, "camera is 0 and calibration is not given; expected a file, see hierax calib"),
        ({"camera": 0, "scene": "x"}, "scene is x and camera is 0; expected one of the two"),
        ({"camera": 0, "calibration": "x", "objects": "OBJECTS", "source_timeout": 0}, "source_timeout is 0.0; expect"),
    ],
)
def test_what_does_not_go_together_is_told(options: dict[str, Any], message: str, filmed_scene: Path) -> None:
    known = {"OBJECTS": str(filmed_scene / "objects.yaml"), "x": str(filmed_scene / "camera.yaml")}
    given = {name: known.get(str(value), value) for name, value in options.items()}
    shown = message.replace("scene is x", f"scene is {known['x']}").replace("0.0", "0")
    with pytest.raises(ValueError, match=re.escape(shown)):
        world(**given)


def test_a_size_that_does_not_fit_the_calibration_is_refused(filmed_scene: Path, tmp_path: Path) -> None:
    out = filmed_scene
    calibration = tmp_path / "camera.yaml"
    calibration.write_text((out / "camera.yaml").read_text().replace("image_width: 640", "image_width: 1280"))
    shown = world(camera=str(out / "video.avi"), calibration=str(calibration), objects=str(out / "objects.yaml"))
    with pytest.raises(DataError, match=re.escape("video.avi: has 640×480 pixels; expected 1280×480")):
        shown.initial_belief()
