"""A node's port over Zenoh: one publisher for each outgoing key, one subscriber for all incoming ones."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh
from numpy.typing import NDArray

from hierax.runtime.transport.inbox import Inbox
from hierax.runtime.transport.port import Port, TransportError
from hierax.runtime.transport.rendezvous import AbsentProcesses, Handshake, Rendezvous
from hierax.runtime.transport.shared_arrays import ForeignArrayError, Lender, LostArrayError, SharedArrays
from hierax.runtime.transport.shared_process import Handed, Neighbours, SharedInbox, hand_over
from hierax.runtime.transport.zenoh_session import close_session
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys, living, process_token
from hierax.schemas.limits import MAX_MESSAGE_BYTES
from hierax.schemas.messages import HELLO, NO_EXTENSIONS, TASKS, Lend, Message, decode_message, encode_message

_log = logging.getLogger("hierax")

INTERRUPT = "interrupt"  # kind of the key on which a process wakes up its own port


Lane = tuple[str, str]
"""A neighbour and a kind of message, in this order for what comes; for what goes, the other way round."""


@dataclass
class Link:
    """The links of one version of the roster."""

    rendezvous: Rendezvous  # the handshakes
    opened: Callable[[int], None]  # told when they are done
    told: bool = False  # whether it was


class ZenohPort(Port):
    """A node's end of its edges in a process of its own, whose session it owns; or in one that nodes share.

    One thread receives; others may call `greet` and `interrupt`. Messages may have `most_bytes`; None: any number.
    Large arrays go through memory that is `shared` with neighbours on this machine, while nobody else `hears`; None:
    through the network. Where nodes share the process, `beside` has those that are there: greetings go by the network
    all the same, so that links open and close alike, and messages in memory, while nobody else hears. Raises
    `TransportError` if Zenoh refuses a declaration."""

    heard: Callable[[], bool] = staticmethod(lambda: False)
    """Whether somebody else listens to the run's messages, and could not read what is lent to their receivers."""

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        name: str,
        process: str = "",
        most_bytes: int | None = None,
        shared: SharedArrays | None = None,
        beside: Neighbours | None = None,
    ) -> None:
        self._session = session  # an open session
        self._watching = session  # whose signs of life count
        self._beside = beside
        self._declaring: AbstractContextManager[Any] = nullcontext() if beside is None else beside.declaring
        self._most_bytes = MAX_MESSAGE_BYTES if most_bytes is None else most_bytes
        self._keys = keys  # of the run
        self._name = name  # of the node
        self._process = process or process_token(name, "0")
        self._closed = False
        self._shared = shared
        self._lends: dict[Lane, Lend] = {}
        self._readers: dict[tuple[str, int], bytes | None] = {}  # by neighbour and instance: to whom arrays are lent
        self._peer = ""  # whose message is being read
        self._early: deque[Message] = deque()
        # replaced, never changed in place: other threads read them
        self._links: Mapping[int, Link] = {}
        self._lanes: Mapping[str, Lane] = {}
        self._publishers: dict[Lane, Any] = {}
        self._shaking = threading.Lock()
        self.absent = AbsentProcesses()  # processes of the run whose links broke, or whose first ones did not open
        self._own_key = keys.edge(INTERRUPT, name, name)
        self._inbox: Inbox | SharedInbox = Inbox(None, self._wake)
        if beside is not None:
            self._inbox = beside[self._process] = SharedInbox(lambda: self._lanes)
        self._signs: tuple[Any, ...] = ()  # its token, and what tells of others'
        try:
            with self._declaring:
                self.move(session)
        except zenoh.ZError as error:
            raise TransportError(f"{name}: Zenoh: {error}") from error

    def move(self, session: zenoh.Session) -> None:
        """Go on in an open session, while the one before is open yet. For neighbours it is as if the links had broken,
        and were there again: greetings, and what follows, mend what was under way."""
        keys, liveliness = self._keys, session.liveliness()
        self._subscriber = session.declare_subscriber(keys.inbox(self._name), self._inbox.handler())
        self._inbox.move(self._subscriber)
        self._before = self._signs  # a token that nobody refers to undeclares itself
        token = liveliness.declare_token(keys.alive(self._name, self._process))
        self._watching = session
        on_alive = partial(self._on_alive, session)
        self._signs = (token, liveliness.declare_subscriber(keys.alive("*"), on_alive, history=True))
        self._publishers = {lane: self._publisher(session, *lane) for lane in self._publishers}
        self._session = session
        for peer in {peer for link in self._links.values() for peer in link.rendezvous.handshakes}:
            self._lost(peer)
        if self._links:
            self.absent.waits(self._process)
        self.greet()

    @property
    def ready(self) -> bool:
        return all(link.rendezvous.ready for link in self._links.values())

    def link(
        self,
        below: Sequence[str],
        above: Sequence[str],
        version: int,
        instances: Mapping[str, int],
        opened: Callable[[int], None],
    ) -> None:
        rendezvous = Rendezvous(self._name, below, above, instances, version, self._process)
        for link in self._links.values():
            rendezvous.take_over(link.rendezvous)
        try:
            with self._declaring:
                self._declare(rendezvous)
        except zenoh.ZError as error:
            raise TransportError(f"{self._name}: Zenoh: {error}") from error
        link = Link(rendezvous, opened)
        self._links = {**self._links, version: link}
        self.absent.waits(self._process)
        self._tell_if_open(link)
        self.greet()

    def unlink(self, version: int) -> None:
        self._links = {later: link for later, link in self._links.items() if later >= version}
        needed = {(kind, peer) for link in self._links.values() for peer, kind in link.rendezvous.lanes_out}
        for lane in self._publishers.keys() - needed:
            self._undeclare(self._publishers.pop(lane))
            self._lends.pop(lane, None)
            self._forget(lane)
        self._lanes = {
            key: lane for link in self._links.values() for key, lane in self._lanes_of(link.rendezvous).items()
        }
        hands = (link.rendezvous.handshakes.items() for link in self._links.values())
        neighbours = {(peer, handshake.ends[1]) for each in hands for peer, handshake in each}
        self._readers = {each: reader for each, reader in self._readers.items() if each in neighbours}
        if self._shared is not None:
            self._shared.keep({peer for peer, _ in neighbours})

    def connect(self) -> bool:
        """Do the handshake with every neighbour, while another thread calls `greet`; whether it was not interrupted."""
        while not self.ready:
            try:
                message = self._next(connecting=True)
            except SchemaError as error:
                _log.warning("%s: dropped what is no message of ours: %s", self._name, error)
                continue
            if message is not None:
                self._early.append(message)
            elif not self.ready:
                return False
        return True

    def greet(self) -> None:
        """Say hello to every neighbour that the handshake is not done with."""
        for peer in {peer for link in self._links.values() for peer in link.rendezvous.missing}:
            self._greet(peer)

    def relieve(self) -> None:
        """Bound the bytes that wait while the node's thread is elsewhere; what had to be dropped is said again."""
        for key in self._inbox.relieve(self._lanes):
            peer, kind = self._lanes.get(key, ("", ""))
            _log.warning("%s: dropped %s messages from %s: too much waits", self._name, kind, peer)
            self._lost(peer)

    def send(self, message: Message) -> None:
        header = message.header
        self._put(header.kind, message)

    def receive(self) -> Message | None:
        return self._early.popleft() if self._early else self._next()

    def poll(self) -> Message | None:
        return self._early.popleft() if self._early else self._next(waits=False)

    def interrupt(self) -> None:
        self._inbox.interrupt()

    def answered(self) -> None:
        """Somebody was heard; where no neighbour is waited for, this process has the links that it needs."""
        if self.ready:
            self.absent.came(self._process)

    def _wake(self) -> None:
        with suppress(zenoh.ZError):  # closed, and so nobody waits
            self._session.put(self._own_key, b"", express=True)

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._beside is None:
            close_session(self._session)
        else:
            self._leave(self._beside)
        if self._shared is not None:
            self._shared.close()

    def _leave(self, beside: Neighbours) -> None:
        """Others go on in the session."""
        beside.pop(self._process).close()
        for declared in (*self._publishers.values(), self._subscriber, *self._signs):
            with suppress(zenoh.ZError):
                self._undeclare(declared)
        self._publishers = {}

    def _undeclare(self, declared: Any) -> None:
        """Undeclare something now, or, if another thread greets by it at this moment, once nobody refers to it."""
        try:
            with self._declaring:
                declared.undeclare()
        except RuntimeError:  # "Already borrowed"
            _log.debug("%s: something is undeclared later, as it is in use", self._name)

    def _declare(self, rendezvous: Rendezvous) -> None:
        for peer, kind in rendezvous.lanes_out:
            if (kind, peer) in self._publishers:
                continue
            self._publishers[kind, peer] = self._publisher(self._session, kind, peer)
            if self._shared is not None:
                self._lends[kind, peer] = partial(self._lend, self._shared.lender, (kind, peer))
        self._lanes = {**self._lanes, **self._lanes_of(rendezvous)}

    def _publisher(self, session: zenoh.Session, kind: str, peer: str) -> Any:
        return session.declare_publisher(
            self._keys.edge(kind, self._name, peer),
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            reliability=zenoh.Reliability.RELIABLE,
            # a task message is followed by context, and leaves in the same batch
            express=kind != TASKS,
        )

    def _lanes_of(self, rendezvous: Rendezvous) -> Mapping[str, Lane]:
        edge, name = self._keys.edge, self._name
        return {edge(kind, peer, name): (peer, kind) for peer, kind in rendezvous.lanes_in}

    def _on_alive(self, session: zenoh.Session, sample: zenoh.Sample) -> None:
        """Greet a neighbour as soon as its process is there; what is lost is said again by `greet`.

        One that is gone may be back: its link broke, and what was under way is lost. A session that it has left tells
        of what ends with it; and signs of life of nodes in this process say nothing of links to others."""
        found = living(str(sample.key_expr))
        if found is None or session is not self._watching:
            return
        peer, process = found
        if process == self._process or (self._beside is not None and process in self._beside):
            return
        if sample.kind != zenoh.SampleKind.PUT:
            self.absent.gone(process)
            self._lost(peer, process)
            return
        self.absent.came(process)
        with suppress(TransportError):  # closing: nobody is to be greeted any more
            self._greet(peer)

    def _lost(self, peer: str, process: str = "") -> None:
        """What was under way from a neighbour's process, or any of its, is lost: greetings and what follows mend it."""
        with self._shaking:
            for _, handshake in self._handshakes(peer):
                if process in ("", handshake.peer_process):
                    handshake.interrupted()

    def _handshakes(self, peer: str) -> Iterator[tuple[int, Handshake]]:
        """Those with a neighbour's processes, each once, and the last version of the roster that it is for."""
        seen: set[int] = set()
        for version, link in reversed(list(self._links.items())):
            handshake = link.rendezvous.handshakes.get(peer)
            if handshake is not None and id(handshake) not in seen:
                seen.add(id(handshake))
                yield version, handshake

    def _greet(self, peer: str) -> None:
        with self._shaking:
            greetings = [each.hello(version) for version, each in self._handshakes(peer) if not each.done]
        for greeting in greetings:
            self._put_all(greeting)

    def _next(self, connecting: bool = False, waits: bool = True) -> Message | None:
        """The next message.

        None: there is none, where nobody waits for one; or it was interrupted or closed, or, while connecting, a
        greeting came that was the last."""
        while not (waits and self._inbox.interrupted):
            try:
                sample = self._inbox.take(waits)
            except zenoh.ZError:
                return None  # the session is closed
            if sample is None:
                if not waits:
                    return None
                break  # it was interrupted
            key = sample.key if isinstance(sample, Handed) else str(sample.key_expr)
            lane = self._lanes.get(key)
            if lane is None:  # a wake-up; or from one that is no neighbour any more, or not yet, and will say it again
                if self._inbox.interrupted and not waits:
                    return None  # there may be any number of them
                continue
            if isinstance(sample, Handed):
                return sample.message
            self._peer = lane[0]
            try:
                message = decode_message(sample.payload.to_bytes(), self._borrow)
            except ForeignArrayError:
                continue
            header = message.header
            if lane == (header.sender, header.kind):
                return message
            if header.kind != HELLO:
                raise SchemaError(f"{header.kind} message from {header.sender!r} on key {key}", "message")
            self._hear(lane, key, message)
            if connecting and self.ready:
                return None
        self._inbox.interrupted = False
        return None

    def _borrow(self, told: bytes) -> Any:
        """The array that lies in memory of a neighbour's, by a message of its that is being read."""
        if self._shared is None:
            raise SchemaError(f"an array of {self._peer}'s lies in shared memory, which is not read here", "message")
        try:
            return self._shared.borrow(self._peer, told)
        except LostArrayError:
            self._lost(self._peer)  # it says again what is lost
            raise

    def _lend(self, lender: Lender, lane: Lane, array: NDArray[Any]) -> bytes | None:
        """Lend an array to a neighbour; None: it reads none, others listen, or another process takes over from it."""
        if self.heard():
            return None
        readers = [self._readers.get((lane[1], each.ends[1])) for _, each in self._handshakes(lane[1])]
        reader = readers[0] if len(readers) == 1 else None
        return None if reader is None else lender.lend(lane, reader, array)

    def _forget(self, lane: Lane) -> None:
        """What is under way on a lane is lost with its link, and its memory free."""
        if self._shared is not None:
            self._shared.lender.forget(lane)

    def _hear(self, lane: Lane, key: str, message: Message) -> None:
        """A neighbour's greeting; of whichever version, as the keys are the same, and the instance is looked at."""
        peer = lane[0]
        if peer != message.header.sender:
            raise SchemaError(f"a greeting from {message.header.sender!r} on key {key}", "message.sender")
        if self._shared is not None:
            reader = self._shared.heard(peer, message.header.extensions)
            self._readers[peer, message.header.instance] = reader
        mended = False
        for version, handshake in self._handshakes(peer):
            with self._shaking:
                answer = handshake.heard(version, lane[1], message)
                mended |= handshake.broken and handshake.done
                handshake.broken &= not handshake.done
            self._put_all(answer)
        for link in list(self._links.values()):
            self._tell_if_open(link)
        if mended:
            for sent in (sent for sent in self._lends if sent[1] == peer):
                self._forget(sent)
            self.answered()
            self.mended(peer)

    def _tell_if_open(self, link: Link) -> None:
        if not link.told and link.rendezvous.ready:
            link.told = True
            self.answered()
            link.opened(link.rendezvous.version)

    def _put_all(self, greetings: Iterable[tuple[str, Message]]) -> None:
        for kind, message in greetings:
            header = message.header
            told = NO_EXTENSIONS if self._shared is None else self._shared.greeting(header.receiver)
            self._put(kind, message._replace(header=header._replace(extensions=told)))

    def _put(self, kind: str, message: Message) -> None:
        lane = (kind, message.header.receiver)
        publisher = self._publishers.get(lane)
        if publisher is None:
            raise TransportError(f"{self._name}: {message.header.receiver!r} takes no {kind} messages from it")
        beside = self._beside
        inbox = None if beside is None else self._inbox_of(beside, message)
        if beside is not None and inbox is not None:
            handed = hand_over(self._keys.edge(kind, self._name, message.header.receiver), message)
            inbox.put(handed, beside[self._process])
            return
        data = encode_message(message, self._lends.get(lane))
        if len(data) > self._most_bytes:
            what = f"a {kind} message of {len(data)} bytes for {message.header.receiver}"
            raise TransportError(f"{self._name}: {what}; low-latency links carry at most {self._most_bytes}")
        try:
            publisher.put(data)
        except zenoh.ZError as error:
            raise TransportError(f"{self._name}: cannot send to {message.header.receiver}: {error}") from error

    def _inbox_of(self, beside: Neighbours, message: Message) -> SharedInbox | None:
        """Where a neighbour in this process takes messages from; None: it is elsewhere, or others hear them, too."""
        header = message.header
        link = self._links.get(header.roster)
        if link is None or header.kind == HELLO or self.heard():
            return None
        handshake = link.rendezvous.handshakes.get(header.receiver)
        return None if handshake is None else beside.get(handshake.peer_process)
