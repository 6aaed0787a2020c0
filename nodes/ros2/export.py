"""A recording of tracking as a rosbag2: pictures, the camera, poses, frames and what is known of each object."""

import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hierax.nodes.ros2.messages import CAMERA_INFO, IMAGE, NS, made, messages, require
from hierax.nodes.ros2.tracked import CAMERA, WORLD, Tracked, diagnosed, messages_of, stamped, tracked
from hierax.nodes.sources.calibration import PINHOLE
from hierax.nodes.sources.files import DataError, writing
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.recorded import shot_of
from hierax.nodes.sources.shots import MAX_STAMP_NS, Floats, Header, Shot, lens_matrix
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.trace import EpochTrace
from hierax.schemas.errors import SchemaError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Writer

_LOG = logging.getLogger(__name__)
_METADATA, _STORAGE = "metadata.yaml", ".mcap"


class Exported(NamedTuple):
    """What a bag holds."""

    counts: Mapping[str, int]  # of messages, by topic
    lacking: int  # epochs of which nobody knows what was believed: their pictures stand without poses


def export_rosbag(path: Path, folder: Path, poses: str = "arm", overwrite: bool = False) -> Exported:
    """Write a rosbag2 (MCAP) of a recording whose world shows pictures. What the recording lacks has a line in the log.

    Args: path: the recording; folder: the bag's; poses: the node that believes the poses, `ArmNode` or like it;
        overwrite: replace a bag that is there.
    Raises DataError: the recording lacks what a bag is made of, or the folder is there already, is no bag's, or cannot
        be written.
    """
    require("rosbags.rosbag2", folder)
    try:
        recording = Recording.open(path)
        if recording.loss:
            _LOG.warning("%s: %s", path, recording.loss)
        with _replacing(folder, overwrite) as bag:
            topics = _Topics(bag)
            told = [_write_epoch(topics, str(path), epoch, poses) for epoch in recording.epochs()]
            if not told:
                raise DataError(f"{path}: has no epochs; expected some to export")
            if not any(told):
                raise DataError(f"{path}: lacks what {poses} believed; expected its belief after the picture")
            return Exported(topics.counts, told.count(False))
    except DataError:
        raise
    except (HieraxError, SchemaError) as error:
        raise DataError(str(error)) from error


class _Topics:
    """The topics of a bag that is being written; a topic begins with its first message."""

    def __init__(self, bag: "Writer") -> None:
        self._bag = bag
        self._known: dict[str, Connection] = {}
        self.counts: Counter[str] = Counter()

    def write(self, stamp_ns: int, topic: str, kind: str, message: Any) -> None:
        """Write a message at its time."""
        name = "/" + topic.lstrip("/")
        if name not in self._known:
            self._known[name] = self._bag.add_connection(name, kind, typestore=messages())
        self._bag.write(self._known[name], stamp_ns, messages().serialize_cdr(message, kind))
        self.counts[name] += 1


def _write_epoch(topics: _Topics, name: str, epoch: EpochTrace, poses: str) -> bool:
    """Write what there is of an epoch; whether it is known what was believed: a process that dies may leave a gap."""
    where = f"{name}: epoch {epoch.epoch}"
    shot, believed = shot_of(name, epoch), _believed(where, epoch, poses)
    if not 0.0 <= shot.time_s < MAX_STAMP_NS / NS:
        raise DataError(f"{where}: its time is {shot.time_s} s; expected one from 0 to 2³¹, as ROS has them")
    header: Header = shot.header or {"stamp_ns": round(shot.time_s * NS), "frame_id": CAMERA}
    stamp_ns, frame = header["stamp_ns"], header["frame_id"]
    if shot.image is not None:
        _write_picture(topics, where, header, shot, shot.image)
    if believed is None:
        return False
    camera, objects = believed
    if shot.image is not None:
        for message in messages_of(header, objects, {(WORLD, frame): shot.camera if camera is None else camera}):
            topics.write(stamp_ns, *message)
    topics.write(stamp_ns, *diagnosed(stamp_ns, poses, objects))
    return True


def _write_picture(topics: _Topics, where: str, header: Header, shot: Shot, image: Array) -> None:
    if image.dtype != np.uint8 and image.ndim == 3:
        raise DataError(f"{where}: image: has 16 bits and colours; expected gray, or 8 bits")
    encoding = "rgb8" if image.ndim == 3 else "mono8" if image.dtype == np.uint8 else "16UC1"
    height, width = image.shape[:2]
    fields = {"header": stamped(**header), "height": height, "width": width}
    picture = made(
        IMAGE,
        **fields,
        encoding=encoding,
        is_bigendian=0,
        step=image[0].nbytes,
        data=np.ascontiguousarray(image).astype(image.dtype.newbyteorder("<")).reshape(-1).view(np.uint8),
    )
    topics.write(header["stamp_ns"], "/camera/image_rect", IMAGE, picture)
    known = shot.intrinsics is not None and shot.intrinsics.any()  # a K of zeros says that nobody knows
    matrix = lens_matrix(shot.intrinsics) if known and shot.intrinsics is not None else np.zeros((3, 3))
    roi = made("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    info = made(
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
    topics.write(header["stamp_ns"], "/camera/camera_info", CAMERA_INFO, info)


def _believed(where: str, epoch: EpochTrace, node: str) -> tuple[Floats | None, list[Tracked]] | None:
    """Where a node believes the camera and the objects to be, after it has seen the picture; None: that lacks."""
    if node not in epoch.roster.nodes:
        known = ", ".join(sorted(epoch.roster.nodes.keys() - {epoch.roster.world}))
        raise DataError(f"{where}: there is no node {node}; expected --poses NODE, one of {known}")
    sensed = epoch.sensed_of(node)
    if sensed is None:
        return None
    try:
        return tracked(sensed[0])
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        what = "camera, and objects with id, pose and status, as an arm of tracking has them"
        raise DataError(f"{where}: {node} believes no poses; expected {what}") from error


@contextmanager
def _replacing(folder: Path, overwrite: bool) -> "Iterator[Writer]":
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
    names = {each.name for each in folder.iterdir()} if folder.is_dir() else {folder.name}
    is_bag = _METADATA in names and names <= {_METADATA, f"{folder.absolute().name}{_STORAGE}"}
    if folder.is_symlink() or (names and not is_bag):
        raise DataError(f"{folder}: has other files than a bag's; expected a folder that --rosbag wrote")
