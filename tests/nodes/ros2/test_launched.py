"""A launch before topics, without ROS: what it publishes, its processes killed, and all again from its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bags import camera_info, image
from support.cameras import filmed
from support.launched import Launched, said_here, until
from support.topics import Talker, router, stamped

from hierax.nodes.ros2.carrier import LATCHED, QOS
from hierax.nodes.sources.calibration import read_calibration
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.runtime.recording.reading import Recording

STEADY = ("restart.max_restarts=0", "restart.restart_delay=0.0", "reopen=true", "source_timeout=2")
EPOCHS, STEP_NS = 24, 16_666_667
SLOW = 30  # a film of so many frames, of which the first few go round: no jump is one that no camera makes
BEGUN_NS = 1_700_000_000_123_456_789


def stamps(messages: list[Any]) -> list[int]:
    return [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in messages]


def test_it_publishes_and_survives_and_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "52")
    scene = BopScene(filmed(tmp_path / "made", SLOW, 1))
    pictures = [read_image(frame.image) for frame in scene.frames[:4]]
    info = camera_info(read_calibration(tmp_path / "made" / "camera.yaml"))
    recording, objects = tmp_path / "live.mcap", tmp_path / "made" / "objects.yaml"
    with router() as where, Talker(where) as talker:
        poses = talker.hear("/hierax/object_1/pose", "geometry_msgs/msg/PoseStamped")
        detections = talker.hear("/hierax/detections", "vision_msgs/msg/Detection3DArray")
        moved = talker.hear("/tf", "tf2_msgs/msg/TFMessage")
        told = talker.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        drawn = talker.hear("/hierax/markers", "visualization_msgs/msg/MarkerArray", LATCHED)

        def say(number: int) -> None:
            stamp_ns = BEGUN_NS + STEP_NS * number
            talker.say("/camera/camera_info", stamped(info, stamp_ns), QOS["sensor_data"])
            shown = image(0, pictures[number % len(pictures)], "rgb8")
            talker.say("/camera/image_raw", stamped(shown, stamp_ns), QOS["sensor_data"])

        talker.keep_on(60.0, say)
        camera = f"camera=ros+zenoh://{where}/camera/image_raw"
        settings = (camera, f"objects={objects}", f"publish=ros+zenoh://{where}/hierax?world=map", *STEADY)
        words = [word for each in (*settings, f"output={tmp_path / 'poses.csv'}") for word in ("--set", each)]
        more = ("--record", str(recording), "--epochs", str(EPOCHS))
        with Launched(tmp_path, "tracking", *words, *more) as run:
            for number, node in enumerate(("world", "arm", "spatial"), start=1):
                run.until_epoch(5 * number)
                run.kill(node)
            metrics = run.report(240.0)["nodes"]["world"]["metrics"]
        until(lambda: len(drawn) > 0, "meshes")
    assert metrics["passed_over"] > 0
    assert metrics["reopened"] >= 1
    epochs = list(Recording.open(recording).epochs())
    seen = [each for epoch in epochs for each in epoch.elements("obs", "world", "arm") or ()]
    frames, at = ([each["frame"] for each in seen], [each["header"]["stamp_ns"] for each in seen])
    assert frames == sorted(set(frames))
    assert at == sorted(set(at))
    for picture in seen:
        number = (picture["header"]["stamp_ns"] - BEGUN_NS) // STEP_NS
        np.testing.assert_array_equal(picture["image"], pictures[number % len(pictures)])
    heard = stamps(poses)
    assert set(heard) <= set(at)  # to the nanosecond
    assert len(set(heard)) >= 4  # those of processes that died, or were not found yet, may lack
    assert {each.header.frame_id for each in poses} == {"lens"}
    frames_moved = {(each.header.frame_id, each.child_frame_id) for message in moved for each in message.transforms}
    assert frames_moved == {("map", "lens"), ("lens", "object_1")}
    assert {each.results[0].hypothesis.class_id for message in detections for each in message.detections} == {"1"}
    assert {each.status[0].name for each in told} == {"hierax: arm"}
    assert drawn[0].markers[0].header.frame_id == "object_1"
    done = said_here("replay", str(recording), "--verify")
    assert (done.returncode, "all results are alike" in done.stdout) == (0, True), done.stderr
    words = [word for each in (f"camera={recording}", f"objects={objects}") for word in ("--set", each)]
    again = said_here("run", "tracking", *words, "--set", f"output={tmp_path / 'again.csv'}")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "poses.csv").read_bytes()
    exported = said_here("export", str(recording), "--rosbag", str(tmp_path / "bag"))
    assert exported.returncode == 0, exported.stderr
    repeated = [f"camera={tmp_path / 'bag'}", f"objects={objects}", f"output={tmp_path / 'bagged.csv'}"]
    bagged = said_here("run", "tracking", *(word for each in repeated for word in ("--set", each)))
    assert bagged.returncode == 0, bagged.stderr
    assert len((tmp_path / "bagged.csv").read_text().splitlines()) == len(seen) + 1


def test_what_tells_the_cameras_pose_twice_is_refused(tmp_path: Path) -> None:
    filmed(tmp_path / "made", 1, 1)
    objects = tmp_path / "made" / "objects.yaml"
    words = ["--set", "camera=ros+zenoh:/image?world=map", "--set", f"objects={objects}", "--set", "tag_mm=80"]
    done = said_here("run", "tracking", *words)
    assert done.returncode == 1
    assert "tag_mm is 80, and camera is ros+zenoh:/image?world=map; expected one of the two" in done.stderr
    objects.write_text(f"camera: {np.eye(4).tolist()}\n" + objects.read_text())
    done = said_here("run", "tracking", *words[:4])
    assert (done.returncode, "tells the camera's pose" in done.stderr) == (1, True), done.stderr
