"""Folders, videos and recordings: every frame in order, also from the middle on, and what is wrong with them."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from support.boards import PINHOLE
from support.junk_recordings import Contents
from support.launched import said_here
from support.streams import number_of, numbered

from hierax.nodes.sources.calibration import write_calibration
from hierax.nodes.sources.camera import CameraWorld, picture_seen
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array, write_picture
from hierax.nodes.sources.played import Folder
from hierax.nodes.sources.recorded import shot_of
from hierax.runtime.recording.trace import EpochTrace
from hierax.runtime.recording.writing import ENDING
from hierax.runtime.testing.node import check_node

COUNT = 12
SIZE = (320, 240)


def shot(number: int) -> Array:
    noise = np.random.default_rng(number).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    return numbered(noise, number)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("played")
    (out / "shots").mkdir()
    codec: Any = cv2.VideoWriter_fourcc(*"FFV1")  # type: ignore[attr-defined]
    writer = cv2.VideoWriter(str(out / "video.avi"), codec, 10.0, SIZE)
    for number in range(COUNT):
        write_picture(out / "shots" / f"shot{number}.png", shot(number))
        writer.write(np.ascontiguousarray(shot(number)[..., ::-1]))
    writer.release()
    return out


@pytest.mark.parametrize("name", ["video.avi", "shots"])
def test_every_frame_is_shown_in_order_and_nothing_after_the_last(folder: Path, name: str) -> None:
    world = CameraWorld(str(folder / name), fps=20.0)
    belief = world.initial_belief()
    for number in range(COUNT):
        (picture,) = picture_seen(belief)
        np.testing.assert_array_equal(picture["image"], shot(number))
        assert (picture["frame"], number_of(picture["image"]), world.time_s(belief, 1)) == (
            number,
            number,
            number / 20.0,
        )
        assert not world.finished(belief)
        belief = world.predict((), (), belief)
    assert (picture_seen(belief), world.finished(belief)) == ((), True)
    assert world.predict((), (), belief) == belief
    assert world.metrics(belief) == {"passed_over": 0.0, "stalls": 0.0, "reopened": 0.0}


@pytest.mark.parametrize("name", ["video.avi", "shots"])
def test_an_epoch_done_again_shows_the_same_also_in_another_process(folder: Path, name: str) -> None:
    world = CameraWorld(str(folder / name))
    beliefs = [world.initial_belief()]
    for _ in range(6):
        beliefs.append(world.predict((), (), beliefs[-1]))
    for at in (5, 1, 4):
        for again in (world, CameraWorld(str(folder / name))):
            np.testing.assert_array_equal(again.predict((), (), beliefs[at])["image"], shot(at + 1))


def test_a_time_in_a_relative_name_is_no_protocol(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "10:30:00.avi").write_bytes((folder / "video.avi").read_bytes())
    (tmp_path / "11:30:00.avi").touch()
    monkeypatch.chdir(tmp_path)
    (picture,) = picture_seen(CameraWorld("10:30:00.avi").initial_belief())
    np.testing.assert_array_equal(picture["image"], shot(0))
    with pytest.raises(DataError, match=re.escape("11:30:00.avi: cannot be opened")) as raised:
        CameraWorld("11:30:00.avi").initial_belief()
    assert str(tmp_path) not in str(raised.value)


def test_the_world_keeps_what_every_node_must(folder: Path) -> None:
    check_node(lambda: CameraWorld(str(folder / "video.avi")), epochs=5)


HIERARCHY = """
hierarchy: eye
world: camera
nodes:
  camera: {class: hierax.nodes.sources.camera:CameraWorld, parameters: {source: SOURCE, calibration: CALIBRATION}}
  eye: {class: "support.cameras:Eye"}
edges:
  camera -> eye: {sense: hierax.nodes.sources.camera:picture_seen}
"""


def test_any_hierarchy_can_use_it_and_its_recording(folder: Path, tmp_path: Path) -> None:
    calibration = tmp_path / "camera.yaml"
    write_calibration(replace(PINHOLE, size=SIZE), calibration)
    video = tmp_path / "0.mcap"
    sources = ((folder / "video.avi", calibration), (folder / "shots", calibration), (video, "null"))
    for number, (source, lens) in enumerate(sources):
        file = tmp_path / f"{number}.yaml"
        file.write_text(HIERARCHY.replace("SOURCE", str(source)).replace("CALIBRATION", str(lens)))
        done = said_here("run", str(file), "--record", str(tmp_path / f"{number}.mcap"))
        assert done.returncode == 0, done.stderr
        done = said_here("diff", str(video), str(tmp_path / f"{number}.mcap"))
        assert "first difference" not in done.stdout, done.stdout
        assert f"{COUNT} epochs" in done.stdout, done.stdout


def test_of_a_recording_that_was_cut_off_one_warning_tells(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told, run = tmp_path / "eye.yaml", tmp_path / "run.mcap"
    told.write_text(HIERARCHY.replace("SOURCE", str(folder / "shots")).replace("CALIBRATION", "null"))
    done = said_here("run", str(told), "--record", str(run))
    assert done.returncode == 0, done.stderr
    contents = Contents.read(run)
    del contents.metadata[ENDING]
    contents.write(tmp_path / "cut.mcap")
    replace(contents, said=()).write(tmp_path / "empty.mcap")
    for name, warnings in (("run.mcap", 0), ("cut.mcap", 1)):
        caplog.clear()
        world = CameraWorld(str(tmp_path / name))
        beliefs = [world.initial_belief()]
        while not beliefs[-1]["ended"]:
            beliefs.append(world.predict((), (), beliefs[-1]))
        assert len(beliefs) == COUNT + 1
        world.predict((), (), beliefs[0])  # an epoch that is done again
        assert caplog.text.count(f"{name}: it was cut off: its last chunk") == len(caplog.records) == warnings
    with pytest.raises(DataError, match=re.escape("empty.mcap: has no epochs; expected some to show")):
        CameraWorld(str(tmp_path / "empty.mcap")).initial_belief()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        (
            "none",
            None,
            "none: no such file; expected a device's number, a video, a folder of images, a recording, a bag, a topic,",
        ),
        ("a.mp4", b"no video", "a.mp4: cannot be opened; expected a video, a recording, or a folder of images"),
        ("a.mp4", b"", "a.mp4: cannot be opened"),
        ("a.mcap", b"\x89MCAP0\r\n", "a.mcap: was cut off before it says what it is of"),
        ("a.mcap", b"\x89MCAP", "a.mcap: is no recording"),
    ],
)
def test_what_is_no_source_is_told(name: str, content: bytes | None, told: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=re.escape(told)):
        CameraWorld(str(tmp_path / name)).initial_belief()


def test_an_empty_folder_and_a_scene_are_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no images in it; expected some of \.png, \.jpg"):
        CameraWorld(str(tmp_path)).initial_belief()
    (tmp_path / "scene_camera.json").touch()
    with pytest.raises(DataError, match="a scene in the BOP format is scene="):
        CameraWorld(str(tmp_path)).initial_belief()


def test_a_picture_of_another_size_is_refused(tmp_path: Path) -> None:
    write_picture(tmp_path / "0.png", shot(0))
    write_picture(tmp_path / "1.png", shot(1)[:100])
    world = CameraWorld(str(tmp_path))
    with pytest.raises(DataError, match=re.escape("1.png: has 320×100 pixels; expected 320×240")):
        world.predict((), (), world.initial_belief())


def test_a_video_that_is_cut_off_is_told(folder: Path, tmp_path: Path) -> None:
    """What its head says is there, and more than a second of it lacks."""
    data = (folder / "video.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 12])
    world = CameraWorld(str(tmp_path / "cut.avi"))

    def play() -> None:
        belief = world.initial_belief()
        while not belief["ended"]:
            belief = world.predict((), (), belief)

    with pytest.raises(DataError, match=r"cut\.avi: ends, or is damaged, after \d+ frames; expected 12, as it says"):
        play()


def test_a_video_without_a_frame_is_told(tmp_path: Path) -> None:
    """It is so short that its head may be wrong by all of it."""
    writer = cv2.VideoWriter(str(tmp_path / "one.avi"), cv2.VideoWriter_fourcc(*"FFV1"), 30, (64, 48))  # type: ignore[attr-defined]
    writer.write(np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8))
    writer.release()
    data = (tmp_path / "one.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: data.index(b"movi") + 200])
    world = CameraWorld(str(tmp_path / "cut.avi"))
    with pytest.raises(DataError, match=r"cut\.avi: is damaged; expected a video of which a frame can be decoded"):
        world.predict((), (), world.initial_belief())


def test_a_recording_without_pictures_is_told_and_takes_no_calibration(tmp_path: Path) -> None:
    done = said_here("run", "servo", "--epochs", "3", "--record", str(tmp_path / "servo.mcap"))
    assert done.returncode == 0, done.stderr
    with pytest.raises(DataError, match="epoch 1: world showed no picture; expected image, camera"):
        CameraWorld(str(tmp_path / "servo.mcap")).initial_belief()
    write_calibration(PINHOLE, tmp_path / "c.yaml")
    with pytest.raises(DataError, match="is a recording, whose frames are straightened"):
        CameraWorld(str(tmp_path / "servo.mcap"), str(tmp_path / "c.yaml")).initial_belief()


@pytest.mark.parametrize("options", [{"fps": 0.0}, {"fps": float("inf")}, {"source_timeout": -1.0}])
def test_options_out_of_range_are_told(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))} is .*; expected a positive number"):
        CameraWorld(0, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("pose", [[[1.0]], "x", np.diag([1.0, 1.0, -1.0, 1.0]).tolist()])
def test_a_pose_that_is_none_is_told(pose: Any) -> None:
    with pytest.raises(DataError, match="pose: expected"):
        CameraWorld(0, pose=pose)


def test_pictures_of_16_bits_are_shown_where_that_is_asked_for(tmp_path: Path) -> None:
    depth = np.random.default_rng(4).integers(0, 65536, (SIZE[1], SIZE[0]), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "0.png"), depth)
    with pytest.raises(DataError, match=re.escape("0.png: uint16 pixels; expected 8 bits")):
        CameraWorld(str(tmp_path)).initial_belief()
    (seen,) = picture_seen(CameraWorld(str(tmp_path), deep=True).initial_belief())
    np.testing.assert_array_equal(seen["image"], depth)
    write_calibration(replace(PINHOLE, size=SIZE), tmp_path / "camera.yaml")
    world = CameraWorld(str(tmp_path), str(tmp_path / "camera.yaml"), deep=True)
    (seen,) = picture_seen(world.initial_belief())
    assert seen["image"].dtype == np.uint16
    assert np.isin(seen["image"], np.append(depth, 0)).all(), "depths are not mixed"


def test_a_video_that_has_less_than_it_says_is_told(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    data = (folder / "video.avi").read_bytes()
    (tmp_path / "half.avi").write_bytes(data[: len(data) // 2])
    for name, told in ((folder / "video.avi", 0), (tmp_path / "half.avi", 1)):
        world = CameraWorld(str(name))
        belief = world.initial_belief()
        while not belief["ended"]:
            belief = world.predict((), (), belief)
        assert caplog.text.count("frames; it says itself that it has 12") == told, caplog.text


def test_that_no_frame_told_where_the_camera_is_has_a_line(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    world = CameraWorld(str(folder / "shots"), locate=lambda *_: None)
    belief = world.initial_belief()
    while not belief["ended"]:
        assert picture_seen(belief) == ()
        belief = world.predict((), (), belief)
    assert "shots: has ended, and no frame told where the camera is, so nothing was observed" in caplog.text


def test_files_of_one_number_are_in_one_order_however_they_are_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = ["001.png", "01.png", "1.png", "2.png"]
    for listed in itertools.permutations(expected):
        monkeypatch.setattr(Path, "iterdir", lambda folder, listed=listed: map(folder.joinpath, listed))
        assert [path.name for path in Folder(tmp_path, 30.0)._files] == expected


class Epoch:
    """An epoch of a recording in which the world has shown this."""

    class edge:  # noqa: N801 - stands for an object, as the next one
        lower, pair = "world", ("world", "eye")

    class roster:  # noqa: N801
        world = "world"

    def __init__(self, **picture: Any) -> None:
        self.roster.edges = (self.edge,)  # type: ignore[attr-defined]
        self.epoch, self.time_s, self._picture = 7, 0.0, picture

    def elements(self, *line: str) -> tuple[Any, ...]:
        return (self._picture,)


@pytest.mark.parametrize("shape", [(), (5,), (0, 3), (4, 4, 2), (2, 3, 4, 1)])
def test_a_recordings_picture_of_another_shape_is_told(shape: tuple[int, ...]) -> None:
    picture = {"image": np.zeros(shape, np.uint8), "frame": 0, "camera": np.eye(4), "intrinsics": np.ones(4)}
    with pytest.raises(DataError, match=r"run\.mcap: epoch 7: image: expected gray \(h, w\) or RGB \(h, w, 3\), got"):
        shot_of("run.mcap", cast(EpochTrace, Epoch(**picture)))


@pytest.mark.parametrize(("camera", "intrinsics"), [(np.nan, 1.0), (1.0, np.inf)])
def test_a_recordings_camera_without_finite_numbers_is_told(camera: float, intrinsics: float) -> None:
    picture = {"image": np.zeros((4, 4), np.uint8), "frame": 0}
    placed = {"camera": np.full((4, 4), camera), "intrinsics": np.full(4, intrinsics)}
    with pytest.raises(DataError, match="camera, intrinsics: expected 4 × 4 and 4 finite numbers"):
        shot_of("run.mcap", cast(EpochTrace, Epoch(**picture, **placed)))
