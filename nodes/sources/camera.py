"""N₀ over a camera, a video, a folder of images, a bag, a topic or a recording: a frame an epoch, straightened."""

import logging
import math
import re
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hierax.nodes.sources.calibration import read_calibration
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array, check_depth
from hierax.nodes.sources.shots import CameraBelief, Floats, Shot, Source, Told, check_size, read_matrix
from hierax.runtime import World

_LOG = logging.getLogger(__name__)
_MCAP, _SQLITE = b"\x89MCAP", b"SQLite format 3\0"
_ROS_MCAP = re.compile(re.escape(_MCAP) + rb"0\r\n\x01.{8}\x04\0\0\0ros2", re.DOTALL)  # the head, with its profile

Locate = Callable[[Array, Floats, Floats | None, str], Floats | None]
"""Where the camera is, world_from_camera, by a straightened frame, the intrinsics, where it was before, and what the
source is called; None: nobody knows."""


class Picture(Told):
    """What is observed of a camera."""

    image: Array  # uint8, (h, w) gray or (h, w, 3) RGB; uint16 of a world that is `deep`
    camera: Floats  # (4, 4) world_from_camera
    intrinsics: Floats  # (4,) fx, fy, cx, cy in pixels; zeros without a calibration
    frame: int  # its number


def open_source(
    source: str | int,
    fps: float = 30.0,
    timeout_s: float = 5.0,
    reopen: bool = False,
    topic: str | None = None,
    calibrated: bool = False,
) -> Source:
    """What a name stands for: a device's number or path, a stream's URL, a topic of ROS, a folder of images, a
    recording, a rosbag2, or a video.

    Args: fps: of what is played; timeout_s, reopen: of what is live, see `Live`; topic: of a bag, see `BagFrames`;
        calibrated: whether the lens is known, so that none is waited for, nor read in a bag.
    Raises DataError: there is no such file, or it cannot be opened."""
    from hierax.nodes.sources.live import Captured
    from hierax.nodes.sources.played import Folder, Video

    path = Path(str(source))
    if is_ros(source):
        from hierax.nodes.ros2.live import TopicFrames

        return TopicFrames(str(source), timeout_s, reopen, calibrated)
    if is_bag(source):
        from hierax.nodes.ros2.bag import BagFrames

        return BagFrames(path, topic, calibrated)
    if topic is not None:
        raise DataError(f"{source}: is no bag of ROS 2; expected no topic (camera_topic of tracking) with it")
    if str(source).isdecimal():
        return Captured(int(source), timeout_s, reopen)
    if "://" in str(source) or path.is_char_device():
        return Captured(str(source), timeout_s, reopen)
    if path.is_dir():
        return Folder(path, fps)
    if not path.is_file():
        expected = "a device's number, a video, a folder of images, a recording, a bag, a topic, or a stream's URL"
        raise DataError(f"{path}: no such file; expected {expected}")
    if is_recording(source):
        from hierax.nodes.sources.recorded import RecordedFrames

        return RecordedFrames(path)
    return Video(path, fps)


def is_ros(source: str | int) -> bool:
    """Whether a source is a topic of ROS, see `hierax.nodes.ros2.carrier`."""
    return str(source).startswith(("ros:", "ros+zenoh:"))


def is_recording(source: str | int) -> bool:
    """Whether a source is a recording: an MCAP file that is no bag."""
    return _head(source).startswith(_MCAP) and not is_bag(source)


def is_bag(source: str | int) -> bool:
    """Whether a source is a rosbag2: a folder with its metadata, or a file of its own, MCAP of ROS 2 or SQLite."""
    head = _head(source)
    in_file = head.startswith(_SQLITE) or _ROS_MCAP.match(head) is not None
    return in_file or Path(str(source), "metadata.yaml").is_file()


def knows_camera(source: str | int, topic: str | None = None) -> bool:
    """Whether a source tells its camera matrix: a recording, a topic of ROS, and a bag with CameraInfo. Raises
    DataError: it is a bag, and cannot be read."""
    if not is_bag(source):
        return is_recording(source) or is_ros(source)
    bag = open_source(source, topic=topic)
    bag.close()
    return bag.lens is not None


def tells_pose(source: str | int) -> bool:
    """Whether a source tells where the camera is, as a topic does whose name says in which frame. Raises DataError: it
    is misnamed."""
    if not is_ros(source):
        return False
    from hierax.nodes.ros2.live import address_of_camera

    return "world" in address_of_camera(str(source)).options


def _head(source: str | int) -> bytes:
    path = Path(str(source))
    if not path.is_file():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(32)
    except OSError:
        return b""  # who opens it says so


class CameraWorld(World):
    """Shows a source's frames, see `CameraBelief`. What is played shows every frame and then ends; of what is live the
    newest is shown, and those that were passed over are counted. The frame is part of the belief, and so of its
    checkpoint: an epoch that is done again sees the same one.

    Args:
        source: as for `open_source`; it is opened when the first frame is asked for.
        calibration: file with the lens's, see `hierax.nodes.sources.calibration`; None: a bag's CameraInfo tells it,
            frames of others stay as they are.
        fps: frames per second of what is played; source_timeout: seconds without a frame until a live source stalls.
        reopen: whether a live source that ends, stalls or is unplugged is opened again, in growing pauses, with nothing
            observed meanwhile; else that is an error.
        pose: world_from_camera, 4 × 4; None: the world is the camera's.
        locate: tells the camera's pose by each frame, in place of `pose`; until it does, nothing is observed.
        topic: of a bag that has pictures on several.
        straighten: false leaves frames as they were taken.
        deep: whether pictures of 16 bits, as depth has them, are shown as well; else they are an error.

    Raises DataError: the calibration is missing or damaged. ValueError: an option is out of range."""

    def __init__(
        self,
        source: str | int,
        calibration: str | None = None,
        fps: float = 30.0,
        source_timeout: float = 5.0,
        reopen: bool = False,
        pose: list[list[float]] | None = None,
        locate: Locate | None = None,
        topic: str | None = None,
        straighten: bool = True,
        deep: bool = False,
    ) -> None:
        for name, value in (("fps", fps), ("source_timeout", source_timeout)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} is {value}; expected a positive number")
        self._name = source
        self._options = (float(fps), float(source_timeout), reopen, topic, calibration is not None or not straighten)
        self._straighten, self._deep = straighten, deep
        self._lens = None if calibration is None else read_calibration(Path(calibration))
        self._pose = np.eye(4) if pose is None else read_matrix("pose", pose)
        self._locate = locate
        self._opened: Source | None = None

    def initial_belief(self) -> CameraBelief:
        """The first frame is yet to be seen; the source is opened for it."""
        self._source()
        lens = self._lens
        return self._next(
            {
                "index": 0,
                "frame": -1,
                "image": None,
                "size": None if lens is None else lens.size,
                "camera": None if self._locate is not None else self._pose,
                "intrinsics": np.zeros(4) if lens is None else lens.intrinsics,
                "time_s": 0.0,
                "wall_s": None,
                "passed_over": 0,
                "stalls": 0,
                "reopened": 0,
                "ended": False,
            }
        )

    def predict(self, context: tuple[()], actions: tuple[()], belief: CameraBelief) -> CameraBelief:
        """Time passes: the next frame. After the last one there is none."""
        return belief if belief["ended"] else self._next({**belief, "index": belief["index"] + 1})

    def time_s(self, belief: CameraBelief, epoch: int) -> float:
        """When the frame was taken."""
        return belief["time_s"]

    def finished(self, belief: CameraBelief) -> bool:
        """Whether all frames have been seen."""
        return belief["ended"]

    def metrics(self, belief: CameraBelief) -> Mapping[str, float]:
        """How many frames were passed over, epochs had none, and how often the source was opened again."""
        return {name: float(belief[name]) for name in ("passed_over", "stalls", "reopened")}

    def _next(self, belief: CameraBelief) -> CameraBelief:
        """The belief with the frame of its index."""
        source = self._source()
        shot = source.shot(belief)
        stalled = shot.image is None and not shot.ended
        if stalled and (belief["image"] is not None or not belief["index"]):
            _LOG.warning("%s: no frame; nothing is observed until one comes", source.name)
        if shot.image is not None and belief["image"] is None and belief["stalls"]:
            _LOG.warning("%s: frames come again; %d epochs had none, in all", source.name, belief["stalls"])
        after: CameraBelief = {
            **belief,
            "frame": shot.frame,
            "image": None,
            "time_s": shot.time_s,
            "wall_s": shot.wall_s,
            "passed_over": belief["passed_over"] + shot.passed_over,
            "stalls": belief["stalls"] + stalled,
            "reopened": shot.reopened,
            "ended": shot.ended,
        }
        if shot.ended and belief["camera"] is None:
            _LOG.warning("%s: has ended, and no frame told where the camera is, so nothing was observed", source.name)
        if shot.image is None:
            return after
        return self._with_picture(after, shot, shot.image, source)

    def _with_picture(self, belief: CameraBelief, shot: Shot, taken: Array, source: Source) -> CameraBelief:
        if self._straighten:
            self._lens = self._lens or source.lens  # a topic's is known with its first picture
        size = belief["size"] if belief["size"] is not None or self._lens is None else self._lens.size
        place = shot.place or source.name
        check_size(place, taken, size)
        if not self._deep:
            check_depth(place, taken)
        height, width = taken.shape[:2]
        image = taken if self._lens is None else self._lens.straightened(taken)
        camera, intrinsics = belief["camera"], belief["intrinsics"] if self._lens is None else self._lens.intrinsics
        if shot.intrinsics is not None:
            intrinsics = shot.intrinsics
        if shot.camera is not None:
            camera = shot.camera
        elif self._locate is not None:
            camera = self._locate(image, intrinsics, camera, source.name)
        after: CameraBelief = {**belief, "image": image, "size": (width, height), "camera": camera}
        after["intrinsics"] = intrinsics
        if shot.header is not None:
            after["header"] = shot.header
        return after

    def _source(self) -> Source:
        if self._opened is None:
            self._opened = open_source(self._name, *self._options)
            weakref.finalize(self, self._opened.close)
            if self._straighten:
                self._lens = self._lens or self._opened.lens
            if self._opened.straight and (self._lens is not None or self._locate is not None):
                what = "is a recording, whose frames are straightened and whose camera is known"
                raise DataError(f"{self._name}: {what}; expected no calibration and no tag with it")
        return self._opened


def picture_seen(belief: CameraBelief) -> tuple[Picture, ...]:
    """φ of a `CameraWorld`: one element, the frame and what its camera is known to be; none where no frame came, or
    nobody knows where the camera is."""
    image, camera = belief["image"], belief["camera"]
    if image is None or camera is None:
        return ()
    seen: Picture = {"image": image, "camera": camera, "intrinsics": belief["intrinsics"], "frame": belief["frame"]}
    if "header" in belief:
        seen["header"] = belief["header"]
    return (seen,)
