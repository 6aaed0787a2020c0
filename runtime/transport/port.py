"""What a transport gives a node: a port to its neighbours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

from hierax.runtime.core.errors import HieraxError
from hierax.schemas.messages import Message


class TransportError(HieraxError):
    """A message could not be sent, or the neighbours could not be reached."""


class Port(ABC):
    """A node's end of its edges.

    Of messages with one sender, receiver and kind none is lost, doubled or overtaken
    while both ends are open and the link between them holds. Nothing is promised on the order of others.
    """

    mended: Callable[[str], None] = staticmethod(lambda neighbour: None)

    def on_mended(self, call: Callable[[str], None]) -> None:
        """Have something called with a neighbour's name when the link to its process broke and is there again.

        It is there in both directions then. The thread that receives calls, out of `receive`. What was sent since the
        break, or shortly before it, may be lost; both ends are told.
        """
        self.mended = call

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send a message to the receiver that its header names; waits while the receiver's queue is full.

        Raises `SchemaError` if the payload holds something that cannot travel, and `TransportError` if the receiver is
        no neighbour, or cannot take it.
        """

    @abstractmethod
    def receive(self) -> Message | None:
        """The next message; None when the port was interrupted or closed.

        A port in a process of its own waits for it; one in a network in memory gives None where nothing is on its way.
        Raises `SchemaError` if bytes came that are no message; they are dropped, and one may go on.
        """

    def poll(self) -> Message | None:
        """The next message, if it is there already; as `receive`, but it never waits."""
        return self.receive()

    @abstractmethod
    def link(
        self,
        below: Sequence[str],  # names of the neighbours
        above: Sequence[str],  # likewise
        version: int,  # of the roster
        instances: Mapping[str, int],  # instance numbers, by node; 0 for those that are not there
        # Called with the version when every neighbour hears this node and is heard: at once, or in a later `receive`,
        # by the thread that receives.
        opened: Callable[[int], None],
    ) -> None:
        """Open links to a version's neighbours, beside those that there are. Raises `TransportError` if it fails."""

    @abstractmethod
    def unlink(self, version: int) -> None:
        """Give up the links that only versions before this one need."""

    @abstractmethod
    def interrupt(self) -> None:
        """Make a `receive` that waits, or else the next one, return None. Any thread may call it."""

    @abstractmethod
    def close(self) -> None:
        """Give up all that the port holds. Returns within a bounded time; calling it again does nothing."""
