"""What carries messages of ROS 2 to this process and from it: one interface, and the names by which topics go.

``ros:/camera/image_raw`` is a topic as `rclpy` has it, for users inside ROS. ``ros+zenoh:/camera/image_raw`` is one of
`rmw_zenoh`, with none of ROS installed; ``ros+zenoh://HOST:PORT/…`` tells where its router is. Behind a ``?`` options
follow, with ``&`` between them."""

import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

from hierax.nodes.ros2.messages import require
from hierax.nodes.sources.files import DataError

RCLPY, ZENOH = "ros", "ros+zenoh"
_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_MAX_DOMAIN = 232

Heard = Callable[[bytes, int], None]
"""Is told of a message, in a thread of the carrier's: its CDR, and when it was sent, or came, ns since 1970."""


class Qos(NamedTuple):
    """What a publisher offers, or a subscription asks for."""

    reliable: bool
    transient_local: bool
    depth: int


QOS = {
    "sensor_data": Qos(False, False, 5),
    "reliable": Qos(True, False, 10),
    "transient_local": Qos(True, True, 1),
}
RELIABLE, LATCHED = QOS["reliable"], QOS["transient_local"]


class Address(NamedTuple):
    """What a name such as ``ros:/camera/image_raw?qos=reliable`` says."""

    name: str
    carrier: str  # `RCLPY` or `ZENOH`
    router: str | None  # host and port of Zenoh's
    topic: str  # or a namespace; with a slash in front
    options: Mapping[str, str]

    @property
    def qos(self) -> Qos:
        """As the option says; ``sensor_data`` where it is not there, with which every publisher is content."""
        return QOS[self.options.get("qos", "sensor_data")]


def address_of(name: str, known: tuple[str, ...]) -> Address:
    """What a name says. Raises DataError: it is no topic's, or has other options than those known."""
    carrier, _, rest = name.partition(":")
    try:
        parts = urlsplit(rest)
        options = dict(parse_qsl(parts.query, strict_parsing=True)) if parts.query else {}
    except ValueError as error:
        raise DataError(f"{name}: {error}; expected {carrier}:/TOPIC?OPTION=VALUE&…") from error
    topic = "/" + parts.path.strip("/")
    if carrier not in (RCLPY, ZENOH) or not _TOPIC.fullmatch(topic) or (carrier == RCLPY and parts.netloc):
        raise DataError(f"{name}: expected ros:/TOPIC, ros+zenoh:/TOPIC or ros+zenoh://HOST:PORT/TOPIC")
    wrong = [option for option in options if option not in known]
    if wrong:
        raise DataError(f"{name}: {wrong[0]!r:.40}: expected one of the options {', '.join(known)}")
    if options.get("qos", "sensor_data") not in QOS:
        raise DataError(f"{name}: qos is {options['qos']!r:.40}; expected one of {', '.join(QOS)}")
    if not _TOPIC.fullmatch(options.get("info", topic)):
        raise DataError(f"{name}: info is {options['info']!r:.40}; expected a topic with a slash in front")
    return Address(name, carrier, parts.netloc or None, topic, options)


def domain() -> int:
    """The number by which graphs of ROS are apart: ROS_DOMAIN_ID. Raises DataError: it is none."""
    told = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not told.isdecimal() or int(told) > _MAX_DOMAIN:
        raise DataError(f"ROS_DOMAIN_ID is {told!r:.40}; expected a number from 0 to {_MAX_DOMAIN}")
    return int(told)


class Carrier(ABC):
    """A node of ROS, as the others see it. Types are such as ``sensor_msgs/msg/Image``; topics begin with a slash."""

    @abstractmethod
    def subscribe(self, topic: str, kind: str, qos: Qos, heard: Heard) -> None:
        """Have `heard` called with each message. Raises DataError: the type is unknown here."""

    @abstractmethod
    def publisher(self, topic: str, kind: str, qos: Qos) -> Callable[[bytes], object]:
        """Offer a topic; what is given back publishes CDR. Raises DataError: the type is unknown here."""

    @abstractmethod
    def kinds(self, topic: str) -> set[str]:
        """The types as which others publish a topic now, as far as is known."""

    def unreached(self) -> str:
        """Why nobody can be heard now, as far as is known; empty: there is no reason."""
        return ""

    @abstractmethod
    def close(self) -> None:
        """Be gone from the graph."""


def open_carrier(address: Address, node: str) -> Carrier:
    """A carrier of the kind that an address names, as a node of this name. Raises DataError: it cannot be had."""
    name = f"hierax_{node}_{os.getpid()}"
    require("rosbags.typesys", address.name)
    if address.carrier == RCLPY:
        from hierax.nodes.ros2.by_rclpy import RclpyCarrier

        return RclpyCarrier(address.name, name)
    require("xxhash", address.name)
    from hierax.nodes.ros2.by_zenoh import ZenohCarrier

    return ZenohCarrier(address.name, name, address.router)
