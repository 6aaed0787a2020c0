"""Messages of several topics that belong together, by their times."""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from hierax.nodes.ros2.carrier import Carrier, Qos
from hierax.nodes.ros2.messages import decoded, reading
from hierax.nodes.sources.files import DataError

_KEPT = 30  # messages of a topic that wait for others


class Came(NamedTuple):
    """A message."""

    number: int  # of its topic's, from 1
    stamp_ns: int  # its header's, or where that is zero or none is there, when it was sent
    arrived_ns: int
    message: Any


class Topics:
    """What is heard of several topics. Newest sets of one message each are made as by `message_filters`: all within so
    many nanoseconds of the first topic's, each the nearest, and none twice.

    Args: names: what the topics are called here, the first of them the one by which the others go."""

    def __init__(self, names: tuple[str, ...], within_ns: int = 0) -> None:
        self._within_ns = within_ns
        self._waiting: dict[str, deque[Came]] = {name: deque(maxlen=_KEPT) for name in names}
        self._numbers = dict.fromkeys(names, 0)
        self._changed = threading.Condition()
        self._news = False
        self._fault: DataError | None = None

    def subscribe(self, carrier: Carrier, name: str, topic: str, kind: str, qos: Qos) -> None:
        """Hear a topic of those named. Raises DataError: the carrier cannot."""

        def came(message: Any, sent_ns: int) -> None:
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            stamp_ns = 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec
            self._numbers[name] += 1
            self._waiting[name].append(Came(self._numbers[name], stamp_ns or sent_ns, sent_ns, message))

        self.hear(carrier, topic, kind, qos, came)

    def hear(self, carrier: Carrier, topic: str, kind: str, qos: Qos, came: Callable[[Any, int], None]) -> None:
        """Have something done with every message of a topic, one by one. Raises DataError: the carrier cannot."""

        def heard(data: bytes, sent_ns: int) -> None:
            with self._changed:
                try:
                    with reading(topic, kind):
                        came(decoded(data, kind), sent_ns)
                except DataError as error:
                    self._fault = error
                self._news = True
                self._changed.notify_all()

        carrier.subscribe(topic, kind, qos, heard)

    def newest(self, is_ready: Callable[[Came], bool], timeout_s: float) -> Mapping[str, Came] | None:
        """The newest set, if one comes in time, of which the first message is ready; what is older is forgotten. Raises
        DataError: a message was damaged."""
        with self._changed:
            self._changed.wait_for(lambda: self._news, timeout_s)
            self._news = False
            if self._fault is not None:
                fault, self._fault = self._fault, None
                raise fault
            first, *others = self._waiting
            for came in reversed(self._waiting[first]):
                found = {name: self._nearest(name, came.stamp_ns) for name in others}
                if is_ready(came) and all(each is not None for each in found.values()):
                    chosen = {first: came, **{name: each for name, each in found.items() if each is not None}}
                    for name, each in chosen.items():
                        self._forget(name, each.number)
                    return chosen
        return None

    def _nearest(self, name: str, stamp_ns: int) -> Came | None:
        near = [each for each in self._waiting[name] if abs(each.stamp_ns - stamp_ns) <= self._within_ns]
        return min(near, key=lambda each: abs(each.stamp_ns - stamp_ns), default=None)

    def _forget(self, name: str, number: int) -> None:
        waiting = self._waiting[name]
        while waiting and waiting[0].number <= number:
            waiting.popleft()
