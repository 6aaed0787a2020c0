"""Topics as live sources: pictures with their camera and its pose, and whatever else is published, over Zenoh."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rosbags.serde import SerdeError
from support.bags import STORE, camera_info, compressed, image, made
from support.topics import Talker, joints, router, stamped, transforms

from hierax.nodes.ros2 import by_zenoh
from hierax.nodes.ros2.carrier import LATCHED, QOS
from hierax.nodes.ros2.live import TopicFrames, plain
from hierax.nodes.ros2.messages import decoded
from hierax.nodes.ros2.topics import Came
from hierax.nodes.ros2.tracked import MARKERS, meshes
from hierax.nodes.ros2.transforms import Transforms
from hierax.nodes.ros2.world import TopicsWorld, topics_heard
from hierax.nodes.sources.calibration import Lens
from hierax.nodes.sources.camera import CameraWorld, picture_seen
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.shots import CameraBelief
from hierax.schemas.values import encode_value

RAW, INFO = "/camera/image_raw", "/camera/camera_info"
SIZE = (32, 24)
PLAIN = Lens("told", SIZE, np.array([30.0, 31.0, 15.5, 11.5]), np.zeros(5), False)
BENT = Lens("told", SIZE, np.array([30.0, 30.0, 15.5, 11.5]), np.array([-0.3, 0.0, 0.0, 0.0, 0.0]), False)
STEP_NS = 10_000_000


@pytest.fixture
def where(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("ROS_DOMAIN_ID", "51")
    with router() as found:
        yield found


@pytest.fixture
def talker(where: str) -> Iterator[Talker]:
    with Talker(where) as found:
        yield found


def numbered(number: int) -> Array:
    return np.full((SIZE[1], SIZE[0]), number % 200, np.uint8)


def shows(talker: Talker, encoding: str = "mono8") -> None:
    """Publish pictures that tell their number, as a camera does."""

    def say(number: int) -> None:
        stamp_ns = STEP_NS * (number + 1)
        talker.say(INFO, stamped(camera_info(PLAIN), stamp_ns), QOS["sensor_data"])
        talker.say(RAW, stamped(image(0, numbered(number), encoding), stamp_ns), QOS["sensor_data"])

    talker.keep_on(100.0, say)


def follow(world: CameraWorld, belief: CameraBelief, epochs: int) -> list[CameraBelief]:
    beliefs = [belief]
    for _ in range(epochs):
        beliefs.append(world.predict((), (), beliefs[-1]))
    return beliefs


def test_the_newest_picture_is_shown_with_its_camera_stamp_and_frame(where: str, talker: Talker) -> None:
    shows(talker)
    world = CameraWorld(f"ros+zenoh://{where}{RAW}", source_timeout=60.0)
    for belief in follow(world, world.initial_belief(), 4):
        (seen,) = picture_seen(belief)
        number = seen["header"]["stamp_ns"] // STEP_NS - 1
        assert seen["header"] == {"stamp_ns": STEP_NS * (number + 1), "frame_id": "lens"}
        np.testing.assert_array_equal(seen["image"], numbered(number))
        np.testing.assert_array_equal(seen["intrinsics"], PLAIN.intrinsics)
        np.testing.assert_array_equal(seen["camera"], np.eye(4))
        assert belief["time_s"] == seen["header"]["stamp_ns"] / 1e9
        assert belief["frame"] == belief["index"] + belief["passed_over"]
        assert encode_value(dict(belief))
    assert belief["reopened"] == 0
    again = CameraWorld(f"ros+zenoh://{where}{RAW}", source_timeout=60.0)  # as another process would
    after = again.predict((), (), belief)
    assert (after["frame"] > belief["frame"], after["time_s"] > belief["time_s"]) == (True, True)
    assert after["reopened"] == 1


def test_pictures_are_straightened_by_camera_info_and_compressed_ones_are_decoded(where: str, talker: Talker) -> None:
    rgb = np.random.default_rng(3).integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)

    def say(number: int) -> None:
        talker.say("/camera/camera_info", camera_info(BENT))
        talker.say(f"{RAW}/compressed", stamped(compressed(0, rgb), number + 1))

    talker.keep_on(100.0, say)
    world = CameraWorld(f"ros+zenoh://{where}{RAW}/compressed?qos=reliable", source_timeout=60.0)
    (seen,) = picture_seen(world.initial_belief())
    np.testing.assert_array_equal(seen["image"], BENT.straightened(rgb))
    np.testing.assert_array_equal(seen["intrinsics"], BENT.intrinsics)


def test_the_cameras_pose_is_that_of_tf_at_the_time_of_the_picture(where: str, talker: Talker) -> None:
    turned = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))  # 90° about z
    talker.say("/tf_static", transforms(0, "hand", "lens", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), LATCHED)

    def say(number: int) -> None:
        stamp_ns = STEP_NS * (2 * number + 1)
        talker.say(RAW, stamped(image(0, numbered(number), "mono8"), stamp_ns), QOS["sensor_data"])
        talker.say("/tf", transforms(stamp_ns + STEP_NS, "map", "hand", (stamp_ns / 1e9, 0.0, 0.0), turned))

    talker.keep_on(50.0, say)
    world = CameraWorld(f"ros+zenoh://{where}{RAW}?world=map", source_timeout=60.0, straighten=False)
    for belief in follow(world, world.initial_belief(), 3):
        pose = belief["camera"]
        assert pose is not None
        np.testing.assert_allclose(pose[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], [belief["time_s"] - STEP_NS / 1e9, 0.0, 1.0], atol=1e-9)


def test_a_picture_keeps_the_pose_that_was_found_for_it() -> None:
    camera = TopicFrames(f"ros:{RAW}?world=map", 5.0, False, True)
    turn = (0.0, 0.0, 0.0, 1.0)
    for stamp_ns in (STEP_NS, 3 * STEP_NS):
        camera._transforms.add(transforms(stamp_ns, "map", "lens", (1.0, 0.0, 0.0), turn), False)
    came = Came(1, 2 * STEP_NS, 0, stamped(image(0, numbered(1), "mono8"), 2 * STEP_NS))
    assert camera._is_ready(came)
    camera._transforms.add(transforms(0, "map", "lens", (7.0, 0.0, 0.0), turn), False)  # time began anew
    pose = camera._shot({"image": came}).camera
    assert pose is not None
    np.testing.assert_array_equal(pose[:3, 3], [1.0, 0.0, 0.0])


def test_while_a_topic_stalls_time_goes_on_by_the_clock_of_its_stamps(where: str, talker: Talker) -> None:
    begun_ns, begun_s = 1_750_000_000 * 10**9, time.monotonic()
    waiting = CameraWorld(f"ros+zenoh://{where}{RAW}", source_timeout=0.2, reopen=True, straighten=False)
    belief = waiting.initial_belief()
    assert (belief["image"], belief["time_s"]) == (None, 0.0)  # nobody knows what time it is
    picture = stamped(image(0, numbered(1), "mono8"), begun_ns)
    for _ in range(100):
        talker.say(RAW, picture, QOS["sensor_data"])
        belief = waiting.predict((), (), belief)
        if belief["image"] is not None:
            break
    assert belief["time_s"] == begun_ns / 1e9
    times = [belief["time_s"]]
    while belief["image"] is not None or len(times) < 3:
        belief = waiting.predict((), (), belief)
        times.append(belief["time_s"])
    assert times == sorted(times)
    assert times[0] < times[-1] < times[0] + time.monotonic() - begun_s


def test_a_picture_within_a_message_is_its_fields_be_it_empty_or_of_any_encoding() -> None:
    body = {"id": 1, "model": {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]])}}
    marked: Any = decoded(STORE.serialize_cdr(meshes([body])[2], MARKERS).tobytes(), MARKERS)
    heard = plain("marks", marked)
    assert len(heard["markers"][0]["texture"]["data"]) == 0
    assert encode_value(heard)
    region = made("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    told = {"f": 1.0, "t": 1.0, "valid_window": region, "min_disparity": 0.0, "max_disparity": 1.0, "delta_d": 0.1}
    depths = image(0, np.zeros((2, 8), np.uint8), "32FC1", width=2)
    heard = plain("depth", made("stereo_msgs/msg/DisparityImage", header=depths.header, image=depths, **told))
    assert (heard["image"]["encoding"], heard["image"]["data"].shape) == ("32FC1", (16,))


def said_of(name: str, told: str) -> str:
    """The error of a camera that does not come, once it tells what it waits for."""
    for _ in range(100):
        world = CameraWorld(name, source_timeout=0.5)
        with pytest.raises(DataError) as raised:
            follow(world, world.initial_belief(), 100)
        if told in str(raised.value):
            return str(raised.value)
    raise AssertionError(f"{raised.value}\ndoes not say {told}")


def test_a_camera_info_of_which_nobody_knows_anything_is_no_calibration(where: str, talker: Talker) -> None:
    info = camera_info(PLAIN)
    info.k = np.zeros(9)
    talker.keep_on(50.0, lambda number: (talker.say(INFO, info), talker.say(RAW, image(number, numbered(0), "mono8"))))
    said_of(f"ros+zenoh://{where}{RAW}", f"{INFO}: K is zero, so nobody knows the camera; expected calibration")


def test_what_fast_dds_leaves_behind_a_message_is_cut_off() -> None:
    message = joints(5, 1.5)
    data = STORE.serialize_cdr(message, message.__msgtype__).tobytes()
    for spare in (b"", b"junk", b"moreJunk"):
        read = decoded(data + spare, message.__msgtype__)
        assert (read.name, list(read.position), len(read.effort)) == (["joint_0"], [1.5], 0)
    with pytest.raises(SerdeError):
        decoded(data[:-1], message.__msgtype__)


@pytest.mark.parametrize(
    ("encoding", "options", "told"),
    [
        ("32FC1", "", "encoding '32FC1'; expected one of mono8"),
        ("mono8", "?info=/other/camera_info", "source_timeout; no CameraInfo came on /other/camera_info"),
        ("mono8", "?world=map", "source_timeout; tf does not tell where lens is in map when a picture is taken"),
    ],
)
def test_what_lacks_is_told(encoding: str, options: str, told: str, where: str, talker: Talker) -> None:
    shows(talker, encoding)
    name = f"ros+zenoh://{where}{RAW}{options}"
    assert name in said_of(name, told)


def test_a_topic_that_nobody_publishes_or_of_another_type_is_told(where: str, talker: Talker) -> None:
    said_of(f"ros+zenoh://{where}/nothing", "within source_timeout; nobody publishes /nothing")
    waiting = CameraWorld(f"ros+zenoh://{where}/nothing", source_timeout=0.1, reopen=True)
    belief = follow(waiting, waiting.initial_belief(), 1)[-1]
    assert (picture_seen(belief), belief["stalls"]) == ((), 2)
    talker.say("/joints", joints(1, 0.5))
    wrong = CameraWorld(f"ros+zenoh://{where}/joints", source_timeout=60.0)
    with pytest.raises(DataError, match=r"/joints is of sensor_msgs/msg/JointState; expected sensor_msgs/msg/Compr"):
        wrong.initial_belief()


def test_topics_that_belong_together_are_shown_together(where: str, talker: Talker) -> None:
    def say(number: int) -> None:
        stamp_ns = STEP_NS * (number + 1)
        if number % 2 == 0:  # joints come twice as often, and two milliseconds later
            talker.say(RAW, stamped(image(0, numbered(number), "mono8"), stamp_ns))
        talker.say("/joints", joints(stamp_ns + 2_000_000, float(number), -1.0))

    talker.keep_on(100.0, say)
    named = {"picture": f"ros+zenoh://{where}{RAW}?qos=reliable", "arm": f"ros+zenoh://{where}/joints?qos=reliable"}
    world = TopicsWorld(named, within_s=0.003, source_timeout=60.0)
    belief = world.initial_belief()
    for _ in range(4):
        (heard,) = topics_heard(belief)
        number = heard["picture"]["header"]["stamp_ns"] // STEP_NS - 1
        assert number % 2 == 0
        np.testing.assert_array_equal(heard["picture"]["image"], numbered(number))
        np.testing.assert_array_equal(heard["arm"]["position"], [number, -1.0])
        assert (heard["arm"]["name"], heard["arm"]["header"]["frame_id"]) == (("joint_0", "joint_1"), "base")
        assert encode_value(dict(belief))
        before, belief = belief, world.predict((), (), belief)
        assert belief["frame"] > before["frame"]
    with pytest.raises(ValueError, match="expected all of one carrier"):
        TopicsWorld({"one": "ros:/one", "two": "ros+zenoh:/two"})


@pytest.mark.parametrize("tiny", [0.0, 1e-320, 1e-170])
def test_a_transform_whose_turn_is_none_is_passed_over(tiny: float) -> None:
    known = Transforms()
    known.add(transforms(0, "hand", "lens", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.5)), static=True)
    known.add(transforms(0, "hand", "lens", (0.0, 0.0, 2.0), (tiny, 0.0, 0.0, 0.0)), static=True)
    found = known.find("hand", "lens", 0)
    assert found is not None
    np.testing.assert_array_equal(found[:3, 3], [0.0, 0.0, 1.0])


def test_depth_of_a_topic_is_shown_where_that_is_asked_for(where: str, talker: Talker) -> None:
    depth = np.arange(SIZE[0] * SIZE[1], dtype=np.uint16).reshape(SIZE[1], SIZE[0]) * 80
    data = depth.astype("<u2").view(np.uint8)

    def say(number: int) -> None:
        talker.say(INFO, camera_info(PLAIN), QOS["sensor_data"])
        talker.say(RAW, stamped(image(0, data, "16UC1", width=SIZE[0]), number + 1), QOS["sensor_data"])

    talker.keep_on(100.0, say)
    (seen,) = picture_seen(CameraWorld(f"ros+zenoh://{where}{RAW}", source_timeout=60.0, deep=True).initial_belief())
    np.testing.assert_array_equal(seen["image"], depth)
    with pytest.raises(DataError, match="uint16 pixels; expected 8 bits"):
        CameraWorld(f"ros+zenoh://{where}{RAW}", source_timeout=60.0).initial_belief()


def test_a_router_that_is_not_there_is_told(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_zenoh, "_REACHED_S", 0.2)
    told = said_of("ros+zenoh://127.0.0.1:9/eye", "no router of Zenoh is reached at 127.0.0.1:9")
    assert "nobody publishes" not in told
    assert "nothing is said or heard until one comes" in caplog.text
