"""A recording of tracking as a rosbag2: pictures, the camera, poses, frames and what is known of each object."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hierax.nodes.ros2.messages import CAMERA_INFO, IMAGE, NS, made, messages, require_rosbags
from hierax.nodes.sources.calibration import PINHOLE
from hierax.nodes.sources.files import DataError, writing
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.recorded import shot_of
from hierax.nodes.sources.shots import Floats, Shot, lens_matrix
from hierax.nodes.tracking.math.geometry import quaternion_of
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.trace import EpochTrace
from hierax.schemas.errors import SchemaError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Writer

WORLD, CAMERA = "world", "camera"  # frame ids; the camera's is the optical one, x right, y down, z forward
_LEVELS = {TRACKED: 0, EXPECTED: 1, LOST: 2}  # OK, WARN, ERROR
_FIGURES = ("score", "probability", "nats")
_METADATA, _STORAGE = "metadata.yaml", ".mcap"
_MAX_S = 2**31


class _Object(NamedTuple):
    """What a node believes of an object."""

    id: int
    pose: Floats  # camera_from_object
    status: str
    figures: Mapping[str, float]


def export_rosbag(path: Path, folder: Path, poses: str = "arm", overwrite: bool = False) -> Mapping[str, int]:
    """Write a rosbag2 (MCAP) of a recording whose world shows pictures.

    Args: path: the recording; folder: the bag's; poses: the node that believes the poses, `ArmNode` or like it;
        overwrite: replace a bag that is there.
    Returns: how many messages there are on each topic.
    Raises DataError: the recording lacks what a bag is made of, or the folder is there already, is no bag's, or cannot
        be written.
    """
    require_rosbags(folder)
    try:
        recording = Recording.open(path)
        with _replacing(folder, overwrite) as bag:
            topics = _Topics(bag)
            for epoch in recording.epochs():
                _write_epoch(topics, str(path), epoch, poses)
            if not topics.counts:
                raise DataError(f"{path}: has no epochs; expected some to export")
            return topics.counts
    except DataError:
        raise
    except (HieraxError, SchemaError) as error:
        raise DataError(str(error)) from error


class _Topics:
    """The topics of a bag that is being written; a topic begins with its first message."""

    def __init__(self, bag: Writer) -> None:
        self._bag = bag
        self._known: dict[str, Connection] = {}
        self.counts: Counter[str] = Counter()

    def write(self, topic: str, stamp_ns: int, kind: str, **fields: Any) -> None:
        """Write a message at its time."""
        if topic not in self._known:
            self._known[topic] = self._bag.add_connection(topic, kind, typestore=messages())
        self._bag.write(self._known[topic], stamp_ns, messages().serialize_cdr(made(kind, **fields), kind))
        self.counts[topic] += 1


def _write_epoch(topics: _Topics, name: str, epoch: EpochTrace, poses: str) -> None:
    where = f"{name}: epoch {epoch.epoch}"
    shot, (camera, objects) = shot_of(name, epoch), _believed(where, epoch, poses)
    if not 0.0 <= shot.time_s < _MAX_S:
        raise DataError(f"{where}: its time is {shot.time_s} s; expected one from 0 to 2³¹, as ROS has them")
    stamp_ns = round(shot.time_s * NS)
    if shot.image is not None:
        _write_picture(topics, where, stamp_ns, shot, shot.image)
        transforms = [_transform(stamp_ns, WORLD, CAMERA, shot.camera if camera is None else camera)]
        for item in objects:
            if item.status != LOST:
                position, turn = _place(item.pose)
                pose = made("geometry_msgs/msg/Pose", position=_point("Point", position), orientation=turn)
                header = _header(stamp_ns, CAMERA)
                topics.write(
                    f"/object_{item.id}/pose", stamp_ns, "geometry_msgs/msg/PoseStamped", header=header, pose=pose
                )
                transforms.append(_transform(stamp_ns, CAMERA, f"object_{item.id}", item.pose))
        topics.write("/tf", stamp_ns, "tf2_msgs/msg/TFMessage", transforms=transforms)
    told = [_status(poses, item) for item in objects]
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    topics.write("/diagnostics", stamp_ns, kind, header=_header(stamp_ns, ""), status=told)


def _write_picture(topics: _Topics, where: str, stamp_ns: int, shot: Shot, image: Array) -> None:
    if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)) or not image.size:
        raise DataError(f"{where}: image: expected gray (h, w) or RGB (h, w, 3), got {image.shape}")
    height, width = image.shape[:2]
    fields = {
        "header": _header(stamp_ns, CAMERA),
        "height": height,
        "width": width,
    }
    topics.write(
        "/camera/image_rect",
        stamp_ns,
        IMAGE,
        **fields,
        encoding="mono8" if image.ndim == 2 else "rgb8",
        is_bigendian=0,
        step=image[0].size,
        data=np.ascontiguousarray(image).reshape(-1),
    )
    known = shot.intrinsics is not None and shot.intrinsics.any()  # a K of zeros says that nobody knows
    matrix = lens_matrix(shot.intrinsics) if known and shot.intrinsics is not None else np.zeros((3, 3))
    roi = made("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    topics.write(
        "/camera/camera_info",
        stamp_ns,
        CAMERA_INFO,
        **fields,
        distortion_model=PINHOLE,
        d=np.zeros(5),
        k=matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([matrix, np.zeros((3, 1))]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def _believed(where: str, epoch: EpochTrace, node: str) -> tuple[Floats | None, list[_Object]]:
    """Where a node believes the camera and the objects to be, after it has seen the picture."""
    if node not in epoch.roster.nodes:
        known = ", ".join(sorted(epoch.roster.nodes.keys() - {epoch.roster.world}))
        raise DataError(f"{where}: there is no node {node}; expected --poses NODE, one of {known}")
    sensed = epoch.sensed_of(node)
    if sensed is None:
        raise DataError(f"{where}: lacks what {node} believed; expected its belief after the picture")
    try:
        belief = sensed[0]
        camera = None if belief["camera"] is None else _pose(belief["camera"])
        objects = [
            _Object(int(item["id"]), _pose(item["pose"]), str(item["status"]), _figures(item))
            for item in belief["objects"]
        ]
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        what = "camera, and objects with id, pose and status, as an arm of tracking has them"
        raise DataError(f"{where}: {node} believes no poses; expected {what}") from error
    return camera, objects


def _pose(value: Any) -> Floats:
    pose = np.asarray(value, np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("no pose")
    return pose


def _figures(item: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(item[name]) for name in _FIGURES if name in item}


def _header(stamp_ns: int, frame: str) -> Any:
    seconds, rest = divmod(stamp_ns, NS)
    return made(
        "std_msgs/msg/Header", stamp=made("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest), frame_id=frame
    )


def _point(kind: str, numbers: Floats) -> Any:
    x, y, z = numbers.tolist()
    return made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _place(pose: Floats) -> tuple[Floats, Any]:
    x, y, z, w = quaternion_of(pose[:3, :3]).tolist()
    return pose[:3, 3], made("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _transform(stamp_ns: int, frame: str, child: str, pose: Floats | None) -> Any:
    position, turn = _place(np.eye(4) if pose is None else pose)
    moved = made("geometry_msgs/msg/Transform", translation=_point("Vector3", position), rotation=turn)
    return made(
        "geometry_msgs/msg/TransformStamped",
        header=_header(stamp_ns, frame),
        child_frame_id=child,
        transform=moved,
    )


def _status(node: str, item: _Object) -> Any:
    values = [made("diagnostic_msgs/msg/KeyValue", key=key, value=repr(each)) for key, each in item.figures.items()]
    return made(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_LEVELS.get(item.status, 3),
        name=f"{node}: object {item.id}",
        message=item.status,
        hardware_id=f"object_{item.id}",
        values=values,
    )


@contextmanager
def _replacing(folder: Path, overwrite: bool) -> Iterator[Writer]:
    """A bag that stands in the folder when it is whole, and not before."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

    if folder.exists() or folder.is_symlink():
        _check_replaceable(folder, overwrite)
    place = folder.absolute()
    with writing(folder):
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            dir=place.parent, prefix=f".{place.name}.", ignore_cleanup_errors=True
        ) as made_in:
            unfinished = Path(made_in, place.name)
            bag = Writer(unfinished, version=8, storage_plugin=StoragePlugin.MCAP)
            bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with bag:
                yield bag
            if folder.exists():
                shutil.rmtree(folder)
            unfinished.rename(folder)


def _check_replaceable(folder: Path, overwrite: bool) -> None:
    if not overwrite:
        raise DataError(f"{folder}: is there already; --overwrite replaces it, or name another folder")
    names = [each.name for each in folder.iterdir()] if folder.is_dir() else [folder.name]
    if folder.is_symlink() or not all(name == _METADATA or name.endswith(_STORAGE) for name in names):
        raise DataError(f"{folder}: has other files than a bag's; expected a folder that --rosbag wrote")
