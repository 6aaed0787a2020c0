"""Calibrations from rendered boards are those that they were rendered with."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.boards import CHARUCO, CHESSBOARD, FISHEYE, PINHOLE, SIZE, pictures

from hierax.nodes.sources.boards import Board, View, calibrate, find_views
from hierax.nodes.sources.calibration import Lens, read_calibration
from hierax.nodes.sources.files import DataError, write_whole
from hierax.nodes.sources.images import read_image
from hierax.runtime.commands.main import main

SEED = 3
CASES = {
    "chessboard": (CHESSBOARD, PINHOLE, "plumb_bob"),
    "charuco": (CHARUCO, PINHOLE, "plumb_bob"),
    "fisheye": (CHESSBOARD, FISHEYE, "equidistant"),
}


def views_of(board: Board, lens: Lens, count: int) -> list[View]:
    views, size = find_views("drawn", board, pictures(board, lens, count, SEED), 60, lambda *_: None)
    assert size == SIZE
    return views


@pytest.mark.parametrize("case", CASES)
def test_focal_lengths_are_right_by_three_in_a_thousand(case: str) -> None:
    board, lens, model = CASES[case]
    found = calibrate("drawn", views_of(board, lens, 16), SIZE, model)
    off = np.abs(found.lens.intrinsics[:2] / lens.intrinsics[:2] - 1.0)
    assert off.max() < 0.003, f"seed {SEED}: {off}"
    assert found.rms_px < 0.3
    assert len(found.views) >= 12
    # what is straightened lies where a lens without distortion has it, all over what the board covered
    pixels = np.concatenate([view.pixels for view in found.views])
    told, true = (_straight(each, pixels) for each in (found.lens, lens))
    assert np.quantile(np.linalg.norm(told - true, axis=-1), 0.99) < 1.5


def _straight(lens: Lens, pixels: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    undistort = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    return np.asarray(610.0 * undistort(pixels, lens.matrix, lens.coefficients))


def test_a_view_that_does_not_fit_is_left_out_and_one_like_another_counts_once() -> None:
    shots = pictures(CHESSBOARD, PINHOLE, 9, SEED)
    views, _ = find_views("drawn", CHESSBOARD, [shot for shot in shots for _ in range(3)], 60, lambda *_: None)
    assert len(views) <= 9
    bent = views[0]._replace(pixels=views[0].pixels + np.random.default_rng(SEED).normal(0, 4, views[0].pixels.shape))
    found = calibrate("drawn", [bent, *views[1:]], SIZE)
    assert (found.left_out, len(found.views)) == (1, len(views) - 1)
    assert found.rms_px < 0.3
    assert 0.3 < found.covered <= 1.0
    assert (found.picture() != 255).any()


def test_too_few_views_and_pictures_of_two_sizes_are_told() -> None:
    shots = pictures(CHESSBOARD, PINHOLE, 2, SEED)
    views, _ = find_views("drawn", CHESSBOARD, shots, 60, lambda *_: None)
    with pytest.raises(DataError, match="drawn: the board is seen in 2 different ways; expected at least 5"):
        calibrate("drawn", views, SIZE)
    with pytest.raises(DataError, match="drawn: has 320×240 pixels; expected 640×480"):
        find_views("drawn", CHESSBOARD, [shots[0], shots[1][::2, ::2]], 60, lambda *_: None)
    with pytest.raises(DataError, match="drawn: no pictures"):
        find_views("drawn", CHESSBOARD, [], 60, lambda *_: None)


def folding_views() -> list[View]:
    """The board in the picture's middle alone, by a lens that folds what is around it."""
    rng, found = np.random.default_rng(SEED), []
    number = np.arange(54)
    board = 0.025 * np.stack([number % 9, number // 9, 0.0 * number], axis=1)[:, None]
    matrix = np.array([[610.0, 0.0, 318.4], [0.0, 610.0, 241.2], [0.0, 0.0, 1.0]])
    for _ in range(6):
        turn, shift = rng.uniform(-0.3, 0.3, 3), rng.uniform([-0.13, -0.09, 0.8], [-0.07, -0.03, 0.9])
        pixels, _ = cv2.projectPoints(board, turn, shift, matrix, np.array([-3.0, 0.0, 0.0, 0.0]))
        found.append(View(number, board, pixels))
    return found


def test_what_would_not_be_read_again_is_refused() -> None:
    told = "drawn: these views tell no lens that there is; expected the board near the picture's corners, too (distort"
    with pytest.raises(DataError, match=re.escape(told)):
        calibrate("drawn", folding_views(), SIZE)


def test_the_command_writes_a_calibration_that_can_be_read_and_a_picture_of_the_coverage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shots").mkdir()
    for number, shot in enumerate(pictures(CHARUCO, PINHOLE, 12, SEED)):
        cv2.imwrite(f"shots/{number}.png", shot)
    asked = ["calibrate", "shots", "--board", "9x6", "--square", "25mm", "--marker", "1.8cm", "-o", "camera.yaml"]
    assert main(asked) == 0
    first, second, third = capsys.readouterr().out.splitlines()
    assert first.startswith("camera.yaml: 640×480, fx 6")
    assert re.fullmatch(r"rms 0\.[012]\d\d px in \d+ views(, \d left out)?", second)
    assert third.startswith("camera-coverage.png: corners in ")
    lens = read_calibration(Path("camera.yaml"))
    assert np.abs(lens.intrinsics[:2] / PINHOLE.intrinsics[:2] - 1.0).max() < 0.003
    assert read_image(Path("camera-coverage.png")).shape == (480, 640, 3)
    assert main(asked) == 1
    assert "camera.yaml: is there already; --overwrite replaces it" in capsys.readouterr().err
    assert main([*asked, "--overwrite"]) == 0
    folding = Path("camera.yaml").read_text().replace("data: [-0.2", "data: [-50.2")
    Path("camera.yaml").write_text(folding)
    assert "-50.2" in folding
    assert main([*asked, "--overwrite"]) == 0
    read_calibration(Path("camera.yaml"))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["none", "-o", "x.yaml", "--board", "9"], "--board 9: expected COLUMNSxROWS"),
        (["none", "-o", "x.yaml", "--board", "2x6"], "--board 2x6: expected COLUMNSxROWS, such as 9x6, at least 3"),
        (["none", "-o", "x.yaml", "--square", "25"], "--square 25: expected a length with its unit"),
        (["none", "-o", "x.yaml", "--square", "0mm"], "--square 0mm: expected a length"),
        (["none", "-o", "x.yaml", "--marker", "30mm"], "--marker 30mm: expected less than the square's side, 25mm"),
        (["none", "-o", "x.yaml", "--marker", "9mm", "--markers", "x"], "--markers x: expected one of 4x4_100"),
        (["none", "-o", "x.yaml", "--markers", "5x5_50"], "--markers 5x5_50: means something only with --marker"),
    ],
)
def test_options_that_tell_no_board_are_named(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", *arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: " + told)
    assert said.count("\n") == 1


def test_a_source_that_is_not_there_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "none", "-o", "x.yaml"]) == 1
    expected = "error: none: no such file; expected a device's number, a video, a folder of images"
    assert capsys.readouterr().err.startswith(expected)


def _session_that_must_not_begin(*_: object) -> None:
    raise AssertionError("the source is read")


@pytest.mark.parametrize(
    ("output", "options", "code", "told"),
    [
        ("", [], 2, "--output '.': expected the name of a file, such as camera.yaml"),
        (".", [], 2, "--output '.': expected the name of a file, such as camera.yaml"),
        ("/", [], 2, "--output '/': expected the name of a file, such as camera.yaml"),
        ("..", [], 2, "--output '..': expected the name of a file, such as camera.yaml"),
        ("cam.xml", [], 2, "--output cam.xml: expected a name such as camera.yaml, as calibrations are written"),
        ("nodir/cam.yaml", [], 1, "nodir/cam.yaml: cannot be written: nodir is no folder that you may write to"),
        ("mine.txt/cam.yaml", [], 1, "mine.txt/cam.yaml: cannot be written: mine.txt is no folder that you may write"),
        ("d", ["--overwrite"], 1, "d: is a folder; expected the name of a file, such as camera.yaml"),
        ("mine.txt", ["--overwrite"], 1, "mine.txt: expected a map, a calibration"),
        ("half.yaml", ["--overwrite"], 1, "half.yaml: image_height: expected a number of pixels, got None"),
    ],
)
def test_an_output_that_cannot_be_is_told_before_a_board_is_shown(
    output: str,
    options: list[str],
    code: int,
    told: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hierax.nodes.sources.boards.find_views", _session_that_must_not_begin)
    (tmp_path / "d").mkdir()
    (tmp_path / "mine.txt").write_text("a diary")
    (tmp_path / "half.yaml").write_text("image_width: 640")
    assert main(["calibrate", "none", "-o", output, *options]) == code
    said = capsys.readouterr().err
    assert said.startswith("error: " + told)
    assert said.count("\n") == 1
    assert (tmp_path / "mine.txt").read_text() == "a diary"


def test_nothing_is_left_of_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    with pytest.raises(DataError, match="d: cannot be written: Is a directory"):
        write_whole(tmp_path / "d", b"all of it")
    assert [path.name for path in tmp_path.iterdir()] == ["d"]
