"""Topics of ROS on the loopback, by Zenoh: a router, and somebody who publishes, with `rosbags` definitions alone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from hierax.nodes.ros2.carrier import QOS, Carrier, Qos, address_of, open_carrier
from support.bags import STORE, made


@contextmanager
def router() -> Iterator[str]:
    """Zenoh's router on the loopback; its host and port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        where = f"127.0.0.1:{free.getsockname()[1]}"
    config = f'{{mode: "router", listen: {{endpoints: ["tcp/{where}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
    session = zenoh.open(zenoh.Config.from_json5(config))
    try:
        yield where
    finally:
        session.close()  # type: ignore[no-untyped-call]


def stamped(message: Any, stamp_ns: int, frame: str = "lens") -> Any:
    """The message with another stamp and frame."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = frame
    return message


def transforms(stamp_ns: int, frame: str, child: str, place: Sequence[float], turn: Sequence[float]) -> Any:
    """A `TFMessage` of one transform; turn: x, y, z, w."""
    moved = made(
        "geometry_msgs/msg/Transform",
        translation=made("geometry_msgs/msg/Vector3", **dict(zip("xyz", place, strict=True))),
        rotation=made("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True))),
    )
    stamp = made("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
    each = made("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=moved)
    return made("tf2_msgs/msg/TFMessage", transforms=[each])


def joints(stamp_ns: int, *angles: float) -> Any:
    return made(
        "sensor_msgs/msg/JointState",
        header=transforms(stamp_ns, "base", "", (0, 0, 0), (0, 0, 0, 1)).transforms[0].header,
        name=[f"joint_{number}" for number in range(len(angles))],
        position=np.array(angles),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )


class Talker:
    """Publishes and hears by a carrier of its own."""

    def __init__(self, where: str) -> None:
        self.carrier: Carrier = open_carrier(address_of(f"ros+zenoh://{where}/tests", ()), "talker")
        self._publishers: dict[str, Callable[[bytes], object]] = {}
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        self.sent = 0

    def __enter__(self) -> Talker:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self.carrier.close()

    def say(self, topic: str, message: Any, qos: Qos = QOS["reliable"]) -> None:
        kind = message.__msgtype__
        if topic not in self._publishers:
            self._publishers[topic] = self.carrier.publisher(topic, kind, qos)
        self._publishers[topic](STORE.serialize_cdr(message, kind).tobytes())

    def hear(self, topic: str, kind: str, qos: Qos = QOS["reliable"]) -> list[Any]:
        """The messages that come, as they come."""
        from hierax.nodes.ros2.messages import messages

        heard: list[Any] = []
        self.carrier.subscribe(topic, kind, qos, lambda data, _: heard.append(messages().deserialize_cdr(data, kind)))
        return heard

    def keep_on(self, rate_hz: float, say: Callable[[int], object]) -> None:
        """Say something over and over in a thread, with the next number."""

        def go_on() -> None:
            while not self._over.wait(1.0 / rate_hz):
                number, self.sent = self.sent, self.sent + 1
                say(number)

        self._thread = threading.Thread(target=go_on, daemon=True)
        self._thread.start()
