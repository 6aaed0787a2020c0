"""Generated scenes: their files, their truth, and how wrong what they tell is."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.estimation.profiles import lines_of, read_profiles, smoothed
from hierax.nodes.tracking.generator import scenes
from hierax.nodes.tracking.generator.camera import (
    DRIFT_DEG,
    DRIFT_M,
    JITTER_M,
    Swing,
    camera_path,
    reported_path,
)
from hierax.nodes.tracking.generator.kinds import CROWD, CROWDED, IMPRECISE, INTRINSICS, KINDS, SIZE, film
from hierax.nodes.tracking.generator.scenes import START_DEG, START_M, main, start_error, write_scene
from hierax.nodes.tracking.generator.stock import FOUND
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.math.geometry import Floats, invert, log_se3, pose_error, project, transform
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.model.symmetry import is_plain
from hierax.nodes.tracking.simworld.raster import visible_shares
from hierax.nodes.tracking.simworld.scene import develop, draw

STILL = [kind for kind in KINDS if kind not in ("pushed", IMPRECISE)]


def true_cameras(scene: Path) -> dict[int, Floats]:
    entries = json.loads((scene.parent.parent / "truth" / scene.name / "scene_camera.json").read_text())
    cameras = {}
    for key, entry in entries.items():
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(entry["cam_R_w2c"], (3, 3))
        pose[:3, 3] = np.array(entry["cam_t_w2c"]) / 1000.0
        cameras[int(key)] = invert(pose)
    return cameras


def test_an_exact_scene_tells_the_truth_of_its_first_frame_alone(tmp_path: Path) -> None:
    folder = write_scene(tmp_path, "scattered", 5, frames=3, exact=True)
    scene, truth, cameras = BopScene(folder), read_truth(tmp_path / "truth" / "000001"), true_cameras(folder)
    assert [frame.im_id for frame in scene.frames] == [0, 1, 2] == list(truth)
    assert list(json.loads((folder / "scene_gt.json").read_text())) == ["0"]
    for told, true in zip(scene.first_objects(), truth[0], strict=True):
        np.testing.assert_allclose(told.pose, true.pose, atol=1e-9)
    for frame in scene.frames:
        np.testing.assert_allclose(frame.camera, cameras[frame.im_id], atol=1e-9)
        image = read_image(frame.image)
        assert image.shape == (SIZE[1], SIZE[0], 3)
    assert 5 <= len(truth[0]) <= 6
    assert all(0.0 <= pose.visible <= 1.0 for poses in truth.values() for pose in poses)


def test_objects_show_where_the_truth_has_them(tmp_path: Path) -> None:
    folder = write_scene(tmp_path, "scattered", 2, frames=1, exact=True)
    scene = BopScene(folder)
    image = read_image(scene.frames[0].image).astype(float)
    shown = film("scattered", 2, 1)
    for item, thing in zip(scene.first_objects(), shown.things, strict=True):
        mesh: Mesh = scene.model(item.obj_id)[0]
        np.testing.assert_allclose(mesh.vertices, thing.shape.mesh.vertices, atol=1e-6)
        corners = transform(item.pose, mesh.vertices[mesh.faces])
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middles = corners.mean(axis=1)
        seen = np.sum(normals * middles, axis=1) < 0
        nearest = middles[seen][np.argmin(middles[seen][:, 2])]
        column, row = np.rint(project(nearest, INTRINSICS)).astype(int)
        patch = image[row - 1 : row + 2, column - 1 : column + 2].mean(axis=(0, 1))
        # Light changes how bright paint is, not its tint.
        paint = np.array(thing.colour, float)
        np.testing.assert_allclose(patch / patch.sum(), paint / paint.sum(), atol=0.04)


def test_what_is_told_is_wrong_within_limits(tmp_path: Path) -> None:
    folder = write_scene(tmp_path, "scattered", 1, frames=2)
    scene, truth, cameras = BopScene(folder), read_truth(tmp_path / "truth" / "000001"), true_cameras(folder)
    errors = [pose_error(a.pose, b.pose) for a, b in zip(scene.first_objects(), truth[0], strict=True)]
    assert 0.0005 < max(distance for distance, _ in errors) <= START_M
    assert np.radians(0.2) < max(angle for _, angle in errors) <= np.radians(START_DEG)
    assert pose_error(scene.frames[1].camera, cameras[1])[0] > 1e-5


def test_start_errors_fill_their_balls() -> None:
    rng = np.random.default_rng(3)
    twists = np.array([log_se3(start_error(rng)) for _ in range(400)])
    lengths = np.linalg.norm(twists[:, :3], axis=1), np.degrees(np.linalg.norm(twists[:, 3:], axis=1))
    for length, limit in zip(lengths, (START_M, START_DEG), strict=True):
        assert 0.97 * limit < length.max() <= limit * (1 + 1e-9)
        assert np.median(length) == pytest.approx(limit * np.cbrt(0.5), rel=0.06)


def test_a_reported_camera_drifts_smoothly_and_jitters() -> None:
    rng = np.random.default_rng(4)
    path = camera_path(Swing(10.0, 30.0, (0.6, 0.6), 20.0, 5.0, 0.0), np.zeros(3), 150, rng)
    errors = np.array([log_se3(invert(a) @ b) for a, b in zip(path, reported_path(path, rng), strict=True)])
    away = np.linalg.norm(errors[:, :3], axis=1)
    assert away[0] < 5 * JITTER_M
    assert DRIFT_M - 4 * JITTER_M < away.max() < DRIFT_M + 4 * JITTER_M
    assert np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).max() < DRIFT_DEG + 0.6
    # The difference of two frames is nearly all jitter: that of the drift is a small part of it.
    assert np.diff(errors[:, :3], axis=0).std() == pytest.approx(np.sqrt(2.0) * JITTER_M, rel=0.2)


def test_equal_arguments_give_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_scene(tmp_path / name, "tower", 7, frames=2)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert len(files) > 10
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file
    write_scene(tmp_path / "b", "tower", 8, frames=1)
    assert len(list((tmp_path / "b" / "test" / "000001" / "rgb").iterdir())) == 1


@pytest.mark.parametrize("kind", STILL)
def test_things_stand_on_the_table_or_on_one_another_and_in_the_picture(kind: str) -> None:
    shown = film(kind, 3, 10)
    assert len(shown.things) == CROWD if kind == CROWDED else 5 <= len(shown.things) <= 6
    for thing in shown.things:
        vertices = transform(thing.pose, thing.shape.mesh.vertices)
        bottom = vertices[:, 2].min()
        tops = [transform(other.pose, other.shape.mesh.vertices)[:, 2].max() for other in shown.things]
        assert min(abs(bottom - height) for height in (0.0, *tops)) < 1e-9
        for camera in (shown.camera[0], shown.camera[-1]):
            pixels = project(transform(invert(camera), vertices), INTRINSICS)
            assert (pixels > 0).all()
            assert (pixels < SIZE).all()
    if kind == "tower":
        assert any(thing.pose[2, 3] > 0.06 for thing in shown.things)


def test_the_pushed_scene_hides_one_thing_and_topples_another() -> None:
    shown = film("pushed", 1, 150)
    assert shown.still
    assert np.array_equal(shown.camera[0], shown.camera[-1])
    slider = np.array(
        [
            visible_shares(shown.bodies(frame), camera, INTRINSICS / 4, (SIZE[0] // 4, SIZE[1] // 4))[1]
            for frame, camera in enumerate(shown.camera)
        ]
    )
    gone = np.nonzero(slider < 0.1)[0]
    assert 19 <= len(gone) <= 25
    assert (np.diff(gone) == 1).all()
    assert slider[0] > 0.9
    turned = [pose_error(shown.poses[0, 2], pose)[1] for pose in shown.poses[:, 2]]
    assert max(turned) > np.radians(40.0)
    centres = project(transform(invert(shown.camera[0]), shown.poses[:, :, :3, 3]), INTRINSICS)
    fastest = np.linalg.norm(np.diff(centres, axis=0), axis=-1).max()
    assert 6.0 < fastest < 10.0
    (rod,) = shown.strangers
    assert shown.bodies(40)[-1].pose[0, 3] != rod.pose[0, 3]


def test_so_many_objects_and_frames_as_asked_for(tmp_path: Path) -> None:
    folder = write_scene(tmp_path, "scattered", 0, frames=1, objects=1)
    assert len(BopScene(folder).first_objects()) == 1
    assert len(read_truth(tmp_path / "truth" / "000001")[0]) == 1


def test_bad_arguments_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenes, "film", cache(film))
    with pytest.raises(ValueError, match="kind is 'heap'; expected one of scattered"):
        write_scene(tmp_path, "heap", 0)
    with pytest.raises(ValueError, match="frames is 0"):
        write_scene(tmp_path, "scattered", 0, frames=0)
    with pytest.raises(ValueError, match="objects is 0"):
        write_scene(tmp_path, "tower", 0, frames=1, objects=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="file"):
        write_scene(tmp_path / "file", "tower", 0, frames=1)
    assert main([str(tmp_path / "file"), "--kind", "tower", "--frames", "1"]) == 1
    assert "cannot be written" in capsys.readouterr().err
    assert main([str(tmp_path / "out"), "--kind", "tower", "--frames", "1"]) == 0
    assert capsys.readouterr().out.strip().endswith("000001")


def test_imprecise_models_are_near_what_is_drawn_but_not_it() -> None:
    shown = film(IMPRECISE, 4, 1)
    for thing in shown.things:
        (made,) = thing.shape.convex
        drawn = thing.shape.mesh.vertices
        assert len(made) > len(drawn)  # its edges are bevelled
        nearest = np.linalg.norm(made[:, None] - drawn[None], axis=-1).min(axis=1)
        assert 0.0 < nearest.max() < 0.012
        for side in thing.shape.sides:
            # nothing of it lies beyond any of its sides
            assert ((made - side.corner) @ side.normal).max() < 1e-6


def test_of_curved_things_the_scene_says_no_symmetry_and_their_meshes_show_it(tmp_path: Path) -> None:
    scene = BopScene(write_scene(tmp_path, "curved", 1, 1, exact=True))
    found = [scene.model(number)[1] for number in range(1, 6)]
    assert [(len(each["turns"]), len(each["free"])) for each in found] == [(1, 0), (1, 1), (1, 3), (2, 1), (2, 1)]
    boxes = BopScene(write_scene(tmp_path / "boxes", "approach", 1, 1, exact=True))
    for item in boxes.first_objects():
        assert is_plain(boxes.model(item.obj_id)[1]), "the pose to be kept is the one that was given"


def test_outlines_of_curved_things_are_where_they_are_drawn() -> None:
    """In light from everywhere: shading moves them."""
    shown = film("curved", 1, 1)
    lamp = replace(shown.lamp, ambient=1.0, diffuse=0.0)
    light = draw(shown.bodies(0), shown.camera[0], INTRINSICS, SIZE, lamp, shown.wood)
    image = smoothed(develop(light, 0.7, 0.0, np.random.default_rng(0)))
    for thing in shown.bodies(0):
        pose, mesh = invert(shown.camera[0]) @ thing.pose, thing.shape.mesh
        shape = shape_of(mesh.vertices, mesh.faces)
        controls = controls_of(shape, pose, INTRINSICS, SIZE, LayerRenderer(shape).layer(pose, INTRINSICS, SIZE))
        assert controls.limbs.any()
        lines = lines_of(controls, pose[None], INTRINSICS, image.shape)
        places = read_profiles(image, lines, controls.numbers[lines.rows], 4, 1.5).places[controls.limbs[lines.rows]]
        nearest = places[np.arange(len(places)), np.abs(places).argmin(axis=1)]
        near = nearest[np.abs(nearest) < 1.0]
        assert len(near) > 0.8 * len(nearest)
        assert abs(float(np.median(near))) < 0.05
        assert float(np.std(near)) < 0.2


def test_what_pybullet_has_is_put_on_the_table() -> None:
    shown = film("figures", 3, 1)
    for thing in shown.things:
        corners = thing.shape.mesh.vertices @ thing.pose[:3, :3].T + thing.pose[:3, 3]
        assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert max(np.ptp(thing.shape.mesh.vertices, axis=0)) in [pytest.approx(size) for size in FOUND.values()]


@pytest.mark.parametrize("name", ["test/000001/rgb/000007.png", "models/obj_000001.ply", "truth/000001/scene_gt.json"])
def test_the_command_replaces_a_dataset_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    mine = tmp_path / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    command = [str(tmp_path), "--kind", "scattered", "--seed", "2", "--frames", "1"]
    assert main(command) == 1
    assert "is there already; --overwrite replaces what a scene consists of there" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]
    assert mine.read_text() == "mine"
    assert main([*command, "--overwrite"]) == 0
    assert not mine.exists() or mine.read_text() != "mine"
