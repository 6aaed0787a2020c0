"""What a transport gives a node: a port to its neighbours. And all ports in one process, in an order from a seed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hierax.runtime.core.errors import HieraxError
from hierax.schemas.messages import Header, Message, decode_message, encode_message

Lane = tuple[str, str]  # sender and kind: what of one receiver's messages stays in order
QUEUE_SIZE = 1024  # how many messages a lane holds at most


class TransportError(HieraxError):
    """A message could not be sent, or the neighbours could not be reached."""


class Sample(NamedTuple):
    """What came on a key."""

    time_ns: int  # when, since 1970
    key: str  # on which one
    data: bytes  # the bytes; of a liveliness token empty
    is_up: bool = False  # of a process's liveliness token, whether it appeared; else it is gone


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


class MemoryNetwork:
    """Ports that reach one another in memory; messages travel as bytes, in an order that the seed decides."""

    tap: Callable[[Header, bytes], None] | None = None  # shown header and bytes of every message; None: nobody is

    def __init__(self, seed: int = 0, queue_size: int = QUEUE_SIZE) -> None:
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._queue_size = queue_size  # how many messages of one sender, receiver and kind may be under way
        self._ports: dict[str, MemoryPort] = {}

    def open_port(self, name: str) -> MemoryPort:
        """A port for the node of this name. Raises `TransportError` if there is one already."""
        if name in self._ports:
            raise TransportError(f"{name}: its port is open already")
        port = MemoryPort(self, name)
        self._ports[name] = port
        return port

    def next_receiver(self) -> str | None:
        """A node that has a message to receive, by the seed; None where nothing is under way."""
        waiting = [name for name, port in sorted(self._ports.items()) if port.lanes or port.breaks]
        return waiting[self.draw(len(waiting))] if waiting else None

    def draw(self, count: int) -> int:
        return 0 if count == 1 else int(self._random.integers(count))

    def put(self, message: Message) -> None:
        header = message.header
        port = self._ports.get(header.receiver)
        if port is None:
            raise TransportError(f"{header.sender}: no node {header.receiver!r} to send to")
        lane = port.lanes.setdefault((header.sender, header.kind), deque())
        if len(lane) >= self._queue_size:
            raise TransportError(
                f"{header.sender}: {len(lane)} {header.kind} messages to {header.receiver} are not received yet"
            )
        data = encode_message(message)
        if self.tap is not None:
            self.tap(header, data)
        lane.append(data)

    def drop_all(self) -> None:
        """Lose what is under way."""
        for port in self._ports.values():
            port.lanes.clear()

    def break_link(self, one: str, other: str) -> None:
        """Break the link between two nodes, which loses what is under way on it, and mend it."""
        for name, neighbour in ((one, other), (other, one)):
            port = self._ports[name]
            port.lanes = {lane: queue for lane, queue in port.lanes.items() if lane[0] != neighbour}
            port.breaks.append(neighbour)

    def forget(self, name: str) -> None:
        self._ports.pop(name, None)


class MemoryPort(Port):
    """A port of a `MemoryNetwork`."""

    def __init__(self, network: MemoryNetwork, name: str) -> None:
        self._network = network
        self._name = name
        self._interrupted = False
        self._closed = False
        self.lanes: dict[Lane, deque[bytes]] = {}
        self.breaks: deque[str] = deque()

    def send(self, message: Message) -> None:
        if self._closed:
            raise TransportError(f"{self._name}: its port is closed")
        self._network.put(message)

    def receive(self) -> Message | None:
        while self.breaks and not self._closed:
            self.mended(self.breaks.popleft())
        if self._interrupted or self._closed or not self.lanes:
            self._interrupted = False
            return None
        names = sorted(self.lanes)
        lane = names[self._network.draw(len(names))]
        data = self.lanes[lane].popleft()
        if not self.lanes[lane]:
            del self.lanes[lane]
        return decode_message(data)

    def link(
        self,
        below: Sequence[str],
        above: Sequence[str],
        version: int,
        instances: Mapping[str, int],
        opened: Callable[[int], None],
    ) -> None:
        opened(version)

    def unlink(self, version: int) -> None:
        return

    def interrupt(self) -> None:
        self._interrupted = True

    def close(self) -> None:
        self._closed = True
        self.lanes.clear()
        self._network.forget(self._name)
