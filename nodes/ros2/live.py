"""Topics of ROS 2 as live sources: the newest picture of a camera, or the newest of several topics."""

import dataclasses
import math
import time
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from hierax.nodes.ros2.carrier import QOS, Address, Carrier, Qos, address_of, open_carrier
from hierax.nodes.ros2.messages import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    NS,
    TRANSFORMS,
    beside,
    header_of,
    image_of,
    messages,
    told_lens,
)
from hierax.nodes.ros2.topics import Came, Topics
from hierax.nodes.ros2.transforms import Transforms
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.live import Live
from hierax.nodes.sources.shots import Floats, Header, Seen, Shot

_LOOK_S = 0.05  # between looks for somebody who publishes
_TF = Qos(True, False, 100)
_TF_STATIC = Qos(True, True, 100)
_PICTURES = {IMAGE, COMPRESSED}
_OPTIONS = ("qos", "info", "world", "camera")


class LiveTopics(Live):
    """The newest set of messages of several topics, see `Topics`; as what it is shown subclasses say.

    Args: topics: by what they are called; the first counts: of it messages are passed over. within_s: so far others may
        be from it in time.
    """

    def __init__(
        self, topics: Mapping[str, Address], within_s: float, timeout_s: float, reopen: bool, expected: set[str]
    ) -> None:
        first = next(iter(topics.values()))
        super().__init__(first.name, timeout_s, reopen)
        self._addresses = topics
        self._within_ns = round(within_s * NS)
        self._expected = expected  # types of the topics; none: all that are known
        self._lacks = ""
        self._ahead_s = -math.inf  # so far the newest message's stamp was ahead of the monotonic clock when it came

    def _stream(self) -> str:
        shown = 0
        first = next(iter(self._addresses))
        with closing(open_carrier(self._addresses[first], "world")) as carrier:
            topics = Topics(tuple(self._addresses), self._within_ns)
            self._prepare(carrier, topics)
            for name, address in self._addresses.items():
                kind = self._awaited(carrier, address.topic)
                self._kind_is(carrier, topics, name, kind)
                topics.subscribe(carrier, name, address.topic, kind, address.qos)
            self._opened += 1
            while not self._closed.is_set():
                found = topics.newest(self._is_ready, _LOOK_S)
                if found is not None:
                    self._lacks = ""
                    shot = self._shot(found)
                    self._ahead_s = shot.time_s - time.monotonic()
                    self._take(shot, found[first].number - shown)
                    shown = found[first].number
        return "was closed"

    def _idle_s(self, belief: Seen) -> float:
        """By the clock of the stamps, as it goes on from the newest message; until one comes, time stands still."""
        return max(belief["time_s"], self._ahead_s + time.monotonic())

    def _lacking(self) -> str:
        return f"; {self._lacks}" if self._lacks else ""

    def _awaited(self, carrier: Carrier, topic: str) -> str:
        """The type as which a topic is published, once it is. Raises DataError: it is another than what is expected."""
        while not self._closed.is_set():
            kinds = carrier.kinds(topic)
            good = kinds & (self._expected or messages().types.keys())
            if good:
                self._lacks = "messages that belong together do not come" if len(self._addresses) > 1 else ""
                return min(good)
            if kinds:
                expected = " or ".join(sorted(self._expected)) or "one of ROS's common types"
                raise DataError(f"{self.name}: {topic} is of {', '.join(sorted(kinds))}; expected {expected}")
            self._lacks = carrier.unreached() or f"nobody publishes {topic}"
            self._closed.wait(_LOOK_S)
        raise DataError(f"{self.name}: was closed")

    def _prepare(self, carrier: Carrier, topics: Topics) -> None:
        """The carrier is there: what else is to be heard."""

    def _kind_is(self, carrier: Carrier, topics: Topics, name: str, kind: str) -> None:
        """The type of a topic is known."""

    def _is_ready(self, came: Came) -> bool:
        """Whether all is known that goes with a message of the first topic."""
        return True

    def _shot(self, found: Mapping[str, Came]) -> Shot:
        first = next(iter(found.values()))
        heard = {name: plain(f"{self.name}: {name}", each.message) for name, each in found.items()}
        return Shot(0, None, first.stamp_ns / NS, first.arrived_ns / NS, heard=heard)


class TopicFrames(LiveTopics):
    """The pictures of a topic, with CameraInfo and, where the frame of the world is named, the camera's pose by tf.

    Args: name: ``ros:/TOPIC?…``, with ``qos``; ``info``, the topic of the CameraInfo; ``world``, the frame in which the
        camera's pose is looked up; and ``camera``, its own, where the pictures' headers do not name it. calibrated:
        whether the lens is known already, and no CameraInfo waited for.
    Raises DataError: the name says nothing of the kind."""

    def __init__(self, name: str, timeout_s: float, reopen: bool, calibrated: bool) -> None:
        address = address_of_camera(name)
        super().__init__({"image": address}, 0.0, timeout_s, reopen, _PICTURES)
        self._options, self._calibrated = address.options, calibrated
        self._has_info = calibrated
        self._transforms = Transforms()
        self._camera: Floats | None = None  # when the picture was taken that is ready

    def _prepare(self, carrier: Carrier, topics: Topics) -> None:
        if "world" in self._options:
            self._transforms = Transforms()
            for topic, qos in (("/tf_static", _TF_STATIC), ("/tf", _TF)):
                topics.hear(carrier, topic, TRANSFORMS, qos, partial(self._moved, qos.transient_local))

    def _moved(self, is_static: bool, message: Any, _: int) -> None:
        self._transforms.add(message, is_static)

    def _kind_is(self, carrier: Carrier, topics: Topics, name: str, kind: str) -> None:
        if self._calibrated:
            return
        topic = self._addresses[name].topic
        expected, straight = beside(topic, kind == COMPRESSED)
        told = self._options.get("info", expected)

        def came(message: Any, _: int) -> None:
            if not self._has_info:
                self.lens = told_lens(f"{self.name}: {told}", message, straight)
                if self.lens is None:
                    raise DataError(f"{self.name}: {told}: K is zero, so nobody knows the camera; expected calibration")
                self._has_info = True

        topics.hear(carrier, told, CAMERA_INFO, QOS["sensor_data"], came)
        self._lacks = f"no CameraInfo came on {told}"

    def _is_ready(self, came: Came) -> bool:
        if not self._has_info:
            return False
        if "world" not in self._options:
            return True
        self._camera = self._pose(came)  # kept, as transforms go on to come while the picture is decoded
        return self._camera is not None

    def _pose(self, came: Came) -> Floats | None:
        world, camera = self._options["world"], self._options.get("camera", came.message.header.frame_id)
        pose = self._transforms.find(world, camera, came.stamp_ns)
        if pose is None:
            self._lacks = f"tf does not tell where {camera} is in {world} when a picture is taken"
        return pose

    def _shot(self, found: Mapping[str, Came]) -> Shot:
        came = found["image"]
        header: Header = {**header_of(self.name, came.message), "stamp_ns": came.stamp_ns}
        image = image_of(self.name, came.message)
        return Shot(0, image, came.stamp_ns / NS, came.arrived_ns / NS, camera=self._camera, header=header)


def address_of_camera(name: str) -> Address:
    """What a camera's name says. Raises DataError: it is no topic's."""
    return address_of(name, _OPTIONS)


def plain(where: str, message: Any) -> Any:
    """A message as nodes have it: maps by the fields' names, tuples, arrays, numbers and texts; a picture is an array.
    Within another message it is its fields, as it may be empty, or of any encoding. Raises DataError, with `where`: a
    picture is damaged."""
    if getattr(message, "__msgtype__", "") in _PICTURES:
        return {"header": header_of(where, message), "image": image_of(where, message)}
    return _fields(message)


def _fields(message: Any) -> Any:
    if dataclasses.is_dataclass(message):
        names = (each.name for each in dataclasses.fields(message) if each.name != "__msgtype__")
        return {name: _fields(getattr(message, name)) for name in names}
    if isinstance(message, np.ndarray):
        return np.array(message)  # a copy: those of messages are not aligned
    if isinstance(message, list | tuple):
        return tuple(_fields(each) for each in message)
    return message.item() if isinstance(message, np.generic) else message
