"""What a recording consists of: entries, each of a topic, and faults of processes among them."""

from __future__ import annotations

from typing import NamedTuple

from hierax.runtime.recording.topics import NOTE, Topic
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.messages import Message, decode_message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep, decode_step
from hierax.schemas.values import decode_value


class Entry(NamedTuple):
    """Something that was recorded.

    Attributes:
        key, topic: on which it came, as it was and taken apart.
        time_ns: when, since 1970.
        epoch: of it, modulo 2³²; 0: of none.
    """

    key: str
    topic: Topic
    time_ns: int
    epoch: int
    data: bytes

    def message(self) -> Message:
        """The message that it is. Raises `SchemaError` if it is none."""
        return decode_message(self.data)

    def step(self) -> NodeStep:
        """The step that it is. Raises `SchemaError` if it is none."""
        return decode_step(self.data)

    def roster(self) -> Roster:
        """The roster that it is. Raises `SchemaError` if it is none."""
        return Roster.read(decode_value(self.data, "roster"))

    def commit(self) -> tuple[int, bytes]:
        """The epoch and the run's digest that it tells. Raises `SchemaError` if it tells none."""
        value = decode_value(self.data, "epoch")
        if type(value) is not tuple or tuple(map(type, value)) != (int, bytes) or value[0] < 0:
            raise SchemaError(f"expected an epoch's number and digest, got {shown(value)}", "epoch")
        return value

    def fault(self) -> Fault:
        """What happened to a process. Raises `SchemaError` if it tells nothing of the kind."""
        value = decode_value(self.data, self.topic.what)
        if self.topic.what == NOTE:
            if type(value) is not str:
                raise SchemaError(f"expected a text, got {shown(value)}", "note")
            return Fault(self.time_ns, value)
        if type(value) is not tuple or tuple(map(type, value)) != (str, str, bool):
            raise SchemaError(f"expected a node, its process and whether it is there, got {shown(value)}", "token")
        name, process, up = value
        return Fault(self.time_ns, f"process {process} {'is there' if up else 'is gone'}", name)


class Fault(NamedTuple):
    """Something that happened to a process, in words, and when, since 1970. Without a node the words say whose."""

    time_ns: int
    what: str
    node: str = ""
