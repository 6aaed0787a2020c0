"""The castle: conversion and scoring, on tiny made-up files and, where it is installed, on the package."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene, ResultsFile
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, make_pose, project, transform

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "visp_castle.py"

SQUARE_CAO = "V1\n4\n0 0 0\n.1 0 0\n.1 .1 0\n0 .1 0\n0\n0\n1\n4 0 1 2 3\n0\n0\n"
SQUARE_VRML = (
    "Shape { geometry IndexedFaceSet { coord Coordinate { point [ 0 0 0, .1 0 0, .1 .1 0 ] } coordIndex [0,1,2,-1] } }"
)


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("visp_castle", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


visp_castle = load()
needs_package = pytest.mark.skipif(
    not visp_castle.PACKAGE_FOLDER.is_dir(), reason="Debian's package visp-images-data is not installed"
)


def pose_of(number: int) -> Floats:
    return make_pose(exp_so3(np.array([0.1 * number, 0.2, 0.0])), np.array([0.01 * number, 0.0, 0.5]))


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "Castle-simu"
    for name in ("Models", "CameraPose", "Images"):
        (folder / name).mkdir(parents=True)
    (folder / "Models" / "chateau.wrl").write_text(SQUARE_VRML)
    (folder / "Models" / "chateau.cao").write_text(SQUARE_CAO)
    (folder / "Models" / "cube.cao").write_text(SQUARE_CAO)
    for number in (1, 2, 3):
        np.savetxt(folder / "CameraPose" / f"Camera_{number:03d}.txt", pose_of(number))
        cv2.imwrite(str(folder / "Images" / f"Image_{number:04d}.pgm"), np.full((6, 8), number, dtype=np.uint8))
    return folder


def test_the_scene_tells_one_frame_and_the_truth_is_apart(package: Path, tmp_path: Path) -> None:
    assert visp_castle.convert(package, tmp_path) == 3
    scene, truth = BopScene(tmp_path / "test" / "000001"), read_truth(tmp_path / "truth" / "000001")
    assert [frame.im_id for frame in scene.frames] == [1, 2, 3] == list(truth)
    assert list(json.loads((scene.folder / "scene_gt.json").read_text())) == ["1"]
    castle, cube = scene.first_objects()
    np.testing.assert_allclose(castle.pose, pose_of(1), atol=1e-9)
    np.testing.assert_allclose(cube.pose, pose_of(1) @ visp_castle.CASTLE_FROM_CUBE, atol=1e-9)
    for frame in scene.frames:
        np.testing.assert_allclose(frame.camera, invert(pose_of(frame.im_id)), atol=1e-9)
        np.testing.assert_allclose(truth[frame.im_id][0].pose, pose_of(frame.im_id), atol=1e-9)
        assert read_image(frame.image)[0, 0] == frame.im_id
    assert len(scene.model(1)[0].faces) == 1
    visp_castle.convert(package, tmp_path, known=False, model="cao")
    scene = BopScene(tmp_path / "test" / "000001")
    assert np.array_equal(scene.frames[2].camera, np.eye(4))
    assert len(scene.model(1)[0].faces) == 2


def test_a_wrong_start_is_wrong_and_the_truth_is_not(package: Path, tmp_path: Path) -> None:
    visp_castle.convert(package, tmp_path, wrong=3)
    scene, truth = BopScene(tmp_path / "test" / "000001"), read_truth(tmp_path / "truth" / "000001")
    off = scene.first_objects()[0].pose[:3, 3] - truth[1][0].pose[:3, 3]
    assert 1e-4 < np.linalg.norm(off) < 0.03
    assert not np.allclose(scene.frames[0].camera, invert(pose_of(1)), atol=1e-6)


def test_scores_are_printed(package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    visp_castle.convert(package, tmp_path)
    with ResultsFile(tmp_path / "poses.csv", 1) as results:
        for number in (1, 2, 3):
            cube = pose_of(number) @ visp_castle.CASTLE_FROM_CUBE
            results.write(
                number,
                [
                    {"obj_id": 1, "pose": pose_of(number), "score": 1.0, "status": "tracked"},
                    {"obj_id": 2, "pose": cube, "score": 1.0, "status": "lost" if number == 2 else "tracked"},
                ],
            )
    visp_castle.print_score(tmp_path / "poses.csv", tmp_path / "truth" / "000001")
    printed = capsys.readouterr().out
    assert [line.split()[:2] for line in printed.splitlines()[2:]] == [
        ["both", "83.3"],
        ["castle", "100.0"],
        ["cube", "66.7"],
    ]


def test_bad_files_are_named(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(DataError, match=r"chateau\.wrl: cannot be read"):
        visp_castle.convert(tmp_path, tmp_path / "out")
    (package / "CameraPose" / "Camera_002.txt").write_text("1 2 3")
    with pytest.raises(DataError, match=r"Camera_002\.txt: expected a 4 × 4 matrix"):
        visp_castle.convert(package, tmp_path / "out")
    np.savetxt(package / "CameraPose" / "Camera_002.txt", 2.0 * np.eye(4))
    with pytest.raises(DataError, match=r"Camera_002\.txt: expected a rigid pose"):
        visp_castle.convert(package, tmp_path / "out")
    (package / "CameraPose" / "Camera_002.txt").unlink()
    (package / "Images" / "Image_0003.pgm").unlink()
    monkeypatch.setattr(sys, "argv", ["visp_castle.py", str(tmp_path / "out"), "--images", str(package)])
    assert visp_castle.main() == 1
    assert "Image_0003.pgm: missing or damaged" in capsys.readouterr().err


@needs_package
def test_the_package_shows_the_castle_where_its_poses_say(tmp_path: Path) -> None:
    assert visp_castle.convert(visp_castle.PACKAGE_FOLDER, tmp_path) == 40
    scene, truth = BopScene(tmp_path / "test" / "000001"), read_truth(tmp_path / "truth" / "000001")
    image = read_image(scene.frames[0].image)
    background = image[5, 5]
    for pose in truth[1]:
        mesh, _ = scene.model(pose.obj_id)
        middles = mesh.vertices[mesh.faces].mean(axis=1)
        columns, rows = np.rint(project(transform(pose.pose, middles), scene.frames[0].intrinsics)).astype(int).T
        assert (image[rows, columns] != background).mean() > 0.95
