"""Watchers: they see what a node does, in the node's thread, while they are there."""

from __future__ import annotations

from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.engine.table import Verdict
from hierax.schemas.messages import Header, Message


class Watcher:
    """Told by a `NodeRunner` of all that its node does. Nothing that it is given may be changed. Every method is called
    in the thread that runs the node, between messages that others wait for: it must not take long, and must not raise.
    A watcher that comes in the middle of an epoch sees the rest of it."""

    def received(self, message: Message) -> None:
        """A message has come, and the engine is about to take it in."""

    def called(self, called: Called) -> None:
        """An operator or edge function has returned."""

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
