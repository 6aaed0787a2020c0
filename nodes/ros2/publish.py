"""What a run of tracking publishes to ROS 2 while it goes on."""

import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hierax.nodes.ros2.carrier import LATCHED, RELIABLE, Address, Carrier, address_of, open_carrier
from hierax.nodes.ros2.messages import TRANSFORMS, messages
from hierax.nodes.ros2.tracked import (
    CAMERA,
    DETECTIONS,
    DIAGNOSTICS,
    MARKERS,
    OK,
    POSE,
    WARN,
    Message,
    diagnosed,
    meshes,
    messages_of,
    status,
    tracked,
)
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.shots import Header
from hierax.nodes.tracking.datasets.objects import read_objects
from hierax.nodes.tracking.schema import TRACKED
from hierax.runtime import Probe, Step

_LOG = logging.getLogger(__name__)


class Published(Probe):
    """Publishes what a node of tracking believes in each epoch. Of an arm: poses, detections, tf and diagnostics, with
    the stamp and the frame of the picture, where that came from ROS. Of a spatial node: the meshes, once, and again
    where they are others. An epoch that is done again is told again.

    Args:
        to: ``ros:/NAMESPACE`` or ``ros+zenoh:/NAMESPACE``; ``?world=FRAME`` has tf tell where the camera is in that
            frame, too, for graphs where nobody else does. None: nothing is published.
        objects: the file with the objects, whose topics are then there from the beginning.
        node: what the node is called.
    """

    def __init__(self, to: str | None = None, objects: str | None = None, node: str = "arm") -> None:
        self._address: Address | None = None if to is None else address_of(to, ("world",))
        self._objects, self._node = objects, node
        self._carrier: Carrier | None = None
        self._publishers: dict[str, Callable[[bytes], object] | None] = {}
        self._frame: int | None = None  # of the newest picture
        self._passed_over = 0
        self._shown: list[Any] = []  # the models whose meshes were published

    def open(self, output: Path | None) -> None:
        """Be there for others. Raises DataError: the carrier cannot be had, or there is no such file."""
        if self._address is None:
            return
        self._carrier = open_carrier(self._address, self._node)
        if self._objects is not None and self._node == "arm":
            for item in read_objects(Path(self._objects)).objects:
                self._publisher(f"object_{item['id']}/pose", POSE)
            for topic, kind in (("detections", DETECTIONS), ("/tf", TRANSFORMS), ("/diagnostics", DIAGNOSTICS)):
                self._publisher(topic, kind)

    def record(self, step: Step) -> None:
        """Publish what the node believes, after its observation."""
        if self._carrier is None or self._address is None:
            return
        if "bodies" in step.sensed:
            models = [body["model"] for body in step.sensed["bodies"]]
            if len(models) != len(self._shown) or any(a is not b for a, b in zip(models, self._shown, strict=True)):
                self._shown = models
                self._publish(meshes(step.sensed["bodies"]))
            return
        camera, objects = tracked(step.sensed)
        header = _header(step)
        if step.observations:
            world = self._address.options.get("world")
            placed = {} if world is None else {(world, header["frame_id"]): camera}
            for message in messages_of(header, objects, placed):
                self._publish(message)
        good = bool(step.observations) and all(item.status == TRACKED for item in objects)
        figures = self._figures(step)
        launch = status(OK if good else WARN, f"hierax: {self._node}", f"epoch {step.epoch}", "hierax", figures)
        self._publish(diagnosed(header["stamp_ns"], self._node, objects, [launch]))

    def close(self) -> None:
        """Be gone."""
        if self._carrier is not None:
            self._carrier.close()
            self._carrier = None
            self._publishers.clear()

    def _figures(self, step: Step) -> Mapping[str, float]:
        if step.observations:
            frame = step.observations[0]["frame"]
            if self._frame is not None:
                self._passed_over += max(frame - self._frame - 1, 0)
            self._frame = frame
        return {
            "epoch": step.epoch,
            "attempt": step.attempt,
            "frame": -1 if self._frame is None else self._frame,
            "passed_over": self._passed_over,
        }

    def _publish(self, message: Message) -> None:
        topic, kind, content = message
        publish = self._publisher(topic, kind)
        if publish is not None:
            publish(messages().serialize_cdr(content, kind).tobytes())

    def _publisher(self, topic: str, kind: str) -> Callable[[bytes], object] | None:
        """Who publishes on a topic; None: the carrier cannot, which is said once."""
        if topic not in self._publishers and self._carrier is not None and self._address is not None:
            name = topic if topic.startswith("/") else f"{self._address.topic}/{topic}"
            try:
                self._publishers[topic] = self._carrier.publisher(name, kind, LATCHED if kind == MARKERS else RELIABLE)
            except DataError as error:
                _LOG.warning("%s is not published: %s", name, error)
                self._publishers[topic] = None
        return self._publishers.get(topic)


def _header(step: Step) -> Header:
    """The picture's, where ROS told one; else the time of publishing."""
    told: Header | None = step.observations[0].get("header") if step.observations else None
    return told or {"stamp_ns": time.time_ns(), "frame_id": CAMERA}
