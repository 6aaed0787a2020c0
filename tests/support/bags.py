"""Bags of ROS 2 as another program writes them, with `rosbags` alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hierax.nodes.sources.calibration import Lens
from hierax.nodes.sources.images import Array

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
STRING = "std_msgs/msg/String"


def made(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(stamp_ns: int) -> Any:
    stamp = made("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id="camera")


def image(stamp_ns: int, data: Array, encoding: str, pad: int = 0, **changes: Any) -> Any:
    """An Image of rows as they are, each with so many bytes more behind it."""
    height, width = data.shape[:2]
    rows = np.pad(data.reshape(height, -1), ((0, 0), (0, pad)), constant_values=77)
    fields = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": rows.shape[1]}
    return made(IMAGE, header=header(stamp_ns), **(fields | {"data": rows.reshape(-1)} | changes))


def compressed(stamp_ns: int, rgb: Array, suffix: str = ".png") -> Any:
    _, content = cv2.imencode(suffix, np.ascontiguousarray(rgb[..., ::-1]))
    return made(COMPRESSED, header=header(stamp_ns), format=suffix[1:], data=content.reshape(-1))


def camera_info(lens: Lens, model: str = "plumb_bob") -> Any:
    roi = made("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    fields: dict[str, Any] = {"width": lens.size[0], "height": lens.size[1], "distortion_model": model}
    fields |= {"d": lens.coefficients, "k": lens.matrix.ravel(), "r": np.eye(3).ravel()}
    fields |= {"p": np.hstack([lens.matrix, np.zeros((3, 1))]).ravel(), "binning_x": 0, "binning_y": 0, "roi": roi}
    return made(INFO, header=header(0), **fields)


def write_bag(folder: Path, topics: dict[str, Sequence[Any]], storage: str = "mcap", step_ns: int = 40_000_000) -> Path:
    """A bag with the messages of each topic, recorded at equal steps."""
    with Writer(folder, version=8, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__ if messages else IMAGE
            connection = bag.add_connection(topic, kind, typestore=STORE)
            for number, message in enumerate(messages):
                bag.write(connection, 10**18 + step_ns * number, STORE.serialize_cdr(message, kind))
    return folder
