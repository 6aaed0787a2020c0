"""Beside the real ROS 2: rclpy over Fast DDS, in processes of its own, on the loopback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, patch

import numpy as np
import pytest
from support import launched
from support.cameras import filmed
from support.launched import TESTS, Launched, environment, said_here

from hierax.nodes.ros2.carrier import QOS, address_of, open_carrier
from hierax.nodes.ros2.messages import messages
from hierax.nodes.sources.calibration import read_calibration
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.math.geometry import rotation_of
from hierax.runtime.recording.reading import Recording

ROS = TESTS.parent / ".venv" / "ros"
PYTHON = str(ROS / "bin" / "python")
FRAMES, TIMEOUT_S = 5, 300.0

needs_rclpy = pytest.mark.skipif(not (ROS / ".installed").exists(), reason="make .venv/ros/.installed brings rclpy")


@pytest.fixture
def graph() -> Iterator[dict[str, str]]:
    """The environment of a graph of ROS that nobody else is in."""
    told = {"ROS_DOMAIN_ID": str(1 + os.getpid() % 99), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with patch.dict(os.environ, told):
        yield environment()


def peer(script: str, *words: str, **options: Any) -> subprocess.Popen[str]:
    command = [PYTHON, str(TESTS / "support" / script), *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@needs_rclpy
def test_types_and_messages_are_rclpys(graph: dict[str, str]) -> None:
    with peer("rclpy_types.py", env=graph) as process:
        out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, err
    found = json.loads(out)
    assert len(found) == 8
    assert found == {kind: [messages().hash_rihs01(kind), True] for kind in found}


def pictures_of(folder: Path, out: Path) -> Path:
    """A scene's pictures as the peer reads them."""
    scene = BopScene(folder)
    out.mkdir()
    for number, frame in enumerate(scene.frames):
        np.save(out / f"{number:06d}.npy", read_image(frame.image))
    lens = read_calibration(folder.parents[1] / "camera.yaml")
    camera = {"width": lens.size[0], "height": lens.size[1], "k": lens.matrix.ravel().tolist()}
    (out / "camera.json").write_text(json.dumps({**camera, "d": lens.coefficients.tolist()}))
    return out


@needs_rclpy
def test_rclpy_shows_pictures_and_hears_poses(
    tmp_path: Path, graph: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = filmed(tmp_path / "made", FRAMES, 1)
    pictures, heard, recording = (
        pictures_of(folder, tmp_path / "pictures"),
        tmp_path / "heard.json",
        tmp_path / "r.mcap",
    )
    monkeypatch.setattr(launched, "HIERAX", [PYTHON, *launched.HIERAX[1:]])
    told = ["camera=ros:/camera/image_raw?qos=reliable", f"objects={folder.parents[1] / 'objects.yaml'}"]
    told += ["publish=ros:/hierax", "source_timeout=200", "epoch_deadline_s=250"]
    words = [word for each in told for word in ("--set", each)]
    with (
        Launched(tmp_path, "tracking", *words, "--record", str(recording)) as run,
        peer("rclpy_peer.py", str(pictures), str(heard), env=graph) as process,
    ):
        _, err = process.communicate(timeout=TIMEOUT_S)
        assert process.returncode == 0, f"{err}\n{run.err}"
        run.until_epoch(FRAMES - 1)
        run.process.send_signal(signal.SIGINT)
        run.end(TIMEOUT_S)
    found = json.loads(heard.read_text())
    assert (found["sent"], len(found["poses"]), found["frames"]) == (FRAMES, FRAMES, ["lens"])
    for number, epoch in zip(range(FRAMES), Recording.open(recording).epochs(), strict=False):
        (seen,) = epoch.elements("obs", "world", "arm") or ()
        np.testing.assert_array_equal(seen["image"], np.load(pictures / f"{number:06d}.npy"))
        sensed = epoch.sensed_of("arm")
        assert sensed is not None
        (item,) = sensed[0]["objects"]
        pose = found["poses"][str(number)]
        np.testing.assert_array_equal(pose[:3], item["pose"][:3, 3])
        np.testing.assert_allclose(rotation_of(np.array(pose[3:])), item["pose"][:3, :3], atol=1e-12)
        assert found["tf"][str(number)] == {"object_1": ["lens", *pose[:3]]}
    assert (found["drawn_in"], found["detections"] >= FRAMES - 1) == (["object_1"], True)
    assert int(found["launch"]["epoch"]) >= FRAMES - 1
    kinds = {"/hierax/object_1/pose": "geometry_msgs/msg/PoseStamped", "/tf": "tf2_msgs/msg/TFMessage"}
    kinds |= {"/hierax/markers": "visualization_msgs/msg/MarkerArray"}
    kinds |= {"/hierax/detections": "vision_msgs/msg/Detection3DArray"}
    for topic, kind in kinds.items():
        assert found["hashes"][topic] == messages().hash_rihs01(kind)
    done = said_here("replay", str(recording), "--verify")
    assert (done.returncode, "all results are alike" in done.stdout) == (0, True), done.stderr


def test_without_rclpy_it_is_told_what_to_do() -> None:
    with pytest.raises(
        DataError, match=r"ros:/image: rclpy cannot be imported .*; expected a shell in which ROS's set"
    ):
        open_carrier(address_of("ros:/image", ()), "test")


@pytest.mark.parametrize("failing", ["init", "create_node", "create_subscription", "create_publisher"])
def test_what_rclpy_refuses_is_told_and_leaves_nothing_open(failing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rclpy = MagicMock()
    for name in ("rclpy", "rclpy.executors", "rclpy.signals", "rclpy.context", "rclpy.qos", "std_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, rclpy)
    rclpy.ExternalShutdownException = InterruptedError
    owner = rclpy if failing in ("init", "create_node") else rclpy.create_node.return_value
    getattr(owner, failing).side_effect = RuntimeError("rcl says no\nat length")
    with pytest.raises(DataError, match=r"^ros:/image: .*rclpy refuses: RuntimeError: rcl says no; expected a ROS"):
        heard_and_said()
    assert rclpy.try_shutdown.call_count == (failing != "init")


def heard_and_said() -> None:
    with closing(open_carrier(address_of("ros:/image", ()), "test")) as carrier:
        carrier.publisher("/one", "std_msgs/msg/String", QOS["reliable"])
        carrier.subscribe("/two", "std_msgs/msg/String", QOS["reliable"], lambda *_: None)
