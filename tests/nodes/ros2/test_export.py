"""Recordings as bags: what other programs read of them, and the way back."""

from __future__ import annotations

import errno
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, Writer
from support.bags import camera_info, compressed, image, write_bag
from support.cameras import filmed, settings
from support.junk_recordings import Contents
from support.launched import said_here

from hierax.nodes.ros2.export import export_rosbag
from hierax.nodes.sources.calibration import read_calibration
from hierax.nodes.sources.camera import CameraWorld
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.math.geometry import rotation_of
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.writing import ENDING
from hierax.schemas.values import encode_value

FRAMES, OBJECTS, FPS = 4, 2, 25


def recorded(path: Path, deployment: str, *told: str, more: tuple[str, ...] = ()) -> Path:
    words = (word for each in told for word in ("--set", each))
    done = said_here("run", deployment, *words, "--record", str(path), *more)
    assert done.returncode == 0, done.stderr
    return path


def from_bag(out: Path, name: str) -> list[str]:
    return [f"camera={out / name}", f"objects={out / 'objects.yaml'}"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene's pictures as a folder and as a bag, what was tracked in each, and the first as a bag."""
    out = tmp_path_factory.mktemp("made")
    filmed(out, FRAMES, OBJECTS)
    pictures = [read_image(out / "frames" / f"shot {number}.png") for number in range(FRAMES)]
    frames = [image(40_000_000 * at, rgb[..., ::-1], "bgr8", pad=3) for at, rgb in enumerate(pictures)]
    info = camera_info(read_calibration(out / "camera.yaml"))
    topics = {"/eye/image_raw": frames, "/eye/image_raw/compressed": [compressed(0, pictures[0])]}
    write_bag(out / "bag", {**topics, "/eye/camera_info": [info]}, "sqlite3")
    recorded(out / "folder.mcap", "tracking", *settings(out, out / "frames", f"fps={FPS}"))
    recorded(out / "bag.mcap", "tracking", *from_bag(out, "bag"), "camera_topic=/eye/image_raw")
    done = said_here("export", str(out / "folder.mcap"), "--rosbag", str(out / "exported"))
    assert (done.returncode, f"{FRAMES} messages on /object_1/pose" in done.stdout) == (0, True), done.stderr
    return out


def states(recording: Path) -> list[list[bytes]]:
    return [
        [encode_value(tuple(epoch.nodes[name].state)) for name in ("arm", "spatial")]
        for epoch in Recording.open(recording).epochs()
    ]


def believed(recording: Path) -> list[dict[str, Any]]:
    return [epoch.nodes["arm"].sensed[0] for epoch in Recording.open(recording).epochs() if epoch.nodes["arm"].sensed]


def test_a_bag_is_tracked_as_its_folder_is_to_the_bit(made: Path) -> None:
    expected = states(made / "folder.mcap")
    assert len(expected) == FRAMES
    assert states(made / "bag.mcap") == expected
    assert states(recorded(made / "again.mcap", "tracking", *from_bag(made, "exported"))) == expected
    done = said_here("replay", str(made / "bag.mcap"), "--verify")
    assert (done.returncode, "all results are alike" in done.stdout) == (0, True), done.stderr


def by_rosbags(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, stamp_ns, data in reader.messages():
            found[connection.topic].append((stamp_ns, reader.deserialize(data, connection.msgtype)))
    return found


def by_mcap(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as content:
        for schema, channel, message, decoded in make_reader(
            content, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            found[channel.topic].append((message.log_time, decoded))
    return found


def matrix(position: Any, turn: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(np.array([turn.x, turn.y, turn.z, turn.w]))
    pose[:3, 3] = position.x, position.y, position.z
    return pose


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_others_read_what_was_seen_and_believed(read: Any, made: Path) -> None:
    found, beliefs = read(made / "exported"), believed(made / "folder.mcap")
    topics = ["/camera/camera_info", "/camera/image_rect", "/detections", "/diagnostics"]
    topics += ["/object_1/pose", "/object_2/pose", "/tf"]
    assert sorted(found) == topics
    assert {name: len(messages) for name, messages in found.items()} == dict.fromkeys(topics, FRAMES)
    lens = read_calibration(made / "camera.yaml")
    for number, belief in enumerate(beliefs):
        at = {name: messages[number] for name, messages in found.items()}
        assert {stamp_ns for stamp_ns, _ in at.values()} == {40_000_000 * number}
        _, shown = at["/camera/image_rect"]
        pixels = np.frombuffer(bytes(shown.data), np.uint8).reshape(shown.height, shown.step)
        expected = read_image(made / "frames" / f"shot {number}.png")
        assert (shown.encoding, shown.header.frame_id) == ("rgb8", "camera")
        np.testing.assert_array_equal(pixels.reshape(expected.shape), expected)
        _, info = at["/camera/camera_info"]
        np.testing.assert_array_equal(np.asarray(getattr(info, "k", None)).reshape(3, 3), lens.matrix)
        frames = {each.child_frame_id: each for each in at["/tf"][1].transforms}
        assert frames["camera"].header.frame_id == "world"
        for item in belief["objects"]:
            _, posed = at[f"/object_{item['id']}/pose"]
            stamp = posed.header.stamp
            assert (stamp.sec, stamp.nanosec, posed.header.frame_id) == (0, 40_000_000 * number, "camera")
            pose = matrix(posed.pose.position, posed.pose.orientation)
            np.testing.assert_array_equal(pose[:3, 3], item["pose"][:3, 3])
            np.testing.assert_allclose(pose, item["pose"], atol=1e-12)
            moved = frames[f"object_{item['id']}"]
            np.testing.assert_array_equal(matrix(moved.transform.translation, moved.transform.rotation), pose)
        detections = {each.id: each.results[0] for each in at["/detections"][1].detections}
        for item in belief["objects"]:
            found_it = detections[str(item["id"])]
            assert (found_it.hypothesis.class_id, found_it.hypothesis.score) == (
                str(item["obj_id"]),
                item["probability"],
            )
            place = found_it.pose.pose
            np.testing.assert_allclose(matrix(place.position, place.orientation), item["pose"], atol=1e-12)
            covariance = np.asarray(found_it.pose.covariance).reshape(6, 6)
            variances = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
            told_by = item["covariance"]
            np.testing.assert_allclose(variances, (np.trace(told_by[:3, :3]), np.trace(told_by[3:, 3:])))
        told = at["/diagnostics"][1].status
        figures = [{each.key: float(each.value) for each in status.values} for status in told]
        names = ("score", "probability", "nats")
        assert figures == [{name: item[name] for name in names} for item in belief["objects"]]
        assert [status.message for status in told] == [item["status"] for item in belief["objects"]]


def test_types_are_told_with_their_hashes_and_definitions(made: Path) -> None:
    with Reader(made / "exported") as reader:
        for connection in reader.connections:
            assert connection.digest.startswith("RIHS01_"), connection
            assert connection.msgdef.data, connection


def test_a_camera_alone_and_gray_pictures(made: Path, tmp_path: Path) -> None:
    """Pictures of a world without a calibration have a camera matrix of zeros, which says so."""
    filmed(tmp_path, 2, 1, grey=True)
    file = recorded(tmp_path / "gray.mcap", "tracking", *settings(tmp_path, tmp_path / "frames"))
    export_rosbag(file, tmp_path / "deep" / "gray")
    shown = by_rosbags(tmp_path / "deep" / "gray")["/camera/image_rect"]
    expected = read_image(tmp_path / "frames" / "shot 1.png")
    assert (shown[1][1].encoding, expected.ndim) == ("mono8", 2)
    np.testing.assert_array_equal(shown[1][1].data.reshape(expected.shape), expected)


def test_what_is_there_is_not_written_over(made: Path, tmp_path: Path) -> None:
    recording, bag = made / "folder.mcap", tmp_path / "bag"
    export_rosbag(recording, bag)
    (before,) = (path.read_bytes() for path in bag.glob("*.mcap"))
    with pytest.raises(DataError, match="bag: is there already; --overwrite replaces it"):
        export_rosbag(recording, bag)
    export_rosbag(recording, bag, overwrite=True)
    (after,) = (path.read_bytes() for path in bag.glob("*.mcap"))
    assert after == before
    (bag / "mine.txt").touch()
    with pytest.raises(DataError, match="bag: has other files than a bag's"):
        export_rosbag(recording, bag, overwrite=True)
    with pytest.raises(DataError, match=r"mine.txt: has other files than a bag's"):
        export_rosbag(recording, bag / "mine.txt", overwrite=True)
    (bag / "mine.txt").unlink()
    (bag / "metadata.yaml").rename(tmp_path / "metadata.yaml")  # recordings alone, as far as one can see
    with pytest.raises(DataError, match="bag: has other files than a bag's"):
        export_rosbag(recording, bag, overwrite=True)
    (tmp_path / "metadata.yaml").rename(bag / "metadata.yaml")
    (bag / "other.mcap").touch()
    with pytest.raises(DataError, match="bag: has other files than a bag's"):
        export_rosbag(recording, bag, overwrite=True)
    (bag / "mine.txt").touch()
    with pytest.raises(DataError, match=r"mine.txt/bag: cannot be written: (File exists|Not a directory)"):
        export_rosbag(recording, bag / "mine.txt" / "bag")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag"]


def test_a_full_disk_leaves_what_was_there(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    export_rosbag(made / "folder.mcap", tmp_path / "bag")
    before = sorted(tmp_path.rglob("*"))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "write", full)
    with pytest.raises(DataError, match="bag: cannot be written: No space left on device"):
        export_rosbag(made / "folder.mcap", tmp_path / "bag", overwrite=True)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_message_that_is_none_is_told(made: Path, tmp_path: Path) -> None:
    """Its end lacks, which is seen when it is read. As a source of pictures, too."""
    contents = Contents.read(made / "folder.mcap")
    said = tuple(each._replace(data=each.data[:-3]) if "/obs/world/" in each.topic else each for each in contents.said)
    spoilt = tmp_path / "spoilt.mcap"
    replace(contents, said=said).write(spoilt)
    with pytest.raises(DataError, match=re.escape(f"{spoilt}: ")):
        export_rosbag(spoilt, tmp_path / "bag")
    with pytest.raises(DataError, match=re.escape(f"{spoilt}: ")):
        CameraWorld(str(spoilt)).initial_belief()


def test_of_a_recording_that_was_cut_off_a_warning_tells(
    made: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    contents = Contents.read(made / "folder.mcap")
    del contents.metadata[ENDING]
    contents.write(tmp_path / "cut.mcap")
    whole = export_rosbag(made / "folder.mcap", tmp_path / "whole")
    assert not caplog.records
    assert export_rosbag(tmp_path / "cut.mcap", tmp_path / "cut") == whole
    assert [each.levelname for each in caplog.records] == ["WARNING"]
    assert "cut.mcap: it was cut off: its last chunk" in caplog.text
    replace(contents, said=()).write(tmp_path / "empty.mcap")
    with pytest.raises(DataError, match=re.escape("empty.mcap: has no epochs; expected some to export")):
        export_rosbag(tmp_path / "empty.mcap", tmp_path / "empty")


def test_pictures_stand_without_poses_where_a_process_died_before_it_told_what_it_believed(
    made: Path, tmp_path: Path
) -> None:
    contents = Contents.read(made / "folder.mcap")
    steps = [each for each in contents.said if each.topic.endswith("steps/arm")]
    said = tuple(each for each in contents.said if each is not steps[1])
    gap, whole = tmp_path / "gap.mcap", export_rosbag(made / "folder.mcap", tmp_path / "whole")
    replace(contents, said=said).write(gap)
    done = said_here("export", str(gap), "--rosbag", str(tmp_path / "bag"))
    assert (done.returncode, "it lacks what arm believed in 1 epochs" in done.stderr) == (0, True), done.stderr
    exported = export_rosbag(gap, tmp_path / "bag", overwrite=True)
    assert (whole.lacking, exported.lacking) == (0, 1)
    assert exported.counts["/camera/image_rect"] == whole.counts["/camera/image_rect"]
    assert exported.counts["/diagnostics"] == whole.counts["/diagnostics"] - 1


def test_what_a_recording_lacks_is_told(made: Path, tmp_path: Path) -> None:
    servo = recorded(tmp_path / "servo.mcap", "servo", more=("--epochs", "2"))
    told = settings(made, made / "frames")
    blind = recorded(tmp_path / "blind.mcap", "tracking", *told, more=("--exclude", "obs/world/*"))
    mute = recorded(tmp_path / "mute.mcap", "tracking", *told, more=("--exclude", "steps/arm"))
    for recording, poses, expected in (
        (servo, "arm", "epoch 1: world showed no picture; expected image, camera, intrinsics and frame"),
        (blind, "arm", "epoch 1: lacks what world showed; expected its observations"),
        (mute, "arm", "lacks what arm believed; expected its belief after the picture"),
        (made / "folder.mcap", "hand", "epoch 1: there is no node hand; expected --poses NODE, one of arm, spatial"),
        (made / "folder.mcap", "spatial", "epoch 1: spatial believes no poses; expected camera, and objects with id"),
        (tmp_path / "none.mcap", "arm", "none.mcap: cannot be read: No such file or directory"),
        (made / "objects.yaml", "arm", "objects.yaml: is no recording; expected an MCAP file that hierax wrote"),
    ):
        with pytest.raises(DataError, match=re.escape(expected)):
            export_rosbag(recording, tmp_path / "bag", poses)
    assert not (tmp_path / "bag").exists()
    done = said_here("run", "tracking", *(word for each in from_bag(made, "bag") for word in ("--set", each)))
    assert "bag: has pictures on /eye/image_raw, /eye/image_raw/compressed; expected one of them" in done.stderr
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    done = said_here("export", str(servo), "--rosbag", str(tmp_path / "bag"))
    assert (done.returncode, done.stderr.count("\n"), done.stderr[:7]) == (1, 1, "error: "), done.stderr
