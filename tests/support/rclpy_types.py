"""What rclpy makes of our messages, and of their types: prints ``{type: [its hash, whether all is alike]}``.

.venv/ros/bin/python tests/support/rclpy_types.py
"""

from __future__ import annotations

import json
from importlib import import_module

import numpy as np
import rclpy
from rclpy.serialization import deserialize_message, serialize_message

from hierax.nodes.ros2.messages import decoded, messages
from hierax.nodes.ros2.tracked import Tracked, diagnosed, meshes, messages_of
from hierax.nodes.sources.calibration import Lens
from support.bags import camera_info, image
from support.topics import joints, transforms


def main() -> None:
    """One message of each type."""
    lens = Lens("", (4, 3), np.array([5.0, 5.0, 2.0, 1.0]), np.zeros(5), False)
    seen = Tracked(3, 7, np.eye(4), np.eye(6), "tracked", {"score": 0.5})
    corners = {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]], np.int32)}
    ours = [message for _, _, message in messages_of({"stamp_ns": 1, "frame_id": "lens"}, [seen], {})]
    ours += [diagnosed(5, "arm", [seen])[2], meshes([{"id": 3, "model": corners}])[2]]
    ours += [image(7, np.arange(36, dtype=np.uint8).reshape(3, 4, 3), "rgb8", pad=2), camera_info(lens)]
    ours += [joints(9, 0.5, 1.5), transforms(3, "map", "lens", (1, 2, 3), (0, 0, 0, 1))]
    rclpy.init()
    node = rclpy.create_node("types")
    found = {}
    for number, message in enumerate(ours):
        kind = message.__msgtype__
        package, name = kind.split("/msg/")
        known = getattr(import_module(f"{package}.msg"), name)
        data = messages().serialize_cdr(message, kind).tobytes()
        theirs = serialize_message(deserialize_message(data, known))
        back = messages().serialize_cdr(decoded(theirs, kind), kind).tobytes()
        publisher = node.create_publisher(known, f"/types{number}", 10)
        (info,) = node.get_publishers_info_by_topic(publisher.topic_name)
        found[kind] = [str(info.topic_type_hash), back == data]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
