"""Effects that keep what their engine calls, in order."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

from hierax.runtime import Elements
from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Committed, Completed, EngineEffects
from hierax.runtime.engine.table import Verdict
from hierax.schemas.messages import Header, Message, encode_message
from hierax.schemas.values import encode_value


class Sent(NamedTuple):
    """`EngineEffects.send`."""

    message: Message


class Kept(NamedTuple):
    """`EngineEffects.save`."""

    epoch: int
    attempt: int
    start: bytes
    now: bytes


class Acted(NamedTuple):
    """`EngineEffects.act`."""

    epoch: int
    actions: Elements


class Refused(NamedTuple):
    """`EngineEffects.refused`."""

    header: Header
    verdict: Verdict


class Lacked(NamedTuple):
    """`EngineEffects.lacks`."""

    version: int


class Rewired(NamedTuple):
    """`EngineEffects.rewired`."""

    version: int


Output = Sent | Kept | Acted | Refused | Lacked | Rewired | Called | Committed | Completed
Kind = TypeVar("Kind", bound=Output)


class Recorder(EngineEffects):
    """Keeps every call of an engine.

    Attributes:
        outputs: in the order of the calls.
    """

    def __init__(self) -> None:
        self.outputs: list[Output] = []

    def take(self) -> list[Output]:
        """What was called since the last time."""
        outputs, self.outputs = self.outputs, []
        return outputs

    def send(self, message: Message) -> None:
        self.outputs.append(Sent(message))

    def save(self, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        self.outputs.append(Kept(epoch, attempt, start, now))

    def act(self, epoch: int, actions: Elements) -> None:
        self.outputs.append(Acted(epoch, actions))

    def committed(self, committed: Committed) -> None:
        self.outputs.append(committed)

    def completed(self, completed: Completed) -> None:
        self.outputs.append(completed)

    def refused(self, header: Header, verdict: Verdict) -> None:
        self.outputs.append(Refused(header, verdict))

    def lacks(self, version: int) -> None:
        self.outputs.append(Lacked(version))

    def rewired(self, version: int) -> None:
        self.outputs.append(Rewired(version))

    def called(self, called: Called) -> None:
        self.outputs.append(called)


def of(kind: type[Kind], outputs: list[Output]) -> list[Kind]:
    """Those of one kind."""
    return [output for output in outputs if isinstance(output, kind)]


def steps(outputs: list[Output]) -> list[Step]:
    """The epochs that were completed."""
    return [completed.step for completed in of(Completed, outputs)]


def verdicts(outputs: list[Output]) -> list[Verdict]:
    """Why messages were refused."""
    return [refused.verdict for refused in of(Refused, outputs)]


def sent(outputs: list[Output]) -> list[Message]:
    """The messages that were sent."""
    return [each.message for each in of(Sent, outputs)]


def plain(outputs: list[Output]) -> list[Any]:
    """What can be compared, to the bit."""
    result: list[Any] = []
    for output in outputs:
        if isinstance(output, Sent):
            result.append(encode_message(output.message))
        elif isinstance(output, Completed):
            result.append((encode_value(tuple(output.step)), output.state, output.digest))
        else:
            result.append(output)
    return result
