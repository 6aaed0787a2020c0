"""What a transport gives a node: a port to its neighbours. And all ports in one process, in an order from a seed."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Generic, NamedTuple, TypeVar

from hierax.runtime.core.errors import HieraxError
from hierax.schemas.messages import Header, Message, decode_message, encode_message

Lane = tuple[str, str]  # sender and kind: what of one receiver's messages stays in order
Drawn = TypeVar("Drawn")
QUEUE_SIZE = 1024  # how many messages a lane holds at most
NEW, OF_ALL = 16, 1 / 16  # how many that came last are preferred to others; and how often they are not


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
    while both ends are open and the link between them holds. Nothing is promised on the order of others."""

    mended: Callable[[str], None] = staticmethod(lambda neighbour: None)

    def on_mended(self, call: Callable[[str], None]) -> None:
        """Have something called with a neighbour's name when the link to its process broke and is there again.

        It is there in both directions then. The thread that receives calls, out of `receive`. What was sent since the
        break, or shortly before it, may be lost; both ends are told."""
        self.mended = call

    @abstractmethod
    def send(self, message: Message) -> None:
        """Send a message to the receiver that its header names; waits while the receiver's queue is full.

        Raises `SchemaError` if the payload holds something that cannot travel, and `TransportError` if the receiver is
        no neighbour, or cannot take it."""

    @abstractmethod
    def receive(self) -> Message | None:
        """The next message; None when the port was interrupted or closed.

        A port in a process of its own waits for it; one in a network in memory gives None where nothing is on its way.
        Raises `SchemaError` if bytes came that are no message; they are dropped, and one may go on."""

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


class DrawnSet(Generic[Drawn]):
    """Of which one may be drawn, put in or taken out in the same time, however many there are.

    What is drawn follows from the draws, and from what was put in and taken out before, in this order."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._all: list[Drawn] = []
        self._places: dict[Drawn, int] = {}

    def __bool__(self) -> bool:
        return bool(self._all)

    def draw(self) -> Drawn:
        count = len(self._all)
        return self._all[0] if count == 1 else self._all[int(count * self._random.random())]

    def draw_new(self) -> Drawn:
        """As `draw`; of more than `NEW` mostly one of those that came last."""
        count = len(self._all)
        if count <= NEW or self._random.random() < OF_ALL:
            return self.draw()
        return self._all[count - NEW + int(NEW * self._random.random())]

    def add(self, one: Drawn) -> None:
        if one not in self._places:
            self._places[one] = len(self._all)
            self._all.append(one)

    def discard(self, one: Drawn) -> None:
        place = self._places.pop(one, None)
        if place is None:
            return
        last = self._all.pop()
        if place < len(self._all):
            self._all[place] = last
            self._places[last] = place


class MemoryNetwork:
    """Ports that reach one another in memory; messages travel as bytes, in an order that the seed decides."""

    tap: Callable[[Header, bytes], None] | None = None  # shown header and bytes of every message; None: nobody is

    def __init__(self, seed: int = 0, queue_size: int = QUEUE_SIZE) -> None:
        self.random = Random(seed)
        self.waiting: DrawnSet[str] = DrawnSet(self.random)  # the nodes that have something to receive
        self.queue_size = queue_size  # how many messages of one sender, receiver and kind may be under way
        self.overtakes = False  # whether, where there are so many, the oldest is left out: only newer ones count
        self.under_way = 0  # how many messages are not received yet
        self._ports: dict[str, MemoryPort] = {}

    def open_port(self, name: str) -> "MemoryPort":
        """A port for the node of this name. Raises `TransportError` if there is one already."""
        if name in self._ports:
            raise TransportError(f"{name}: its port is open already")
        port = MemoryPort(self, name)
        self._ports[name] = port
        return port

    def next_receiver(self) -> str | None:
        """A node that has a message to receive, by the seed; None where nothing is under way.

        Among many mostly one that was sent something just now: what it works on is next to what was worked on last, and
        the processor's caches still hold some of it."""
        return self.waiting.draw_new() if self.waiting else None

    def lets_go_on(self) -> bool:
        """Whether a node that waits for nobody has its turn, by the seed: the more is under way, the more seldom."""
        return self.random.random() * (self.under_way + 1) < 1.0

    def put(self, message: Message) -> None:
        header = message.header
        port = self._ports.get(header.receiver)
        if port is None:
            raise TransportError(f"{header.sender}: no node {header.receiver!r} to send to")
        waiting = port.waiting((header.sender, header.kind))
        if waiting >= self.queue_size and self.overtakes:
            port.skip((header.sender, header.kind))
        elif waiting >= self.queue_size:
            raise TransportError(
                f"{header.sender}: {waiting} {header.kind} messages to {header.receiver} are not received yet"
            )
        data = encode_message(message)
        if self.tap is not None:
            self.tap(header, data)
        port.put((header.sender, header.kind), data)

    def drop_all(self) -> None:
        """Lose what is under way."""
        for port in self._ports.values():
            port.lose()

    def break_link(self, one: str, other: str) -> None:
        """Break the link between two nodes, which loses what is under way on it, and mend it."""
        for name, neighbour in ((one, other), (other, one)):
            self._ports[name].break_off(neighbour)

    def forget(self, name: str) -> None:
        self._ports.pop(name, None)


class MemoryPort(Port):
    """A port of a `MemoryNetwork`."""

    def __init__(self, network: MemoryNetwork, name: str) -> None:
        self._network = network
        self._name = name
        self._interrupted = False
        self._closed = False
        self._lanes: dict[Lane, list[bytes]] = {}  # mostly of one message: a deque takes a block of sixty-four
        self._filled: DrawnSet[Lane] = DrawnSet(network.random)
        self._breaks: list[str] = []

    def waiting(self, lane: Lane) -> int:
        """How many messages of a lane are not received yet."""
        queue = self._lanes.get(lane)
        return 0 if queue is None else len(queue)

    def put(self, lane: Lane, data: bytes) -> None:
        """A message is on its way here."""
        queue = self._lanes.get(lane)
        if queue is None:
            queue = self._lanes[lane] = []
        if not queue:
            self._filled.add(lane)
            self._network.waiting.add(self._name)
        queue.append(data)
        self._network.under_way += 1

    def skip(self, lane: Lane) -> None:
        """Leave out the oldest message of a lane, before another one is put there."""
        del self._lanes[lane][0]
        self._network.under_way -= 1

    def lose(self, sender: str | None = None) -> None:
        """Lose what is under way here, from one sender or from all."""
        for lane, queue in self._lanes.items():
            if sender in (None, lane[0]):
                self._network.under_way -= len(queue)
                queue.clear()
                self._filled.discard(lane)
        self._settle()

    def break_off(self, neighbour: str) -> None:
        """The link to a neighbour breaks, which loses what is under way on it, and is mended."""
        self.lose(neighbour)
        self._breaks.append(neighbour)
        self._network.waiting.add(self._name)

    def _settle(self) -> None:
        if not self._filled and not self._breaks:
            self._network.waiting.discard(self._name)

    def send(self, message: Message) -> None:
        if self._closed:
            raise TransportError(f"{self._name}: its port is closed")
        self._network.put(message)

    def receive(self) -> Message | None:
        while self._breaks and not self._closed:
            self.mended(self._breaks.pop(0))
            self._settle()
        if self._interrupted or self._closed or not self._filled:
            self._interrupted = False
            return None
        lane = self._filled.draw()
        queue = self._lanes[lane]
        data = queue.pop(0)
        self._network.under_way -= 1
        if not queue:
            self._filled.discard(lane)
            self._settle()
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
        if self._closed:
            return
        self._closed = True
        self._breaks.clear()
        self.lose()
        self._network.forget(self._name)
