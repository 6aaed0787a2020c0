"""Calibrations in the files that people have, and what is wrong with bad ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from support.boards import CHESSBOARD, FISHEYE, PINHOLE, SIZE, pictures

from hierax.nodes.sources.calibration import Lens, check_kind, read_calibration, write_calibration
from hierax.nodes.sources.files import DataError

COEFFICIENTS = PINHOLE.coefficients.tolist()
MATRIX = PINHOLE.matrix.ravel().tolist()
ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "narrow_stereo",
    "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": COEFFICIENTS},
}


def same(lens: Lens, other: Lens = PINHOLE) -> None:
    assert lens.size == other.size
    np.testing.assert_array_equal(lens.intrinsics, other.intrinsics)
    np.testing.assert_array_equal(lens.coefficients, other.coefficients)
    assert lens.fisheye == other.fisheye


@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE])
def test_what_is_written_is_read(lens: Lens, tmp_path: Path) -> None:
    write_calibration(lens, tmp_path / "camera.yaml")
    same(read_calibration(tmp_path / "camera.yaml"), lens)


def test_ros_writes_numbers_as_it_likes(tmp_path: Path) -> None:
    path = tmp_path / "head_camera.yaml"
    path.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: head\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [612, 0., 322.5, 0, 610.5, 2.38e2, 0, 0, 1]\ndistortion_model: plumb_bob\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.28, 0.11, 8e-4, -6e-04, -0.02]\n"
    )
    same(read_calibration(path))


@pytest.mark.parametrize("name", ["camera.yml", "camera.xml"])
def test_what_opencv_writes_is_read(name: str, tmp_path: Path) -> None:
    store = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    store.write("calibration_time", "Mon 04 Mar 2024 10:00:00 AM")
    store.write("camera_serial", "%7")
    store.write("image_width", 640)
    store.write("image_height", 480)
    store.write("camera_matrix", PINHOLE.matrix)
    store.write("distortion_coefficients", PINHOLE.coefficients[:, None])
    store.release()
    same(read_calibration(tmp_path / name))


def test_opencvs_fisheye_is_told_by_its_flag(tmp_path: Path) -> None:
    store = cv2.FileStorage(str(tmp_path / "camera.yaml"), cv2.FILE_STORAGE_WRITE)
    store.write("image_width", 640)
    store.write("image_height", 480)
    store.write("fisheye_model", 1)
    store.write("camera_matrix", FISHEYE.matrix)
    store.write("distortion_coefficients", FISHEYE.coefficients[:, None])
    store.release()
    same(read_calibration(tmp_path / "camera.yaml"), FISHEYE)


@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE])
def test_straightened_pictures_are_those_of_a_lens_without_distortion(lens: Lens) -> None:
    """A board whose lines are bent in the picture has straight ones after it."""
    seed = 8
    (shot,) = pictures(CHESSBOARD, lens, 1, seed)
    bent, straight = (_bend(picture) for picture in (shot, lens.straightened(shot)))
    assert bent > 0.3, f"seed {seed}"
    assert straight < 0.15, f"seed {seed}"


def _bend(picture: Any) -> float:
    """By how much corners are beside straight lines, in pixels, rms."""
    view = CHESSBOARD.detector()(picture)
    assert view is not None
    found, residual = cv2.findHomography(view.corners[:, 0, :2], view.pixels[:, 0])[0], []
    seen = cv2.perspectiveTransform(view.corners[:, :, :2], found)
    residual = np.linalg.norm(seen - view.pixels, axis=-1)
    return float(np.sqrt(np.mean(residual**2)))


def test_a_lens_without_distortion_leaves_pictures_as_they_are() -> None:
    image = np.random.default_rng(1).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    for coefficients in (np.zeros(0), np.zeros(5)):
        assert Lens("x", SIZE, PINHOLE.intrinsics, coefficients, False).straightened(image) is image


@pytest.mark.parametrize(
    ("focal", "coefficients", "fisheye"),
    [
        (610.0, [-0.4, 0.0, 0.0, 0.0], False),
        (517.3, [0.2624, -0.9531, -0.0054, 0.0026, 1.1633], False),  # a depth camera
        (300.0, [-0.3, 0.0, 0.0, 0.0], False),  # in the corners alone, where no board was seen
        (190.0, [-0.01, 0.05, -0.04, 0.007], True),
    ],
)
def test_lenses_that_there_are_do_not_fold_the_picture(focal: float, coefficients: list[float], fisheye: bool) -> None:
    assert not Lens("x", SIZE, np.array([focal, focal, 318.0, 241.0]), np.array(coefficients), fisheye).folds()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"image_width": None}, "image_width: expected a number of pixels, got None"),
        ({"image_width": 640.5}, "image_width: expected a number of pixels, got 640.5"),
        ({"image_width": [[1, 2], [3, 4]]}, "image_width: expected a number of pixels, got a list"),
        ({"image_width": {"a": 1}}, "image_width: expected a number of pixels, got a map"),
        ({"image_width": 2**400}, "image_width: expected a number of pixels, got 258224987"),
        ({"image_height": -1}, "image_height: expected a number of pixels, got -1"),
        ({"image_height": True}, "image_height: expected a number of pixels, got True"),
        ({"image_width": 1 << 24}, "image_width: expected at most 33554432 pixels in all"),
        ({"camera_matrix": None}, "camera_matrix: expected a matrix with rows, cols and data"),
        ({"camera_matrix": {"data": [1.0] * 8}}, "camera_matrix: expected 9 numbers"),
        ({"camera_matrix": {"data": [*MATRIX[:8], "x"]}}, "camera_matrix: expected 9 numbers"),
        ({"camera_matrix": {"data": [*MATRIX[:8], float("nan")]}}, "camera_matrix: expected 9 numbers"),
        ({"camera_matrix": {"data": [-612.0, *MATRIX[1:]]}}, "camera_matrix: expected positive focal lengths"),
        ({"camera_matrix": {"data": [1e9, *MATRIX[1:]]}}, "camera_matrix: expected focal lengths of 1 to 1e+06"),
        ({"camera_matrix": {"data": [*MATRIX[:8], 2.0]}}, "camera_matrix: expected [fx, 0, cx, 0, fy, cy, 0, 0, 1]"),
        ({"distortion_model": "wide"}, "distortion_model: expected one of plumb_bob, rational_polynomial, equidist"),
        (
            {"distortion_model": ["a"]},
            "distortion_model: expected one of plumb_bob, rational_polynomial, equidistant, fisheye, got a list",
        ),
        ({"distortion_coefficients": None}, "distortion_coefficients: expected a matrix with rows, cols and data"),
        (
            {"distortion_coefficients": None, "dist_coeff": [COEFFICIENTS]},
            "dist_coeff: expected distortion_model, or the coefficients as distortion_coefficients or dist_coeffs or",
        ),
        ({"Distortion_coefficients": COEFFICIENTS}, "Distortion_coefficients: expected distortion_model, or the coeff"),
        ({"distortion_modle": "plumb_bob"}, "distortion_modle: expected distortion_model, or the coefficients as"),
        ({"distortion_coefficients": "x"}, "distortion_coefficients: expected a matrix with rows, cols and data"),
        ({"distortion_coefficients": {"data": [0.1] * 3}}, "distortion_coefficients: expected 4 or 5 numbers of plumb"),
        ({"distortion_coefficients": {"data": [0.0] * 2}}, "distortion_coefficients: expected 4 or 5 numbers of plumb"),
        (
            {"distortion_coefficients": {"data": [-50.0, 0.0, 0.0, 0.0]}},
            "distortion_coefficients: [-50.0, 0.0, 0.0, 0.0] bend the picture so far that parts of it lie upon others",
        ),
        (
            {"distortion_coefficients": {"data": [-1e6, 0.0, 0.0, 0.0]}, "distortion_model": "equidistant"},
            "distortion_coefficients: [-1000000.0, 0.0, 0.0, 0.0] bend the picture so far",
        ),
        ({"distortion_coefficients": {"data": ["x"] * 5}}, "distortion_coefficients: expected 5 numbers"),
        ({"distortion_coefficients": {"data": [1e9] * 5}}, "distortion_coefficients: expected numbers of at most 1e"),
        (
            {"distortion_coefficients": {"data": [float("inf")] * 5}},
            "distortion_coefficients: expected numbers of",
        ),
    ],
)
def test_each_bad_field_is_named(change: dict[str, Any], told: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump({name: value for name, value in (ROS | change).items() if value is not None}))
    with pytest.raises(DataError, match=re.escape(f"{path}: {told}")):
        read_calibration(path)


def test_a_lens_without_distortion_says_so_by_an_empty_list_or_by_no_model(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(ROS | {"distortion_coefficients": []}))
    assert not read_calibration(path).coefficients.any()
    path.write_text(yaml.safe_dump({name: value for name, value in ROS.items() if not name.startswith("distortion")}))
    assert not read_calibration(path).coefficients.any()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.yaml", None, "no such file; expected a calibration"),
        ("a.yaml", "", "expected a map"),
        ("a.yaml", "- 1\n", "expected a map"),
        ("a.yaml", "a: [1\n", ", line 2: "),
        ("a.yaml", "a: !!python/object:os.system x\n", "could not determine a constructor"),
        ("a.yaml", "a: " + "[" * 5000, "; expected a calibration"),
        ("a.yaml", "\x00\x01", "; expected a calibration"),
        ("a.yaml", "a: 1\nb: !!timestamp foo\n", ", line 2: 'foo' cannot be read as timestamp; expected a calibration"),
        ("a.yaml", "a: !!bool foo\n", ", line 1: 'foo' cannot be read as bool; expected a calibration"),
        ("a.yaml", "a: !!int ''\n", ", line 1: '' cannot be read as int; expected a calibration"),
        ("a.yaml", "a: 2020-13-45\n", ", line 1: '2020-13-45' cannot be read as timestamp; expected a calibration"),
        ("a.yaml", f"a: 1{':59' * 300}.5\n", "cannot be read as float; expected a calibration"),
        ("a.yaml", f"image_width: 0x{'f' * 5000}\n", "image_width: expected a number of pixels, got a huge number"),
        ("a.xml", "<opencv_storage>", ", line 1: no XML"),
        (
            "a.xml",
            '<?xml version="1.0" encoding="gb2312"?><o/>',
            "a.xml: no XML (multi-byte encodings are not",
        ),
        (
            "a.xml",
            '<?xml version="1.0" encoding="foo"?><o/>',
            "a.xml: no XML (unknown encoding: foo); expected a",
        ),
        ("a.xml", "<o><image_width>!!bool</image_width></o>", "image_width: expected a number of pixels, got '!!bool'"),
        ("a.xml", "<o><K><data>1 !!int</data></K></o>", "a.xml: K: cannot be read; expected numbers with blanks"),
        ("a.xml", "<opencv_storage/>", "image_width: expected a number of pixels"),
        ("a.xml", "<o><K><data>1 [ 2</data></K></o>", "a.xml: K: cannot be read; expected numbers with blanks"),
    ],
)
def test_what_is_no_calibration_is_told(name: str, content: str | None, told: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(DataError, match=re.escape(str(path))) as raised:
        read_calibration(path)
    assert told in str(raised.value)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
@pytest.mark.parametrize("model", ["equidistant", "fisheye"])
def test_a_fisheye_lens_may_have_as_many_zeros_as_others(model: str, count: int, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    changes = {"distortion_model": model, "distortion_coefficients": {"data": [0.0] * count}}
    path.write_text(yaml.safe_dump(ROS | changes))
    lens = read_calibration(path)
    assert (lens.fisheye, lens.coefficients.tolist()) == (True, [0.0] * 4)
    assert lens.straightened(np.zeros((480, 640), np.uint8)).shape == (480, 640)


def test_a_calibration_of_a_lens_that_cannot_be_is_one_nevertheless(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(ROS | {"distortion_coefficients": {"data": [-50.0, 0.0, 0.0, 0.0]}}))
    check_kind(path)
    path.write_text(yaml.safe_dump({"image_width": 640, "image_height": 480, "title": "a picture"}))
    with pytest.raises(DataError, match="camera_matrix: expected a matrix with rows, cols and data"):
        check_kind(path)
