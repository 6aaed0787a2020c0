"""Watchers: they see what a node does, in the node's thread, while they are there."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.engine.table import Verdict
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Header, Message, encode_message
from hierax.schemas.values import decode_value, encode_value

Edge = tuple[str, str, str]  # kind, sender and receiver
STEPS_KEPT = 16  # how many steps wait until somebody takes them; of more than that, the oldest are forgotten


class Watcher:
    """Told by a `NodeRunner` of all that its node does. Nothing that it is given may be changed. Every method is called
    in the thread that runs the node, between messages that others wait for: it must not take long, and must not raise.
    A watcher that comes in the middle of an epoch sees the rest of it."""

    def received(self, message: Message) -> None:
        """A message has come, and the engine is about to take it in."""

    def called(self, called: Called) -> None:
        """An operator or edge function has returned; who does without this costs the node less."""

    def predicted(self, completed: Completed) -> None:
        """The node is done with an epoch but for what follows: neither its checkpoint nor its context is out yet."""

    def sending(self, message: Message) -> Message:
        """A message is about to go, as it is returned, perhaps with more in its header's extensions."""
        return message

    def sent(self, message: Message) -> None:
        """A message has gone, as `sending` gave it."""

    def acted(self, epoch: int) -> None:
        """The world has moved its actuators, or there are none."""

    def turned(self) -> None:
        """In free running: the node's turn has come."""

    def refused(self, header: Header, verdict: Verdict) -> None:
        """A message was refused."""

    def rewired(self, version: int) -> None:
        """A version of the roster was taken up."""

    def completed(self, completed: Completed) -> None:
        """The node is done with an epoch, and its messages are sent."""

    def committed(self, epoch: int, digest: bytes) -> None:
        """An epoch is committed, and this is the run's digest; only the world's watchers are told."""

    def served(self) -> None:
        """All that followed from a message, an order or a turn is done."""

    def close(self) -> None:
        """The node's life is over."""


@dataclass(eq=False)
class Copier(Watcher):
    """Shows copies of the `wanted` messages, a set that is replaced and never changed; `show` must not wait."""

    show: Callable[[str, str, str, bytes], None]
    wanted: Collection[Edge] = frozenset()

    def sent(self, message: Message) -> None:
        kind, sender, receiver = message.header[:3]
        if (kind, sender, receiver) in self.wanted:
            self.show(kind, sender, receiver, encode_message(message))


class Stepper(Watcher):
    """Keeps a node's last steps, of so `every` many epochs one, until they are taken, by another thread."""

    def __init__(self) -> None:
        self.every = 1
        self._last: int | None = None
        self._steps: deque[tuple[int, Step]] = deque(maxlen=STEPS_KEPT)

    def completed(self, completed: Completed) -> None:
        # of nodes that take part in all epochs those that `every` divides; of others the first one since the last such
        epoch = completed.step.epoch
        last = self._last = epoch - 1 if self._last is None else self._last
        if epoch // self.every != last // self.every:
            self._last = epoch
            self._steps.append((time.time_ns(), completed.step))

    def take(self) -> Iterator[bytes]:
        """The steps that have come since the last time, encoded; those that cannot travel are left out."""
        while self._steps:
            done_ns, step = self._steps.popleft()
            try:
                data = encode_value({"done_ns": done_ns, **step._asdict()})
            except SchemaError:
                continue  # in the midst of an epoch a belief may be anything
            yield data


def read_step(data: bytes) -> tuple[int, Step]:
    """When an epoch was done, in ns since 1970, and what was done; `SchemaError` if `Stepper` has not said it."""
    value = decode_value(data, "step")
    try:
        done_ns = value.pop("done_ns")
        return done_ns, Step(**value)
    except (AttributeError, KeyError, TypeError) as error:
        raise SchemaError(f"is no step of a node: {error}") from error
