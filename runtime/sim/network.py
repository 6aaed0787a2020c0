"""Virtual time; a disk whose writes a crash can tear; and a network: bytes, late, lost, doubled and out of order."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from heapq import heappop, heappush
from random import Random
from typing import Any

from hierax.runtime.recovery.disk import SLOTS, Storage
from hierax.runtime.sim.checker import Checker
from hierax.runtime.sim.journal import FAULT, Journal
from hierax.runtime.sim.scenario import DELAY, DOUBLE, LOSS, REORDER, Fault
from hierax.runtime.transport.port import Port
from hierax.schemas.control import Control, encode_control
from hierax.schemas.messages import Header, Message, encode_message

SHORTEST_S, LONGEST_S = 0.0003, 0.003  # how long a message takes

BLOCK_BYTES = 64  # what a torn write leaves behind is made of such blocks: a cache line


class Crash(BaseException):
    """The process dies here. No `Exception`: nothing may catch it on its way."""


class SimStorage(Storage):
    """Two slots that outlive the process that writes them."""

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._slots = [bytes(BLOCK_BYTES)] * SLOTS
        self._last = 0
        self.tears: Callable[[], bool] = lambda: False  # asked before each write whether the process dies in it

    def write(self, slot: int, data: bytes) -> None:
        if self.tears():
            self._slots[slot] = self._torn(self._slots[slot], data)
            raise Crash
        self._last = slot
        old = self._slots[slot]
        self._slots[slot] = data + old[len(data) :]

    def read(self, slot: int) -> bytes:
        return self._slots[slot]

    def flush(self) -> None:
        return

    def damage(self) -> bool:
        data = bytearray(self._slots[self._last])
        if not any(data):
            return False
        length = min(len(data), 64)  # in the head or the first of the data: what counts, surely
        data[self._rng.randrange(length)] ^= 1 << self._rng.randrange(8)
        self._slots[self._last] = bytes(data)
        return True

    def _torn(self, old: bytes, data: bytes) -> bytes:
        """What is there when only some blocks of the new data, or only its beginning, came to be written."""
        whole = data + old[len(data) :]
        before = old + bytes(len(whole) - len(old))
        if self._rng.random() < 0.5:
            end = self._rng.randrange(len(data))
            return whole[:end] + before[end:]
        blocks = range(0, len(whole), BLOCK_BYTES)
        return b"".join((whole if self._rng.random() < 0.5 else before)[at : at + BLOCK_BYTES] for at in blocks)


class Clock:
    """Events in the order of their times; of equal times, as they were scheduled."""

    def __init__(self) -> None:
        self.now = 0.0  # seconds
        self._number = 0
        self._events: list[tuple[float, int, Callable[..., None], tuple[Any, ...]]] = []

    def __call__(self) -> float:
        """The time, as production code asks for it."""
        return self.now

    def schedule(self, delay_s: float, event: Callable[..., None], *arguments: Any) -> None:
        self._number += 1
        heappush(self._events, (self.now + delay_s, self._number, event, arguments))

    def step(self) -> bool:
        if not self._events:
            return False
        self.now, _, event, arguments = heappop(self._events)
        event(*arguments)
        return True


class Host(ABC):
    """What the network knows of a process."""

    is_world: bool  # whether it runs the world; all processes have a link to that

    def __init__(self, name: str, token: str) -> None:
        self.name = name  # of the node, and of the process alone
        self.token = token  # likewise
        # ends of links, by version of the roster: its own instance, and those of the others by name
        self.links: dict[int, tuple[int, Mapping[str, int]]] = {}
        self.opening: dict[int, Callable[[int], None]] = {}  # what is to be called when a version's links are open

    @property
    def neighbours(self) -> set[str]:
        return {other for _, others in self.links.values() for other in others}

    def links_to(self, other: str) -> set[tuple[int, int]]:
        """Its ends of links to another node: its own instance, and the other's."""
        return {(own, others[other]) for own, others in self.links.values() if other in others}

    @abstractmethod
    def point(self, what: str) -> None:
        """It makes a call to the outside, or that returns."""

    @abstractmethod
    def take(self, kind: str, data: Any) -> None:
        """Take in what comes."""


class SimPort(Port):
    """A process's end of its edges."""

    def __init__(self, network: "Network", process: Host) -> None:
        self._network = network
        self._process = process

    def send(self, message: Message) -> None:
        self._process.point(f"send {message.header.kind}")
        self._network.send(self._process, message)
        self._process.point("sent")

    def receive(self) -> Message | None:
        return None

    def link(
        self,
        below: Sequence[str],
        above: Sequence[str],
        version: int,
        instances: Mapping[str, int],
        opened: Callable[[int], None],
    ) -> None:
        process = self._process
        process.point("link")
        others = {other: instances.get(other, 0) for other in (*below, *above)}
        process.links[version] = (instances.get(process.name, 0), others)
        process.opening[version] = opened
        self._network.declare(process)

    def unlink(self, version: int) -> None:
        process = self._process
        process.links = {later: link for later, link in process.links.items() if later >= version}
        process.opening = {later: opened for later, opened in process.opening.items() if later >= version}

    def interrupt(self) -> None:
        return

    def close(self) -> None:
        return


class Network:
    """Carries messages from process to process."""

    def __init__(self, clock: Clock, rng: Random, journal: Journal, checker: Checker) -> None:
        self.hosts: Mapping[str, Host] = {}  # the processes that live, by token; to be filled by whoever starts them
        self.faults: list[Fault] = []  # that last, of messages
        self.cut: set[str] = set()  # tokens of processes that are cut off
        self.at_once = False  # whether links open as soon as both ends are there
        self._clock = clock  # virtual
        self._rng = rng  # of delays and faults
        self._journal = journal  # told what befalls messages
        self._checker = checker  # told of each message, and where one is lost that must not be
        self._by_name: dict[str, list[Host]] = {}
        self._lanes: dict[tuple[str, str, str], float] = {}
        self._broken: Counter[frozenset[str]] = Counter()
        self._breaks: Counter[frozenset[str]] = Counter()

    def came(self, process: Host) -> None:
        """A process is there."""
        self._by_name.setdefault(process.name, []).append(process)

    def parted(self, one: str, other: str) -> bool:
        return (one in self.cut) != (other in self.cut) or self._broken[frozenset((one, other))] > 0

    def break_link(self, process: Host, number: int, for_s: float) -> None:
        """Break a process's link to the neighbour, or to the owner, that a number says, and mend it after a while."""
        near = process.neighbours
        others = [each for each in self.hosts.values() if each.name in near or each.is_world]
        others = [each for each in others if each is not process]
        if not others:
            return
        other = others[number % len(others)]
        link = frozenset((process.token, other.token))
        self._broken[link] += 1
        self._breaks[link] += 1
        self._clock.schedule(for_s, self._mend, process, other)

    def _mend(self, one: Host, other: Host) -> None:
        """The link is there again; both ends find that out, if they are neighbours."""
        link = frozenset((one.token, other.token))
        self._broken[link] -= 1
        if self._broken[link]:
            return
        self.open_links()
        for process, neighbour in ((one, other), (other, one)):
            if neighbour.name in process.neighbours:
                self._clock.schedule(self._delay(), process.take, "mended", neighbour.name)

    def send(self, sender: Host, message: Message) -> None:
        """Put a message on its way to all processes that listen to this sender's name."""
        header = message.header
        self._checker.sends(header)
        data = encode_message(message)
        open_to = {own for instance, own in sender.links_to(header.receiver) if instance == header.instance}
        reached = False
        for process in self._named(header.receiver):
            ends = process.links_to(header.sender)
            if not ends or self.parted(sender.token, process.token):
                continue
            reached |= any(own in open_to for own, instance in ends if instance == header.instance)
            self._put(sender.token, process.token, header.kind, data)
        if not reached:
            self._check_lost(sender, header)

    def _check_lost(self, sender: Host, header: Header) -> None:
        """A message is lost, as its link is not open; that must have a reason."""
        checker = self._checker
        self._journal.trace(f"{sender.token}: nobody hears its {header.kind} for {header.receiver}, {header.epoch}")
        if header.roster != checker.version or sender.token != checker.process_of(header.roster, sender.name):
            return
        token = checker.process_of(header.roster, header.receiver)
        if token in self.hosts and not self.parted(sender.token, str(token)):
            checker.violate(f"{sender.token}: its {header.kind} for {token} is lost: the link is not open")

    def say(self, sender: str, receiver: str, control: Control) -> None:
        if receiver in self.hosts and not self.parted(sender, receiver):
            self._put(sender, receiver, "control", encode_control(control))

    def declare(self, process: Host) -> None:
        """A process has opened its ends of a version's links; others find out."""
        if self.at_once:
            self.open_links()
        else:
            self._clock.schedule(self._delay(), self.open_links)

    def open_links(self) -> None:
        """Tell those whose links are open at both ends by now."""
        for process in list(self.hosts.values()):
            for version, opened in list(process.opening.items()):
                own, others = process.links[version]
                if all(self._is_open(process, own, *other) for other in others.items()):
                    del process.opening[version]
                    if self.at_once:
                        opened(version)
                    else:
                        self._clock.schedule(self._delay(), process.take, "opened", (opened, version))

    def _is_open(self, process: Host, own: int, other: str, instance: int) -> bool:
        return any(
            (instance, own) in neighbour.links_to(process.name) and not self.parted(process.token, neighbour.token)
            for neighbour in self._named(other)
        )

    def _named(self, name: str) -> list[Host]:
        """The processes of a node that live."""
        living = [process for process in self._by_name.get(name, ()) if process.token in self.hosts]
        if living:
            self._by_name[name] = living
        return living

    def _put(self, sender: str, receiver: str, kind: str, data: bytes) -> None:
        now = self._clock.now
        copies = 1
        delay = self._delay()
        ordered = True
        for fault in self.faults:
            if self._rng.random() >= fault.share:
                continue
            self._journal.count(FAULT, fault.kind)
            if fault.kind == LOSS:
                return
            if fault.kind == DOUBLE:
                copies += 1
            elif fault.kind == DELAY:
                delay += self._rng.uniform(0.0, 0.1)
            elif fault.kind == REORDER:
                ordered = False
                delay += self._rng.uniform(0.0, 0.02)
        for copy in range(copies):
            at = now + delay + (self._rng.uniform(0.0, 0.5) if copy else 0.0)
            if ordered and not copy:
                at = self._lanes[sender, receiver, kind] = max(at, self._lanes.get((sender, receiver, kind), 0.0))
            breaks = self._breaks[frozenset((sender, receiver))]
            self._clock.schedule(at - now, self._deliver, sender, receiver, kind, data, breaks)

    def _deliver(self, sender: str, receiver: str, kind: str, data: bytes, breaks: int) -> None:
        process = self.hosts.get(receiver)
        is_lost = self.parted(sender, receiver) or self._breaks[frozenset((sender, receiver))] != breaks
        if process is not None and not is_lost:
            process.take("control" if kind == "control" else "message", data)

    def _delay(self) -> float:
        return self._rng.uniform(SHORTEST_S, LONGEST_S)
