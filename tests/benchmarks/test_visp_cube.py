"""The real cube: conversion, scoring, and a whole run of tracking over the formal core."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking import world as tracking
from hierax.nodes.tracking.arm import poses_seen
from hierax.nodes.tracking.datasets.bop import BopScene, ResultsFile
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, make_pose, project, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "visp_cube.py"


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("visp_cube", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


visp_cube = load()
needs_photographs = pytest.mark.skipif(
    not visp_cube.PACKAGE_FOLDER.is_dir(), reason="Debian's package visp-images-data is not installed"
)


def sliding(count: int, rng: np.random.Generator) -> Floats:
    """Poses of a cube that slides and turns on a tilted plane, before a camera."""
    table = make_pose(exp_so3(np.array([2.0, 0.1, -0.2])), [0.0, 0.1, 0.6])
    places = rng.uniform(-0.2, 0.2, (count, 2))
    turns = rng.uniform(-3.0, 3.0, count)
    bottom = visp_cube.BOTTOM_CENTRE_M
    poses = []
    for (x, y), turn in zip(places, turns, strict=True):
        standing = make_pose(exp_so3(np.array([0.0, 0.0, turn])), [x, y, 0.0])
        poses.append(table @ standing @ make_pose(np.eye(3), -np.array(bottom)))
    return np.array(poses)


def test_a_convex_body_is_turned_outward() -> None:
    mesh = box_mesh((1.0, 2.0, 3.0))
    mixed = mesh.faces.copy()
    mixed[::2] = mixed[::2, ::-1]
    corners = mesh.vertices[visp_cube.outward(mesh.vertices, mixed)]
    volume = np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(6.0)


def test_poses_beside_those_of_the_full_run_put_onto_its_plane() -> None:
    rng = np.random.default_rng(2)
    truth = sliding(60, rng)
    rough = truth.copy()
    for pose in rough:
        pose[:3, 3] *= rng.uniform(0.997, 1.003)  # along the rays through where the object's frame is
    straight = visp_cube.straightened(rough)
    off = [np.linalg.norm(each[:3, 3] - true[:3, 3]) for each, true in zip(straight, truth, strict=True)]
    assert max(off) < 0.0012
    assert visp_cube.planarity(straight) == pytest.approx((0.0, 0.0), abs=1e-3)
    wrong = {0: truth[0], 3: truth[3] @ make_pose(np.eye(3), [0.0, 0.0, 0.004])}
    against = dict(enumerate(truth))
    assert visp_cube.share_right(wrong, against, 5.0, 5.0) == 100.0
    assert visp_cube.share_right(wrong, against, 2.0, 2.0) == 50.0


def test_planarity_of_sliding_is_nil_and_of_lifting_is_measured() -> None:
    poses = sliding(40, np.random.default_rng(1))
    assert visp_cube.planarity(poses) == pytest.approx((0.0, 0.0), abs=1e-4)
    up = poses[0, :3, 2]
    lifted = poses.copy()
    lifted[::2, :3, 3] += 0.002 * up
    lifted[1::2, :3, 3] -= 0.002 * up
    residual, tilt = visp_cube.planarity(lifted)
    assert residual == pytest.approx(2.0, rel=0.05)
    assert tilt == pytest.approx(0.0, abs=1e-4)
    leaning = np.array([pose @ make_pose(exp_so3(np.array([0.01, 0.0, 0.0])), np.zeros(3)) for pose in poses])
    assert visp_cube.planarity(leaning)[1] == pytest.approx(np.degrees(0.01), rel=0.2)


@needs_photographs
def test_the_scene_is_a_bop_scene_with_the_first_pose_only(tmp_path: Path) -> None:
    assert visp_cube.convert(visp_cube.PACKAGE_FOLDER, tmp_path, 50) == 5
    scene = BopScene(tmp_path / "test" / "000001")
    assert [frame.im_id for frame in scene.frames] == [0, 50, 100, 150, 200]
    assert list(json.loads((scene.folder / "scene_gt.json").read_text())) == ["0"]
    mesh = scene.model(1)[0]
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.084] * 3)
    corners = mesh.vertices[mesh.faces]
    assert np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6 == pytest.approx(0.084**3)
    # The first pose puts the cube's nearest corner where the photograph has it, to the pixel.
    pixels = project(transform(scene.first_objects()[0].pose, mesh.vertices), scene.frames[0].intrinsics)
    assert pixels[4] == pytest.approx([366.4, 292.7], abs=1.0)
    image = read_image(scene.frames[0].image)
    assert image.shape == (480, 640)


def test_what_moves_beside_the_cube_is_told() -> None:
    cubes = sliding(5, np.random.default_rng(4))
    still = cubes @ make_pose(exp_so3(np.array([0.0, 0.0, 0.3])), np.array([-0.17, -0.03, 0.0]))
    moved = still.copy()
    moved[2] = moved[2] @ make_pose(exp_so3(np.array([0.0, 0.01, 0.0])), np.array([0.003, 0.0, 0.0]))
    feet, turns = visp_cube.stillness(cubes, moved)
    assert feet == pytest.approx([0.0, 0.0, 3.0, 0.0, 0.0], abs=1e-6)
    assert turns == pytest.approx([0.0, 0.0, np.degrees(0.01), 0.0, 0.0], abs=1e-5)


@needs_photographs
def test_the_scene_with_the_cylinder_tells_the_table(tmp_path: Path) -> None:
    visp_cube.convert(visp_cube.PACKAGE_FOLDER, tmp_path, 100, cylinder=True)
    scene = BopScene(tmp_path / "test" / "000001")
    cube, cylinder = (scene.frames[2].camera @ item.pose for item in scene.first_objects())
    assert cube == pytest.approx(np.eye(4), abs=1e-9)
    assert cylinder[:3, 3] == pytest.approx(visp_cube.FOOT_M)
    assert [len(scene.model(number)[1]["free"]) for number in (1, 2)] == [0, 1]


@needs_photographs
def test_the_cube_is_tracked_to_the_last_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    visp_cube.convert(visp_cube.PACKAGE_FOLDER, tmp_path, 1)
    folder = str(tmp_path / "test" / "000001")
    world = tracking.world(folder)
    hierarchy = Hierarchy(
        {"world": world, "arm": tracking.arm(folder), "spatial": tracking.spatial(folder)},
        "world",
        [
            Edge("world", "arm", sense=tracking.seen),
            Edge("arm", "spatial", sense=poses_seen, context=SegmentedDepth()),
        ],
    )
    active = ActiveHierarchy.initial(hierarchy)
    path = tmp_path / "poses.csv"
    with ResultsFile(path, 1) as results:
        while not world.finished(active.states["world"].belief):
            active = update(active)
            # The spatial node's bodies are where they are predicted; "before" is what the arm corrected.
            belief = active.states["arm"].belief
            objects = [{**item, "pose": item["before"]} for item in belief["objects"]]
            assert objects[0]["status"] != "lost", f"frame {belief['frame']}"
            results.write(belief["frame"], objects)
    visp_cube.score(path, 218)
    printed = capsys.readouterr().out
    assert "218 of 218 (100.0 %)" in printed
    residual, tilt = (float(line.split()[at]) for line, at in zip(printed.splitlines()[1:], (2, 5), strict=True))
    assert residual < 1.0
    assert tilt < 0.8


def test_bad_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match=r"cube\.cao: cannot be read"):
        visp_cube.convert(tmp_path, tmp_path / "out", 1)
    (tmp_path / "cube.cao").write_text("V1\n1\n0 0 0\n2\n")
    with pytest.raises(DataError, match="expected points, no lines"):
        visp_cube.convert(tmp_path, tmp_path / "out", 1)
    monkeypatch.setattr(sys, "argv", ["visp_cube.py", "--score", str(tmp_path / "none.csv")])
    assert visp_cube.main() == 1
