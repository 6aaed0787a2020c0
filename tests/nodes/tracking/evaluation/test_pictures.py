"""Pictures and videos of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.arm_steps import arm_belief, step

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.evaluation.pictures import (
    CONTACT_SHEET,
    CORRECTED,
    EXPECTED,
    VIDEO_FILE,
    Pictures,
    overlay,
    write_picture,
    write_video,
)
from hierax.nodes.tracking.math.geometry import make_pose


def grey() -> Any:
    return np.full((120, 160), 90, np.uint8)


def test_pictures_are_drawn_first_every_so_often_and_last(tmp_path: Path) -> None:
    probe = Pictures(every=4)
    probe.open(tmp_path)
    for epoch in range(1, 8):
        probe.record(step(epoch, arm_belief(epoch - 1), grey()))
    probe.close()
    names = sorted(path.name for path in (tmp_path / "pictures").iterdir())
    assert names == [CONTACT_SHEET, "frame-000000.png", "frame-000004.png", "frame-000006.png"]
    sheet = cv2.imread(str(tmp_path / "pictures" / CONTACT_SHEET))
    assert sheet.shape == (360, 3 * 480, 3)


def test_an_epoch_told_again_is_drawn_again(tmp_path: Path) -> None:
    """With the same expected edges, and once in the contact sheet."""
    probe = Pictures(every=1)
    probe.open(tmp_path)
    probe.record(step(1, arm_belief(0, x=-0.06), grey()))
    probe.record(step(2, arm_belief(1, x=0.0), grey(), belief=arm_belief(1, x=0.2)))
    probe.record(step(2, arm_belief(1, x=0.06), grey(), attempt=1))
    probe.close()
    assert read_picture(tmp_path, 1) == overlay(grey(), arm_belief(0, x=-0.06), arm_belief(1, x=0.06)).tolist()
    assert cv2.imread(str(tmp_path / "pictures" / CONTACT_SHEET)).shape == (360, 2 * 480, 3)


def read_picture(output: Path, frame: int) -> Any:
    return read_image(output / "pictures" / f"frame-{frame:06d}.png").tolist()


def test_the_contact_sheet_has_the_pictures_of_a_dead_process_too(tmp_path: Path) -> None:
    images = [np.full((120, 160), 20 * epoch, np.uint8) for epoch in range(7)]
    lived, dead, probe = Pictures(every=2), Pictures(every=2), Pictures(every=2)
    folders = {name: tmp_path / name for name in ("lived", "died")}
    for folder in folders.values():
        folder.mkdir()
    blind = {**arm_belief(0), "objects": ()}
    lived.open(folders["lived"])
    dead.open(folders["died"])
    for epoch in range(1, 7):
        lived.record(step(epoch, {**blind, "frame": epoch - 1}, images[epoch]))
    for epoch in range(1, 4):
        dead.record(step(epoch, {**blind, "frame": epoch - 1}, images[epoch if epoch < 3 else 0]))
    (folders["died"] / "pictures" / "frame-000001.png.part").write_bytes(b"\x89PNG")  # killed within a picture
    probe.open_again(folders["died"])
    for epoch in range(3, 7):
        probe.record(step(epoch, {**blind, "frame": epoch - 1}, images[epoch], attempt=1))
    lived.close()
    probe.close()
    files = [{path.name: path.read_bytes() for path in (each / "pictures").iterdir()} for each in folders.values()]
    assert sorted(files[0]) == [CONTACT_SHEET, *(f"frame-00000{frame}.png" for frame in (0, 2, 4, 5))]
    assert files[0] == files[1]


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none/picture\.png: cannot be written"):
        write_picture(tmp_path / "none" / "picture.png", np.zeros((4, 4, 3), np.uint8))


def test_a_picture_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "picture.png"
    write_picture(path, np.full((4, 4, 3), 7, np.uint8))

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_picture(path, np.full((4, 4, 3), 9, np.uint8))
    assert (read_image(path) == 7).all()


def test_a_run_that_saw_nothing_leaves_no_pictures(tmp_path: Path) -> None:
    probe = Pictures()
    probe.open(tmp_path)
    probe.close()
    assert list((tmp_path / "pictures").iterdir()) == []


def test_expected_edges_are_red_where_they_were_expected_and_corrected_ones_green() -> None:
    picture = overlay(grey(), arm_belief(0, x=0.0), arm_belief(1, x=0.06))
    assert picture.shape == (120, 160, 3)
    # The left side at x - 0.05, 0.4 away; the camera's middle row.
    expected, corrected = (round(200.0 * (x - 0.05) / 0.4 + 79.5) for x in (0.0, 0.06))
    row = picture[50].astype(int)
    assert abs(_most(row, EXPECTED) - expected) <= 1
    assert abs(_most(row, CORRECTED) - corrected) <= 1


def test_an_object_that_is_not_tracked_has_no_green() -> None:
    picture = overlay(grey(), arm_belief(0), arm_belief(1, x=0.06, status="lost")).astype(int)
    green = (picture[:100, :, 1] - picture[:100, :, 0]) > 40
    assert not green.any()
    assert ((picture[:100, :, 0] - picture[:100, :, 1]) > 40).any()


def test_the_camera_moves_what_was_expected() -> None:
    moved = {**arm_belief(1), "camera": make_pose(np.eye(3), np.array([0.04, 0.0, 0.0]))}
    picture = overlay(np.zeros((120, 160, 3), np.uint8), arm_belief(0), moved)
    expected = round(200.0 * (-0.05 - 0.04) / 0.4 + 79.5)
    assert abs(_most(picture[50].astype(int), EXPECTED) - expected) <= 1


def _most(row: Any, colour: tuple[int, int, int]) -> int:
    """The leftmost pixel of a row whose colour is about the given one."""
    return int(np.argmax(np.abs(row - np.array(colour)).sum(axis=1) < 120))


def test_nothing_of_a_step_is_changed(tmp_path: Path) -> None:
    image = np.full((120, 160, 3), 90, np.uint8)
    image.flags.writeable = False
    probe = Pictures(every=1)
    probe.open(tmp_path)
    probe.record(step(1, arm_belief(0), image))
    probe.close()
    assert (image == 90).all()


def test_every_must_be_positive() -> None:
    with pytest.raises(ValueError, match="every"):
        Pictures(every=0)


def test_a_video_has_every_frame_also_those_of_a_dead_process(tmp_path: Path) -> None:
    for process, frames in enumerate((range(5), range(5, 12))):
        probe = Pictures(every=4, video=True, fps=20.0)
        if process:
            probe.open_again(tmp_path)
        else:
            probe.open(tmp_path)
        for frame in frames:
            probe.record(step(frame + 1, arm_belief(frame), grey() + frame))
        if process:
            probe.close()
    video = cv2.VideoCapture(str(tmp_path / VIDEO_FILE))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(20.0)
    shown, frame = video.read()
    assert shown
    assert frame.shape == (120, 160, 3)
    video.release()
    assert not list(tmp_path.glob("unfinished-*"))


def test_a_video_that_cannot_be_written_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_picture(tmp_path / "one.png", np.zeros((120, 160, 3), np.uint8))
    with pytest.raises(DataError, match=r"none/video\.mp4: cannot be written"):
        write_video(tmp_path / "none" / "video.mp4", [tmp_path / "one.png"], 30.0)
    with pytest.raises(ValueError, match="fps is 0"):
        Pictures(fps=0)
