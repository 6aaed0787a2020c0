"""The file of a camera's objects: what it says, and each of its fields where it is bad."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.objects import read_objects
from hierax.nodes.tracking.math.geometry import exp_se3
from hierax.nodes.tracking.model.files import write_ply
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.world import arm, spatial

POSE = exp_se3(np.array([0.1, 0.2, 0.5, 0.3, -0.2, 0.1]))
CAMERA = exp_se3(np.array([0.0, 0.1, 0.6, 2.0, 0.1, 0.0]))
OBJECT = {"id": 1, "model": "box.ply", "unit": "cm", "pose": POSE.tolist(), "frame": "camera"}


def at(*translation: float) -> list[list[float]]:
    pose = np.eye(4)
    pose[:3, 3] = translation
    return pose.tolist()  # type: ignore[no-any-return]


def written(folder: Path, content: Any) -> Path:
    write_ply(folder / "box.ply", box_mesh([0.03, 0.04, 0.05]), unit_m=0.01)
    path = folder / "objects.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_it_tells_models_first_poses_and_the_camera(tmp_path: Path) -> None:
    looked_for = {"id": 7, "model": "box.ply", "unit": "mm", "pose": None}
    told = read_objects(written(tmp_path, {"objects": [OBJECT, looked_for], "camera": CAMERA.tolist()}))
    assert [item["id"] for item in told.objects] == [1, 7]
    np.testing.assert_array_equal(told.objects[0]["pose"], POSE)
    assert told.objects[1]["pose"] is None
    np.testing.assert_array_equal(told.camera, CAMERA)
    np.testing.assert_array_equal(told.world_from_frame, CAMERA)
    (mesh, symmetry), (small, _) = told.read_models()
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.03, 0.04, 0.05])
    np.testing.assert_allclose(np.ptp(small.vertices, axis=0), [0.003, 0.004, 0.005])
    assert len(symmetry["turns"]) == 4  # as the mesh shows
    exact = read_objects(written(tmp_path, {"objects": [OBJECT | {"symmetries_discrete": []}]}))
    assert len(exact.read_models()[0][1]["turns"]) == 1
    sought = read_objects(written(tmp_path, {"objects": [looked_for | {"symmetries_discrete": []}]}))
    assert len(sought.read_models()[0][1]["turns"]) == 4


def test_nodes_begin_with_it(tmp_path: Path) -> None:
    path = str(written(tmp_path, {"objects": [OBJECT], "camera": CAMERA.tolist()}))
    np.testing.assert_array_equal(arm(objects=path).initial_belief()["objects"][0]["pose"], POSE)
    (body,) = spatial(objects=path).initial_belief()["bodies"]
    np.testing.assert_array_equal(body["pose"], CAMERA @ POSE)
    on_table = {**OBJECT, "frame": "world", "pose": (CAMERA @ POSE).tolist()}
    in_world = str(written(tmp_path, {"objects": [on_table], "camera": CAMERA.tolist()}))
    belief = arm(objects=in_world).initial_belief()
    np.testing.assert_array_equal(belief["camera"], np.eye(4))
    np.testing.assert_array_equal(belief["objects"][0]["pose"], CAMERA @ POSE)
    np.testing.assert_allclose(spatial(objects=in_world).initial_belief()["bodies"][0]["pose"], CAMERA @ POSE)
    searched = spatial(objects=path, start="search", table=True).initial_belief()
    assert searched["sweeping"] == ()


TURNED = (2.0 * POSE).tolist()


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ([], ": expected a map"),
        ({}, ": objects: expected a list of 1 to 255 objects"),
        ({"objects": []}, ": objects: expected a list of 1 to 255 objects"),
        ({"objects": [3]}, ": objects[0]: expected a map with id, model, unit, pose, frame"),
        ({"objects": [OBJECT], "cameras": 1}, ": 'cameras': expected one of camera, objects"),
        ({"objects": [OBJECT], "camera": 3}, ": camera: expected 16 numbers"),
        ({"objects": [OBJECT], "camera": TURNED}, ": camera: expected 4 rows of 4 numbers: a rotation"),
        ({"objects": [OBJECT, OBJECT]}, ": objects[1]: id: 1 is there twice"),
        *(
            ({"objects": [{**OBJECT, name: value}]}, f": objects[0]: {name}: expected {expected}")
            for name, value, expected in (
                ("id", 0, "a whole number from 1 to 255, got 0"),
                ("id", True, "a whole number from 1 to 255, got True"),
                ("id", "a", "a whole number from 1 to 255, got 'a'"),
                ("model", 5, "a file beside objects.yaml, got 5"),
                ("model", "", "a file beside objects.yaml"),
                ("unit", "ft", "one of mm, cm, m, in, got 'ft'"),
                ("unit", ["m"], "one of mm, cm, m, in, got ['m']"),
                ("pose", "here", "16 numbers"),
                ("pose", POSE[:3].tolist(), "16 numbers"),
                ("pose", TURNED, "4 rows of 4 numbers: a rotation"),
                ("pose", np.diag([1.0, 1.0, -1.0, 1.0]).tolist(), "4 rows of 4 numbers: a rotation"),
                ("pose", (POSE * [[1, 1, 1, 1e9]] * 1.0).tolist(), "4 rows of 4 numbers"),
                ("frame", "table", "camera or world, got 'table'"),
            )
        ),
        ({"objects": [{**OBJECT, "mesh": 1}]}, ": objects[0]: 'mesh': expected one of id, model, unit"),
        ({"objects": [{k: v for k, v in OBJECT.items() if k != "pose"}]}, ": objects[0]: pose: expected 4 rows"),
    ],
)
def test_each_bad_field_is_named(content: Any, told: str, tmp_path: Path) -> None:
    path = written(tmp_path, content)
    with pytest.raises(DataError, match=re.escape(f"{path}{told}")):
        read_objects(path)


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"model": "none.ply"}, "none.ply: no such file; expected a PLY model"),
        ({"model": "box.txt"}, "box.txt: expected a model that ends in .ply"),
        (
            {"pose": at(100.0, 200.0, 500.0)},
            "objects[0]: pose: the object is 548 m away and 0.0707 m large, which no cam",
        ),
        (
            {"pose": at(0.0, 0.0, -0.5)},
            "objects.yaml: objects[0]: pose: the object is behind the camera; expected it be",
        ),
        (
            {"unit": "mm", "model": "tiny.ply"},
            "objects.yaml: objects[0]: unit: the model is 0.0707 mm large by it; expected at least 1 mm",
        ),
        ({"unit": "m", "model": "huge.ply"}, "huge.ply: a vertex is 2.5e+03 m from the origin; expected at most 100 m"),
        ({"symmetries_discrete": [[1.0]]}, "objects.yaml: objects[0]: symmetries_discrete: expected 16 numbers"),
    ],
)
def test_a_bad_model_is_told(entry: dict[str, Any], told: str, tmp_path: Path) -> None:
    path = written(tmp_path, {"objects": [OBJECT | entry]})
    for name, unit_m in (("tiny", 1.0), ("huge", 1e-5)):
        write_ply(tmp_path / f"{name}.ply", box_mesh([0.03, 0.04, 0.05]), unit_m=unit_m)
    with pytest.raises(DataError, match=re.escape(told)):
        spatial(objects=str(path))


def test_a_pose_in_millimetres_is_told_in_the_frame_of_a_tag_too(tmp_path: Path) -> None:
    for z, told in ((-0.5, ""), (500.0, "pose: the object is 500 m away and 0.0707 m large, which no camera sees")):
        path = written(tmp_path, {"objects": [OBJECT | {"frame": "world", "pose": at(0.0, 0.0, z)}]})
        with pytest.raises(DataError, match=re.escape(told)) if told else nullcontext():
            spatial(objects=str(path), tag_mm=80.0)


def test_what_is_all_about_the_camera_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = written(tmp_path, {"objects": [OBJECT | {"unit": "m"}]})
    assert len(spatial(objects=str(path)).initial_belief()["bodies"]) == 1
    (line,) = caplog.messages
    assert "objects[0]: the object is 7.07 m large and 0.5" in line
    assert "is its unit right?" in line
