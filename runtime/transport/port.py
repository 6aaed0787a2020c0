"""What a transport gives a node: a port to its neighbours."""

from __future__ import annotations

from abc import ABC, abstractmethod

from hierax.runtime.core.errors import HieraxError
from hierax.schemas.messages import Message


class TransportError(HieraxError):
    """A message could not be sent, or the neighbours could not be reached."""


class Port(ABC):
    """A node's end of its edges.

    Of messages with one sender, receiver and kind none is lost, doubled or overtaken
    while both ends are open. Nothing is promised on the order of others.
    """

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send a message to the receiver that its header names; waits while the receiver's queue is full.

        Raises:
            SchemaError: the payload holds something that cannot travel.
            TransportError: the receiver is no neighbour, or cannot take it.
        """

    @abstractmethod
    def receive(self) -> Message | None:
        """The next message.

        A port in a process of its own waits for it; one in a network in memory gives None
        where nothing is on its way.

        Returns:
            None when the port was interrupted or closed.

        Raises:
            SchemaError: bytes came that are no message; they are dropped, and one may go on.
        """

    @abstractmethod
    def interrupt(self) -> None:
        """Make a `receive` that waits, or else the next one, return None. Any thread may call it."""

    @abstractmethod
    def close(self) -> None:
        """Give up all that the port holds. Returns within a bounded time; calling it again does nothing."""
