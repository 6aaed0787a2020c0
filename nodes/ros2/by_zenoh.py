"""Messages as `rmw_zenoh` has them, by a Zenoh session of ours: its keys, attachments and liveliness tokens.

A message is put to ``<domain>/<topic>/<DDS type>/<type hash>`` as CDR, with an attachment: its number and time of
sending (int64, ns since 1970), and the publisher's gid of 16 bytes with its length in front, 33 bytes, little-endian.
Who publishes or subscribes is told by tokens under ``@ros2_lv``. After ros2/rmw_zenoh: `liveliness_utils.cpp`,
`attachment_helpers.cpp`, `rmw_publisher_data.cpp`. Read leniently: versions differ, and add parts."""

import itertools
import logging
import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import zenoh
import zenoh.ext

from hierax.nodes.ros2.carrier import Carrier, Heard, Qos, domain
from hierax.nodes.ros2.messages import messages
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.shots import MAX_STAMP_NS
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import ZenohConfig, close_session, open_session

ROUTER = "localhost:7447"  # where `rmw_zenohd` listens
_SPACE = "@ros2_lv"
_NODE, _PUBLISHER, _SUBSCRIPTION = "NN", "MP", "MS"
_ATTACHMENT = struct.Struct("<qqB16s")
_SENT = b"source_timestamp"  # in front of the time, before 2025
_DEPTH = 42  # rmw_zenoh's own
_HEARTBEAT_S = 0.5
_REACHED_S = 5.0  # after so long without a router that is told

_LOG = logging.getLogger(__name__)


class Endpoint(NamedTuple):
    """What a liveliness token says of a publisher or subscription."""

    publishes: bool
    topic: str
    kind: str  # such as ``sensor_msgs/msg/Image``
    hash: str  # ``RIHS01_…``


def dds_type(kind: str) -> str:
    """``sensor_msgs::msg::dds_::Image_`` of ``sensor_msgs/msg/Image``."""
    package, _, name = kind.partition("/msg/")
    return f"{package}::msg::dds_::{name}_"


def topic_key(number: int, topic: str, kind: str, hashed: str) -> str:
    """The key of a topic's messages in a domain; ``*`` stands for any hash."""
    return f"{number}/{topic.strip('/')}/{dds_type(kind)}/{hashed}"


def qos_part(qos: Qos) -> str:
    """A token's last part: reliability, durability, history, deadline, lifespan and liveliness; defaults are left
    out."""
    durability = "1" if qos.transient_local else ""
    depth = "" if qos.depth == _DEPTH else qos.depth
    return f"{'' if qos.reliable else 2}:{durability}:,{depth}:,:,:,,"


def endpoint_of(token: str) -> Endpoint | None:
    """What a token says; None: it is no publisher's and no subscription's, or is laid out otherwise."""
    parts = token.split("/")
    if len(parts) < 12 or parts[0] != _SPACE or parts[5] not in (_PUBLISHER, _SUBSCRIPTION):
        return None
    topic, told, hashed = (part.replace("%", "/") for part in parts[9:12])
    package, _, name = told.partition("::msg::dds_::")
    return Endpoint(parts[5] == _PUBLISHER, topic, f"{package}/msg/{name.removesuffix('_')}", hashed)


def attachment_of(number: int, sent_ns: int, gid: bytes) -> bytes:
    """What goes with a message."""
    return _ATTACHMENT.pack(number, sent_ns, len(gid), gid)


def sent_at(attachment: bytes) -> int | None:
    """When a message was sent, ns since 1970, by its attachment; None: it says nothing of that, or no time that ROS
    has."""
    if len(attachment) == _ATTACHMENT.size:
        sent_ns = int(_ATTACHMENT.unpack(attachment)[1])
    else:
        number = attachment.partition(_SENT)[2][:8]
        sent_ns = int.from_bytes(number, "little", signed=True) if len(number) == 8 else -1
    return sent_ns if 0 <= sent_ns < MAX_STAMP_NS else None


class ZenohCarrier(Carrier):
    """A node beside those of `rmw_zenoh`.

    Args: where: what asks for it, for errors; node: its name; router: host and port of Zenoh's router, which may come
        later, `ROUTER` if it is not told. ZENOH_SESSION_CONFIG_URI names a file with Zenoh's settings, as in ROS.
    Raises DataError: there is something wrong with these."""

    def __init__(self, where: str, node: str, router: str | None) -> None:
        import xxhash

        self._where, self._node, self._domain = where, node, domain()
        self._gid: Callable[[str], bytes] = lambda token: int(xxhash.xxh3_128_intdigest(token)).to_bytes(16, "little")
        self._router = router or ROUTER
        # without a file of ROS's own: Zenoh's defaults, and not ZENOH_CONFIG, which is for the launch
        settings: ZenohConfig = os.environ.get("ZENOH_SESSION_CONFIG_URI") or {}
        try:
            self._session = open_session(connect=[f"tcp/{self._router}"], zenoh_config=settings, shared_memory=False)
        except TransportError as error:
            raise DataError(f"{where}: {error}") from error
        self._numbers = itertools.count()
        self._held: list[Any] = []  # undeclared when they go
        self._endpoints: dict[str, Endpoint] = {}
        with self._speaking():
            self._declare(_NODE)
            live = self._session.liveliness()
            self._held.append(live.declare_subscriber(f"{_SPACE}/{self._domain}/**", self._told, history=True))
        self._looking = threading.Timer(_REACHED_S, self._look)
        self._looking.daemon = True
        self._looking.start()

    def subscribe(self, topic: str, kind: str, qos: Qos, heard: Heard) -> None:
        def came(sample: zenoh.Sample) -> None:
            sent_ns = None if sample.attachment is None else sent_at(sample.attachment.to_bytes())
            heard(sample.payload.to_bytes(), time.time_ns() if sent_ns is None else sent_ns)

        key = topic_key(self._domain, topic, kind, "*")
        with self._speaking():
            if qos.transient_local:
                subscriber: Any = zenoh.ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    came,
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
                    recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                    subscriber_detection=True,
                )
            else:
                subscriber = self._session.declare_subscriber(key, came)
            self._held.append(subscriber)
            self._declare(_SUBSCRIPTION, topic, kind, qos)

    def publisher(self, topic: str, kind: str, qos: Qos) -> Callable[[bytes], object]:
        key = topic_key(self._domain, topic, kind, self._hash(kind))
        latched: dict[str, Any] = {}
        if qos.transient_local:
            latched = {
                "cache": zenoh.ext.CacheConfig(qos.depth),
                "sample_miss_detection": zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S),
                "publisher_detection": True,
            }
        with self._speaking():
            declared: Any = zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                reliability=zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT,
                congestion_control=zenoh.CongestionControl.DROP,
                **latched,
            )
            gid = self._gid(self._declare(_PUBLISHER, topic, kind, qos))
        self._held.append(declared)
        numbers = itertools.count(1)

        def publish(data: bytes) -> None:
            with self._speaking():
                declared.put(bytes(data), attachment=attachment_of(next(numbers), time.time_ns(), gid))

        return publish

    def kinds(self, topic: str) -> set[str]:
        return {each.kind for each in list(self._endpoints.values()) if each.publishes and each.topic == topic}

    def unreached(self) -> str:
        info = self._session.info
        if info.routers_zid() or info.peers_zid():
            return ""
        return f"no router of Zenoh is reached at {self._router}"

    def close(self) -> None:
        self._looking.cancel()
        self._held.clear()
        close_session(self._session)

    def _look(self) -> None:
        """Say where nobody hears what is said here; a router that comes later is linked to by itself."""
        with suppress(zenoh.ZError):  # it is closed meanwhile
            if told := self.unreached():
                _LOG.warning("%s: %s; nothing is said or heard until one comes", self._where, told)

    def _declare(self, entity: str, topic: str = "", kind: str = "", qos: Qos | None = None) -> str:
        """Tell the others of this node, or of what it has; with which token."""
        head = f"{_SPACE}/{self._domain}/{self._session.info.zid()}/0/{next(self._numbers)}/{entity}/%/%/{self._node}"
        named = topic.replace("/", "%")
        token = head if qos is None else f"{head}/{named}/{dds_type(kind)}/{self._hash(kind)}/{qos_part(qos)}"
        self._held.append(self._session.liveliness().declare_token(token))
        return token

    def _told(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        endpoint = endpoint_of(token)
        if sample.kind == zenoh.SampleKind.DELETE:
            self._endpoints.pop(token, None)
        elif endpoint is not None:
            self._endpoints[token] = endpoint

    def _hash(self, kind: str) -> str:
        if kind not in messages().types:
            raise DataError(f"{self._where}: {kind} is not known here; expected one of ROS's common types")
        return str(messages().hash_rihs01(kind))

    @contextmanager
    def _speaking(self) -> Iterator[None]:
        try:
            yield
        except zenoh.ZError as error:
            raise DataError(f"{self._where}: Zenoh: {str(error).splitlines()[0]:.200}") from error
