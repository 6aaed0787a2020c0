"""Scenes with junk in them: one line with the file, the field and what was expected."""

from __future__ import annotations

import json
import os
import random
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.junk import mutated

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.datasets.bop_world import BopWorld, frame_seen
from hierax.nodes.tracking.model import files
from hierax.nodes.tracking.model.files import MAX_FACES, read_mesh, write_ply
from hierax.nodes.tracking.model.mesh import box_mesh

SEED = 5
TIMES = 600
MATRIX = [500.0, 0.0, 32.0, 0.0, 510.0, 24.0, 0.0, 0.0, 1.0]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Three frames of 64 × 48, two objects."""
    folder = tmp_path / "data" / "test" / "000001"
    (folder / "rgb").mkdir(parents=True)
    cameras = {}
    for number in range(3):
        picture = np.random.default_rng(number).integers(0, 255, (48, 64, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / "rgb" / f"{number:06d}.{'jpg' if number == 1 else 'png'}"), picture)
        pose = {"cam_R_w2c": np.eye(3).ravel().tolist(), "cam_t_w2c": [100.0, 200.0, 300.0]}
        cameras[str(number)] = {"cam_K": MATRIX, "depth_scale": 1.0, **pose}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    placed = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [1.0, -20.0, 500.0]}
    (folder / "scene_gt.json").write_text(json.dumps({"0": [{"obj_id": 5, **placed}, {"obj_id": 6, **placed}]}))
    models = tmp_path / "data" / "models"
    models.mkdir()
    known = {"diameter": 100.0, "symmetries_discrete": []}  # said, as it takes a while to find them
    (models / "models_info.json").write_text(json.dumps({"5": known, "6": known}))
    for number in (5, 6):
        write_ply(models / f"obj_{number:06d}.ply", box_mesh((0.1, 0.1, 0.1)))
    return folder


def read_all(folder: Path) -> None:
    """Everything that a deployment reads."""
    whole = BopScene(folder)
    for item in whole.first_objects():
        whole.model(item.obj_id)
    world = BopWorld(str(folder))
    for index in range(len(whole.frames)):
        frame_seen({**world.initial_belief(), "index": index})


def spoil(random_: random.Random, path: Path) -> None:
    """Change something in a file."""
    if path.suffix == ".json" and random_.random() < 0.9:
        path.write_text(json.dumps(mutated(random_, json.loads(path.read_text())), default=repr))
        return
    data = bytearray(path.read_bytes())
    kind = random_.randrange(4)
    at = random_.randrange(len(data))
    if kind == 0:
        del data[at:]
    elif kind == 1:
        data[at] = random_.randrange(256)
    elif kind == 2:
        data[at:at] = random_.choice((b"nan ", b"-1 ", b"1e300 ", b"99999999999 ", b"\n", b"\xff\xff"))
    else:
        words = bytes(data).split(b" ")
        words[random_.randrange(len(words))] = random_.choice((b"nan", b"inf", b"-7", b"1e300", b"9" * 20, b"x", b""))
        data = bytearray(b" ".join(words))
    path.write_bytes(bytes(data))


def refusal(folder: Path, what: str) -> str:
    """Why a scene is refused; empty: it is not."""
    try:
        read_all(folder)
    except DataError as error:
        return str(error)
    except Exception as error:
        raise AssertionError(what) from error
    return ""


@pytest.mark.filterwarnings("error")
def test_no_junk_in_a_scene_is_answered_by_a_traceback(scene: Path, tmp_path: Path) -> None:
    top = scene.parent.parent
    files = sorted(path.relative_to(top) for path in top.rglob("*") if path.is_file())
    refused = 0
    for number in range(TIMES):
        random_ = random.Random(f"{SEED} {number}")
        copy = tmp_path / f"copy{number}"  # what is read is remembered by its path
        shutil.copytree(top, copy)
        which = random_.choice(files)
        spoil(random_, copy / which)
        said = refusal(copy / "test" / "000001", f"seed {SEED}, {number}, {which}")
        assert said == "" or (str(copy) in said and len(said) < 500), f"seed {SEED}, {number}, {which}: {said}"
        refused += bool(said)
        shutil.rmtree(copy)
    assert refused > TIMES / 3


def edited(path: Path, *keys: Any, value: Any) -> None:
    content = json.loads(path.read_text())
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("file", "keys", "value", "told"),
    [
        ("scene_camera.json", ("1", "cam_K", 0), 1e300, "frame 1: cam_K: expected focal lengths of 1 to 1e+06 pixels"),
        (
            "scene_camera.json",
            ("1", "cam_K", 0),
            10**400,
            "frame 1: cam_K: expected focal lengths of 1 to 1e+06 pixels",
        ),
        ("scene_camera.json", ("1", "cam_K", 4), 1e-300, "frame 1: cam_K: expected focal lengths"),
        ("scene_camera.json", ("1", "cam_K", 2), -1e300, "frame 1: cam_K: expected focal lengths"),
        ("scene_camera.json", ("1", "cam_K", 8), 0.0, "frame 1: cam_K: expected [fx, 0, cx"),
        ("scene_camera.json", ("1", "cam_t_w2c", 0), 1e300, "frame 1: cam_t_w2c: expected millimetres"),
        ("scene_camera.json", ("1", "cam_R_w2c", 0), 1e300, "frame 1: cam_R_w2c: expected a rotation matrix"),
        ("scene_camera.json", ("9" * 5000,), {}, "is no frame number"),
        ("scene_camera.json", ("01",), {}, "a frame is there twice"),
        ("scene_gt.json", ("0", 0, "obj_id"), True, "object 0: obj_id: expected the number of a model"),
        ("scene_gt.json", ("0", 0, "obj_id"), 10**9, "object 0: obj_id: expected the number of a model"),
        ("scene_gt.json", ("0",), [0] * 300, "300 objects; expected at most 255"),
    ],
)
def test_the_field_is_named(scene: Path, file: str, keys: tuple[Any, ...], value: Any, told: str) -> None:
    edited(scene / file, *keys, value=value)
    with pytest.raises(DataError) as refused:
        read_all(scene)
    assert str(scene / file) in str(refused.value)
    assert told in str(refused.value)


def test_a_frame_of_another_size_is_refused(scene: Path) -> None:
    path = scene / "rgb" / "000002.png"
    cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(DataError, match=f"{path}: has 32×24 pixels; expected 64×48, as the first frame has"):
        read_all(scene)


@pytest.mark.parametrize("name", ["rgb/000000.png", "scene_camera.json", "../../models/obj_000005.ply"])
def test_a_fifo_is_not_waited_for(scene: Path, name: str) -> None:
    (scene / name).unlink()
    os.mkfifo(scene / name)
    with pytest.raises(DataError, match="is no file; expected"):
        read_all(scene)


def test_an_image_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(10_000))) + chunk(b"IEND", b""))
    with pytest.raises(DataError, match="has 30000×30000 pixels; expected at most 33554432 in all"):
        read_image(path)


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tif", "ppm"])
def test_sizes_are_read_from_the_heads_of_images(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), np.zeros((30, 40, 3), np.uint8))
    assert read_image(path).shape == (30, 40, 3)
    monkeypatch.setattr("hierax.nodes.sources.images.MAX_PIXELS", 1000)
    with pytest.raises(DataError, match="has 40×30 pixels; expected at most 1000"):
        read_image(path)


HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty {} x\nproperty {} y\nproperty {} z\nelement face {}\n"
LIST = "property list {} {} vertex_indices\nend_header\n"


def ascii_ply(vertices: str, faces: str, count: int = 3) -> bytes:
    head = HEAD.format("ascii", count, *["float"] * 3, faces.count("\n")) + LIST.format("uchar", "int")
    return (head + vertices + faces).encode()


MALFORMED = "element 'face': row 0: property 'vertex_indices': malformed input"
CORNERS = "0 0 0\n1 0 0\n0 1 0\n"


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (ascii_ply(CORNERS, "3 0 1 nan\n"), MALFORMED),
        (ascii_ply(CORNERS, "nan 0 1 2\n"), MALFORMED),
        (ascii_ply(CORNERS, "-1 0 1 2\n"), "-1 out of bounds for uint8; expected a PLY model"),
        (ascii_ply(CORNERS, "3 0 1 4294967296\n"), MALFORMED),
        (ascii_ply(CORNERS, "3 0 1 0.5\n"), MALFORMED),
        (ascii_ply(CORNERS, "3 0 1 7\n"), "triangle 0 names vertices"),
        (ascii_ply("0 0 0\n1 0 0\n2 0 0\n", "3 0 1 2\n"), "no face has an area"),
        (ascii_ply(CORNERS, "3 0 0 1\n3 1 1 1\n"), "no face has an area"),
        (ascii_ply("0 0 0\n1e300 0 0\n0 1 0\n", "3 0 1 2\n"), "vertex 1 is not finite"),
        (ascii_ply("0 0 0\nnan 0 0\n0 1 0\n", "3 0 1 2\n"), "vertex 1 is not finite"),
        (ascii_ply(CORNERS, "3 0 1 2\n", count=10**15), f"expected at most {MAX_FACES} of an element"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 5\nelement face 1\nend_header\n",
            "'vertex' has no property 'x'",
        ),
        (
            (HEAD.format("binary_little_endian", 3, *["float"] * 3, 1) + LIST.format("uchar", "float")).encode()
            + struct.pack("<9fB3f", *[0, 0, 0, 1, 0, 0, 0, 1, 0], 3, 0, 1, float("nan")),
            "element 'face': vertex_indices: expected lists of whole numbers",
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_is_wrong_with_a_model_is_told(tmp_path: Path, data: bytes, told: str) -> None:
    path = tmp_path / "obj_000001.ply"
    path.write_bytes(data)
    with pytest.raises(DataError) as refused:
        read_mesh(path)
    assert str(refused.value).startswith(f"{path}")
    assert told in str(refused.value)


def test_faces_without_an_area_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "obj_000001.ply"
    path.write_bytes(ascii_ply(CORNERS, "3 0 1 2\n3 0 1 1\n"))
    assert read_mesh(path).faces.tolist() == [[0, 1, 2]]


def test_too_many_faces_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As announced, and as polygons are cut."""
    monkeypatch.setattr(files, "MAX_FACES", 10)
    write: Callable[[str], None] = lambda faces: path.write_bytes(ascii_ply(CORNERS, faces))  # noqa: E731
    path = tmp_path / "obj_000001.ply"
    write("3 0 1 2\n" * 11)
    with pytest.raises(DataError, match="expected at most 10 of an element"):
        read_mesh(path)
    write(f"13 {' '.join(['0', '1', '2'] * 4)} 0\n")
    with pytest.raises(DataError, match="11 triangles; expected at most 10"):
        read_mesh(path)
