"""Bags of ROS 2 as sources: the pictures of a topic as a folder shows them, and what is wrong with a bag."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.bags import STRING, camera_info, compressed, image, made, write_bag
from support.boards import PINHOLE
from support.launched import said_here

from hierax.nodes.sources.calibration import write_calibration
from hierax.nodes.sources.camera import CameraWorld, is_bag, is_recording, knows_camera, picture_seen
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array

SEED = 4
COUNT, STEP_NS = 5, 40_000_000
LENS = replace(PINHOLE, size=(64, 48))
PLAIN = replace(LENS, coefficients=np.zeros(5))


def shot(number: int) -> Array:
    return np.random.default_rng((SEED, number)).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def stamps() -> list[int]:
    return [1_700_000_000_123_456_789 + STEP_NS * number for number in range(COUNT)]


def shown(source: Path, **options: Any) -> list[Any]:
    """All beliefs of a world, up to the last one with a frame."""
    world = CameraWorld(str(source), **options)
    beliefs = [world.initial_belief()]
    while not beliefs[-1]["ended"]:
        beliefs.append(world.predict((), (), beliefs[-1]))
    return beliefs[:-1]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("single", [False, True])
def test_every_picture_is_shown_in_order_at_its_stamp(storage: str, single: bool, tmp_path: Path) -> None:
    frames = [image(stamp, shot(number), "rgb8") for number, stamp in enumerate(stamps())]
    bag = write_bag(tmp_path / "bag", {"/eye": frames, "/said": [made(STRING, data="x")]}, storage)
    source = next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3")) if single else bag
    assert (is_bag(str(source)), is_recording(str(source)), knows_camera(str(source))) == (True, False, False)
    beliefs = shown(source)
    assert [belief["frame"] for belief in beliefs] == list(range(COUNT)), f"seed {SEED}"
    assert [belief["time_s"] for belief in beliefs] == [stamp / 10**9 for stamp in stamps()]
    for number, belief in enumerate(beliefs):
        np.testing.assert_array_equal(picture_seen(belief)[0]["image"], shot(number))
    world = CameraWorld(str(source))  # an epoch that is done again, in this process or another
    for at in (3, 0, 2):
        np.testing.assert_array_equal(world.predict((), (), beliefs[at])["image"], shot(at + 1))


def mosaic(pattern: str) -> tuple[Array, Array]:
    """A picture of one colour, and what a sensor with such a filter gives of it."""
    colour = {"r": 200, "g": 120, "b": 30}
    flat = np.tile(np.array([200, 120, 30], np.uint8), (8, 10, 1))
    tile = np.array([colour[each] for each in pattern], np.uint8).reshape(2, 2)
    return flat, np.tile(tile, (4, 5))


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_have_their_colours(pattern: str, tmp_path: Path) -> None:
    flat, raw = mosaic(pattern)
    (belief,) = shown(write_bag(tmp_path / "bag", {"/eye": [image(0, raw, f"bayer_{pattern}8")]}))
    np.testing.assert_array_equal(belief["image"], flat)


def test_encodings_are_the_same_picture(tmp_path: Path) -> None:
    rgb = shot(0)
    opaque = np.full((48, 64, 1), 255, np.uint8)
    given = {
        "rgb8": image(0, rgb, "rgb8", pad=5),
        "bgr8": image(0, rgb[..., ::-1], "bgr8"),
        "8UC3": image(0, rgb[..., ::-1], "8UC3", pad=1),
        "rgba8": image(0, np.concatenate([rgb, opaque], axis=2), "rgba8"),
        "bgra8": image(0, np.concatenate([rgb[..., ::-1], opaque], axis=2), "bgra8"),
        "png": compressed(0, rgb),
    }
    for name, message in given.items():
        (belief,) = shown(write_bag(tmp_path / name, {"/eye": [message]}))
        np.testing.assert_array_equal(belief["image"], rgb, err_msg=name)
        assert belief["image"].flags.c_contiguous, name
    (belief,) = shown(write_bag(tmp_path / "mono8", {"/eye": [image(0, rgb[..., 1], "mono8", pad=3)]}))
    np.testing.assert_array_equal(belief["image"], rgb[..., 1])
    (belief,) = shown(write_bag(tmp_path / "jpeg", {"/eye": [compressed(0, rgb, ".jpg")]}))
    _, content = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]))
    np.testing.assert_array_equal(belief["image"], cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1])


def test_camera_info_is_the_calibration_unless_one_is_given(tmp_path: Path) -> None:
    frames, info = [image(0, shot(0), "rgb8")], [camera_info(LENS)]
    topics = {"/left/image_raw": frames, "/left/camera_info": info, "/right/camera_info": [camera_info(PLAIN)]}
    bag = write_bag(tmp_path / "bag", topics)
    (belief,) = shown(bag)
    assert knows_camera(str(bag))
    np.testing.assert_array_equal(belief["image"], LENS.straightened(shot(0)))
    np.testing.assert_array_equal(belief["intrinsics"], LENS.intrinsics)
    (belief,) = shown(bag, straighten=False)  # as `hierax calibrate` sees them
    np.testing.assert_array_equal(belief["image"], shot(0))
    # of a topic that is straight already, and by the only one that there is
    (belief,) = shown(write_bag(tmp_path / "straight", {"/a/image_rect_color": frames, "/b/camera_info": info}))
    np.testing.assert_array_equal(belief["image"], shot(0))
    np.testing.assert_array_equal(belief["intrinsics"], LENS.intrinsics)
    packed = {"/left/image_raw/compressed": [compressed(0, shot(0))], "/left/camera_info": info}
    (belief,) = shown(write_bag(tmp_path / "packed", packed | {"/right/camera_info": [camera_info(PLAIN)]}))
    np.testing.assert_array_equal(belief["image"], LENS.straightened(shot(0)))
    unknown = camera_info(PLAIN)
    unknown.k[:] = 0.0
    assert not knows_camera(str(write_bag(tmp_path / "unknown", {"/eye": frames, "/camera_info": [unknown]})))


def test_of_several_topics_one_is_chosen(tmp_path: Path) -> None:
    left, right = (image(0, shot(number), "rgb8") for number in (1, 2))
    bag = write_bag(tmp_path / "bag", {"/left": [left], "/right": [right], "/said": [made(STRING, data="x")]})
    (belief,) = shown(bag, topic="/right")
    np.testing.assert_array_equal(belief["image"], shot(2))
    for topic, told in (
        (None, "bag: has pictures on /left, /right; expected one of them as topic (camera_topic of tracking)"),
        ("/up", "bag: has no topic /up; expected one with pictures: /left, /right"),
        ("/said", f"bag: /said is of {STRING}; expected sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage: /l"),
    ):
        with pytest.raises(DataError, match=re.escape(told)):
            CameraWorld(str(bag), topic=topic).initial_belief()
    with pytest.raises(DataError, match=r"is no bag of ROS 2; expected no topic \(camera_topic of tracking\) with it"):
        CameraWorld(str(tmp_path), topic="/left").initial_belief()


def bad(bag: Path) -> dict[str, tuple[Any, str]]:
    """Topics, or what is done to a bag, and what is said then."""
    frame = image(0, shot(0), "rgb8")
    gray = np.zeros((4, 4), np.uint8)
    info = camera_info(LENS)
    info.d = np.zeros(3) + 0.1
    return {
        "depth": ([image(0, np.zeros((4, 8), np.uint8), "16UC1", width=4)], "/eye: uint16 pixels; expected 8 bits"),
        "floats": ([image(0, gray, "32FC1", step=16)], "/eye, picture 1: encoding '32FC1'; expected one of mono8, 8UC"),
        "short": ([image(0, gray, "mono8", height=5)], "picture 1: has 16 bytes in rows of 4; expected 5 rows of at"),
        "narrow": ([image(0, gray, "rgb8")], "has 16 bytes in rows of 4; expected 4 rows of at least 12"),
        "none": ([image(0, gray, "mono8", width=0)], "has 0×4 pixels; expected at least one"),
        "huge": ([image(0, gray, "mono8", width=2**20, height=2**20)], "has 1048576×1048576 pixels"),
        "sizes": ([frame, image(0, gray, "mono8")], "has 4×4 pixels; expected 64×48"),
        "tiny": ([image(0, gray[:2, :2], "bayer_rggb8")], "has 2×2 pixels; expected at least 3×3 of bayer_rggb8"),
        "packed": (
            [made(compressed(0, shot(0)).__msgtype__, header=frame.header, format="", data=gray[0])],
            "cannot be",
        ),
        "cut off": ([_cut(compressed(0, shot(0)))], "picture 1: cut off; expected a whole PNG image"),
        "stamp": ([image(-(10**9), gray, "mono8")], "header.stamp is -1 s, 0 ns; expected a time since 1970"),
        "empty": ([], "/eye: has no messages; expected pictures"),
        "no images": ([made(STRING, data="x")], "found /eye (std_msgs/msg/String)"),
    }


def _cut(message: Any) -> Any:
    message.data = message.data[:-30]
    return message


@pytest.mark.parametrize("name", bad(Path()))
def test_what_is_wrong_with_a_topic_is_told(name: str, tmp_path: Path) -> None:
    messages, told = bad(tmp_path)[name]
    bag = write_bag(tmp_path / "bag", {"/eye": messages})
    with pytest.raises(DataError, match=re.escape(told)) as raised:
        shown(bag)
    assert str(raised.value).startswith(str(bag)), raised.value


def test_what_is_wrong_with_its_camera_info_is_told(tmp_path: Path) -> None:
    info = camera_info(LENS)
    info.d = np.full(3, 0.1)
    bag = write_bag(tmp_path / "bag", {"/eye": [image(0, shot(0), "rgb8")], "/camera_info": [info]})
    with pytest.raises(DataError, match=re.escape("bag: /camera_info: D: expected 4 or 5 numbers of plumb_bob, got 3")):
        shown(bag)
    info = camera_info(replace(LENS, size=(640, 480)))
    bag = write_bag(tmp_path / "other", {"/eye": [image(0, shot(0), "rgb8")], "/camera_info": [info]})
    with pytest.raises(DataError, match=re.escape("has 64×48 pixels; expected 640×480")):
        shown(bag)


def test_a_camera_info_that_cannot_be_read_does_not_count_where_a_calibration_is_given_or_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = {f"/{side}/image_raw": [image(0, shot(number), "rgb8")] for number, side in enumerate(("left", "right"))}
    infos = {f"/{side}/camera_info": [camera_info(LENS, "kannala_brandt")] for side in ("left", "right")}
    bag, topic = write_bag(tmp_path / "bag", frames | infos), "/right/image_raw"
    write_calibration(LENS, tmp_path / "camera.yaml")
    with pytest.raises(DataError, match="right/camera_info: distortion_model: expected one of plumb_bob, "):
        shown(bag, topic=topic)
    (belief,) = shown(bag, topic=topic, calibration=str(tmp_path / "camera.yaml"))
    np.testing.assert_array_equal(belief["image"], LENS.straightened(shot(1)))
    np.testing.assert_array_equal(belief["intrinsics"], LENS.intrinsics)
    looked_at: list[Array] = []

    def find_views(source: str, _: object, pictures: Iterator[Array], *__: object) -> None:
        looked_at.extend(pictures)
        raise DataError(f"{source}: is looked at")

    monkeypatch.setattr("hierax.nodes.sources.boards.find_views", find_views)
    asked = ("calibrate", str(bag), "-o", str(tmp_path / "made.yaml"))
    assert "bag: is looked at" in said_here(*asked, "--topic", topic).stderr
    np.testing.assert_array_equal(looked_at, [shot(1)])
    assert "expected one of them as topic" in said_here(*asked).stderr


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_damaged_bag_is_one_line(storage: str, tmp_path: Path) -> None:
    """Cut off or with junk somewhere, it is shown, or refused by its name: nothing else is raised."""
    frames = [image(stamp, shot(number), "rgb8") for number, stamp in enumerate(stamps())]
    bag = write_bag(tmp_path / "bag", {"/eye": frames, "/camera_info": [camera_info(PLAIN)]}, storage)
    (file,) = (path for path in bag.iterdir() if path.suffix != ".yaml")
    whole, metadata = file.read_bytes(), (bag / "metadata.yaml").read_text()
    rng = np.random.default_rng(SEED)
    refused: list[str] = []
    for trial in range(40):
        junk = bytearray(whole)
        if trial % 4 == 0:
            del junk[int(rng.integers(20, len(junk))) :]
        at = rng.integers(20, len(junk) if trial % 2 else min(len(junk), 3000), 8)
        for place in at:
            junk[place] = int(rng.integers(256))
        file.write_bytes(junk)
        try:
            shown(bag)
        except DataError as error:
            refused.append(str(error))
    assert [told for told in refused if not told.startswith(str(bag)) or "\n" in told] == [], f"seed {SEED}"
    assert len(refused) > 10, f"seed {SEED}"
    file.write_bytes(whole)
    for changed in ("", "[]", "a: {", metadata.replace("message_count: 5", "message_count: x"), metadata[:200]):
        (bag / "metadata.yaml").write_text(changed)
        with pytest.raises(DataError, match=re.escape(str(bag))):
            shown(bag)
    (bag / "metadata.yaml").write_text(metadata)
    file.unlink()
    with pytest.raises(DataError, match="bag: cannot be read: Some database files are missing"):
        shown(bag)


def test_a_bag_that_lacks_pictures_is_told(tmp_path: Path) -> None:
    frames = [image(stamp, shot(number), "rgb8") for number, stamp in enumerate(stamps())]
    bag = write_bag(tmp_path / "bag", {"/eye": frames}, "sqlite3")
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("DELETE FROM messages WHERE id > 3")
    database.close()
    with pytest.raises(DataError, match=re.escape("/eye: ends after 3 pictures; expected 5")):
        shown(bag)


def test_without_the_package_it_is_told_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "bag", {"/eye": [image(0, shot(0), "rgb8")]})
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(DataError, match=re.escape("this needs the package rosbags: pip install 'hierax[ros2]'")):
        CameraWorld(str(bag)).initial_belief()


@pytest.mark.parametrize(("encoding", "order"), [("16UC1", "<u2"), ("mono16", ">u2")])
def test_depth_is_shown_where_that_is_asked_for(encoding: str, order: str, tmp_path: Path) -> None:
    depth = np.random.default_rng(4).integers(0, 65536, (6, 8)).astype(np.uint16)
    rows, big = depth.astype(order).view(np.uint8), int(order[0] == ">")
    messages = [image(0, rows, encoding, pad=2, width=8, is_bigendian=big)]
    (belief,) = shown(write_bag(tmp_path / "bag", {"/depth": messages}), deep=True)
    np.testing.assert_array_equal(belief["image"], depth)
    assert belief["image"].dtype == np.uint16
