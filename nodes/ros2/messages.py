"""ROS's messages, by the package `rosbags`, which has their definitions, their type hashes and CDR."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hierax.nodes.sources.calibration import Lens, lens_of
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import MAX_PIXELS, Array, decode_image
from hierax.nodes.sources.shots import Header

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
NS = 1_000_000_000  # nanoseconds in a second

_VISION = {  # vision_msgs 4, which rosbags has not
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id",
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}

_LAYOUTS: dict[str, tuple[int, int | None]] = {  # bytes a pixel, and OpenCV's way from there to gray or RGB
    "mono8": (1, None),
    "8UC1": (1, None),
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "16UC1": (2, None),
    "mono16": (2, None),
}


def require(module: str, where: object) -> None:
    """See that a package is there. Raises DataError if it lacks, which names what asks for it."""
    try:
        import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        raise DataError(f"{where}: this needs the package {package}: pip install 'hierax[ros2]'") from error


@contextmanager
def reading(where: str, expected: str) -> Iterator[None]:
    """`DataError` for whatever rosbags raises meanwhile, as a file or message is damaged, with what was to be whole."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise DataError(f"{where}: cannot be read: {said:.200}; expected a whole {expected}") from error


@cache
def messages() -> "Typestore":
    """The definitions of ROS's messages; those used here are alike in all distributions from Humble on."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, definition in _VISION.items():
        store.register(get_types_from_msg(definition, f"vision_msgs/msg/{name}"))
    return store


def made(kind: str, **fields: Any) -> Any:
    """A message of a type such as ``geometry_msgs/msg/Point``."""
    return messages().types[kind](**fields)


def decoded(data: bytes, kind: str) -> Any:
    """A message of its CDR. Fast DDS may leave up to 8 bytes behind it, where its last sequences are empty. Raises what
    rosbags does where it is damaged."""
    from rosbags.serde import SerdeError

    for spare in (0, 4, 8):
        with suppress(SerdeError):
            return messages().deserialize_cdr(data[: len(data) - spare], kind)
    return messages().deserialize_cdr(data, kind)


def image_of(where: str, message: Any) -> Array:
    """The picture of an Image or CompressedImage as nodes have it: uint8, (h, w) gray or (h, w, 3) RGB; of 16 bits, as
    depth has them, uint16. Raises DataError, with `where`: it is damaged, or has another encoding."""
    if not hasattr(message, "encoding"):
        return decode_image(where, message.data.tobytes())
    if message.encoding not in _LAYOUTS:
        raise DataError(f"{where}: encoding {message.encoding!r:.40}; expected one of {', '.join(_LAYOUTS)}")
    channels, conversion = _LAYOUTS[message.encoding]
    height, width, step = message.height, message.width, message.step
    if not 0 < width * height <= MAX_PIXELS:
        raise DataError(f"{where}: has {width}×{height} pixels; expected at least one, and at most {MAX_PIXELS}")
    if step < width * channels or len(message.data) != step * height:
        told = f"{len(message.data)} bytes in rows of {step}"
        raise DataError(f"{where}: has {told}; expected {height} rows of at least {width * channels}")
    rows = message.data.reshape(height, step)[:, : width * channels]
    if channels == 2:  # bytes of one of 16 bits
        order = ">u2" if message.is_bigendian else "<u2"
        return np.ascontiguousarray(rows).view(order).astype(np.uint16)
    pixels = np.ascontiguousarray(rows.reshape(height, width, channels) if channels > 1 else rows)
    if conversion is None:
        return pixels
    if message.encoding.startswith("bayer") and min(width, height) < 3:
        raise DataError(f"{where}: has {width}×{height} pixels; expected at least 3×3 of {message.encoding}")
    return np.asarray(cv2.cvtColor(pixels, conversion))


def header_of(where: str, message: Any) -> Header:
    """The stamp and the frame of a message. Raises DataError: its stamp is no time."""
    stamp = message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= NS:
        raise DataError(f"{where}: header.stamp is {stamp.sec} s, {stamp.nanosec} ns; expected a time since 1970")
    return {"stamp_ns": int(stamp.sec) * NS + int(stamp.nanosec), "frame_id": str(message.header.frame_id)}


def told_lens(where: str, info: Any, straight: bool) -> Lens | None:
    """The lens of a CameraInfo, or, where pictures are straight already, the camera of its P; None: it says that nobody
    knows. Raises DataError, with `where`: it is no camera's."""
    if not info.k.any():
        return None
    content = {
        "image_width": info.width,
        "image_height": info.height,
        "K": (info.p.reshape(3, 4)[:, :3].ravel() if straight else info.k).tolist(),
        "D": [] if straight else np.asarray(info.d).tolist(),
        "distortion_model": info.distortion_model,
    }
    return lens_of(where, content)


def beside(topic: str, compressed: bool) -> tuple[str, bool]:
    """The topic on which a topic with pictures has its CameraInfo, and whether its name says that they are straight."""
    place, _, name = topic.rpartition("/")
    if compressed and name == "compressed":
        place, _, name = place.rpartition("/")
    return f"{place}/camera_info", name.startswith("image_rect")
