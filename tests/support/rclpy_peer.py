"""Another node of ROS, by rclpy alone: it publishes pictures, and hears what is made of them.

    .venv/ros/bin/python tests/support/rclpy_peer.py PICTURES OUT.json --object 1 --rate 20
    .venv/ros/bin/python tests/support/rclpy_peer.py --echo

PICTURES holds NAME.npy and camera.json (width, height, k, d). A picture follows when the pose of the one before was
heard, and not sooner than the rate says; with --open-loop at the rate alone. With --echo it answers every picture with
a pose at once, which is what messages take.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3DArray
from visualization_msgs.msg import MarkerArray

IMAGE, ECHO, INFO = "/camera/image_raw", "/echo/pose", "/camera/camera_info"
WAIT_S = 120.0
LATCHED = QoSProfile(depth=1, durability=rclpy.qos.DurabilityPolicy.TRANSIENT_LOCAL)


class Peer:
    """The node."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.node = rclpy.create_node("peer")
        self.sent: dict[int, float] = {}
        self.poses: dict[int, list[float]] = {}
        self.frames: set[str] = set()
        self.took: dict[str, dict[int, float]] = defaultdict(dict)
        self.tf: dict[int, dict[str, Any]] = {}
        self.told: dict[str, Any] = {"detections": 0, "diagnostics": 0, "triangles": 0}
        self.pictures = self.node.create_publisher(Image, IMAGE, 10)
        self.infos = self.node.create_publisher(CameraInfo, INFO, 10)
        place = f"/hierax/object_{options.object}/pose"
        self.needed = [place] + [ECHO] * options.with_echo
        hear = self.node.create_subscription
        self.held = [
            hear(PoseStamped, place, self.posed, 10),
            hear(PoseStamped, ECHO, lambda told: self.timed("echo", told), 10),
            hear(TFMessage, "/tf", self.moved, 100),
            hear(
                Detection3DArray, "/hierax/detections", lambda told: self.count("detections", len(told.detections)), 10
            ),
            hear(DiagnosticArray, "/diagnostics", self.diagnosed, 10),
            hear(MarkerArray, "/hierax/markers", self.drawn, LATCHED),
        ]

    def posed(self, told: PoseStamped) -> None:
        place, turn = told.pose.position, told.pose.orientation
        self.poses[self.timed("pose", told)] = [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
        self.frames.add(told.header.frame_id)

    def timed(self, name: str, told: PoseStamped) -> int:
        stamp = stamp_of(told)
        self.took[name].setdefault(stamp, time.monotonic() - self.sent.get(stamp, time.monotonic()))
        return stamp

    def moved(self, told: TFMessage) -> None:
        for each in told.transforms:
            place = each.transform.translation
            self.tf.setdefault(stamp_of(each), {})[each.child_frame_id] = [
                each.header.frame_id,
                place.x,
                place.y,
                place.z,
            ]

    def count(self, name: str, number: int) -> None:
        self.told[name] += number

    def diagnosed(self, told: DiagnosticArray) -> None:
        self.count("diagnostics", 1)
        self.told["launch"] = {each.key: each.value for each in told.status[0].values}

    def drawn(self, told: MarkerArray) -> None:
        self.told["triangles"] = sum(len(each.points) // 3 for each in told.markers)
        self.told["drawn_in"] = [each.header.frame_id for each in told.markers]

    def until(self, condition: Any, what: str, timeout_s: float = WAIT_S) -> None:
        patience = time.monotonic() + timeout_s
        while not condition():
            rclpy.spin_once(self.node, timeout_sec=0.01)
            if time.monotonic() > patience:
                raise SystemExit(f"not within {timeout_s:g} s: {what}")

    def is_answered(self, stamp: int, info: CameraInfo) -> bool:
        """Whether a pose came; until the first one what the camera is is told over and over, as cameras do."""
        if not self.poses:
            self.infos.publish(info)
        return stamp in self.poses

    def show(self) -> None:
        """Publish the pictures and wait for what is made of them."""
        folder, options = self.options.pictures, self.options
        camera = json.loads((folder / "camera.json").read_text())
        images = [np.load(path) for path in sorted(folder.glob("*.npy"))]
        count = self.node.count_publishers
        self.until(lambda: self.pictures.get_subscription_count() > options.with_echo, "somebody looks")
        self.until(lambda: all(count(topic) for topic in self.needed), "somebody answers")
        info = CameraInfo(width=camera["width"], height=camera["height"], k=camera["k"], d=camera["d"])
        info.distortion_model, info.header.frame_id = "plumb_bob", "lens"
        self.until(lambda: self.infos.get_subscription_count() > 0, "somebody asks for the camera")
        due = time.monotonic()
        for image in images:
            self.until(lambda due=due: time.monotonic() >= due, "the rate")
            due = max(due + 1.0 / options.rate, time.monotonic()) if not options.open_loop else due + 1.0 / options.rate
            message = Image(height=image.shape[0], width=image.shape[1], step=image[0].size)
            message.encoding = "mono8" if image.ndim == 2 else "rgb8"
            message.data.frombytes(image.tobytes())
            stamp = time.time_ns()
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            message.header.frame_id = "lens"
            info.header.stamp = message.header.stamp
            self.infos.publish(info)
            self.sent[stamp] = time.monotonic()
            self.pictures.publish(message)
            if not options.open_loop:
                self.until(lambda stamp=stamp: self.is_answered(stamp, info), f"the pose of picture {len(self.sent)}")
        wanted = set(self.sent)
        if options.open_loop:
            patience = time.monotonic() + 5.0
            self.until(lambda: wanted <= set(self.poses) or time.monotonic() > patience, "the last poses")
        self.until(lambda: set(self.poses) <= set(self.tf) and self.told["triangles"], "tf and meshes", 10.0)
        stamps = list(self.sent)
        result = {
            "sent": len(stamps),
            "poses": {stamps.index(stamp): pose for stamp, pose in self.poses.items() if stamp in wanted},
            "tf": {stamps.index(stamp): moved for stamp, moved in self.tf.items() if stamp in wanted},
            "frames": sorted(self.frames),
            "took_s": {name: [each[stamp] for stamp in stamps if stamp in each] for name, each in self.took.items()},
            "hashes": {
                topic: str(each.topic_type_hash)
                for topic in (IMAGE, "/tf", "/diagnostics", "/hierax/detections", "/hierax/markers", *self.needed)
                for each in self.node.get_publishers_info_by_topic(topic)
            },
            **self.told,
        }
        options.out.write_text(json.dumps(result))


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def echo() -> None:
    """Answer every picture with a pose."""
    node = rclpy.create_node("echo")
    answers = node.create_publisher(PoseStamped, ECHO, 10)
    node.create_subscription(
        Image, IMAGE, lambda image: answers.publish(PoseStamped(header=image.header)), qos_profile_sensor_data
    )
    rclpy.spin(node)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="?", type=Path)
    parser.add_argument("out", nargs="?", type=Path)
    parser.add_argument("--object", type=int, default=1)
    parser.add_argument("--rate", type=float, default=20.0, help="Hz")
    parser.add_argument("--open-loop", action="store_true")
    parser.add_argument("--with-echo", action="store_true", help="an echo node is there, too")
    parser.add_argument("--echo", action="store_true")
    options = parser.parse_args()
    rclpy.init()
    if options.echo:
        echo()
    else:
        Peer(options).show()


if __name__ == "__main__":
    main()
