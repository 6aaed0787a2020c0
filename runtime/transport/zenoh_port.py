"""A node's port over Zenoh: one publisher for each outgoing key, one subscriber for all incoming ones."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import zenoh

from hierax.runtime.transport.port import Port, TransportError
from hierax.runtime.transport.rendezvous import Rendezvous
from hierax.runtime.transport.zenoh_session import close_session
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.messages import HELLO, TASKS, Message, decode_message, encode_message
from hierax.schemas.values import encode_value

_log = logging.getLogger("hierax")

QUEUE_SIZE = 256
"""How many messages wait in a port; when it is full, the senders wait."""

LOOKS = 60
"""How often a port looks for a message before it sleeps: some fifty microseconds' worth."""

INTERRUPT = "interrupt"
"""Kind of the key on which a process wakes up its own port."""


class ZenohPort(Port):
    """A node's end of its edges in a process of its own. It owns its session.

    One thread receives; others may call `greet` and `interrupt`.

    Args:
        session: an open session.
        keys: of the run.
        name: of the node.
        below, above: names of its neighbours.
        instances: instance numbers, of the node and of its neighbours.
        roster: the roster's version.

    Raises:
        TransportError: Zenoh refuses a declaration.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        name: str,
        below: Iterable[str],
        above: Iterable[str],
        instances: Mapping[str, int] | None = None,
        roster: int = 0,
    ) -> None:
        self._session = session
        self._name = name
        self._interrupted = False
        self._closed = False
        self._early: deque[Message] = deque()
        self._instances = instances or {}
        self.rendezvous = Rendezvous(name, below, above, self._instances, roster)
        self._own_key = keys.edge(INTERRUPT, name, name)
        self._lanes = {
            keys.edge(kind, peer, name): (peer, kind) for peer, kinds in self.rendezvous.hears.items() for kind in kinds
        }
        try:
            self._declare(keys)
        except zenoh.ZError as error:
            raise TransportError(f"{name}: Zenoh: {error}") from error

    def connect(self) -> bool:
        """Do the handshake with every neighbour; in the receiving thread, while another one calls `greet`.

        Returns:
            Whether it was done; not so where the port was interrupted.
        """
        while not self.rendezvous.ready:
            try:
                message = self._next(connecting=True)
            except SchemaError as error:
                _log.warning("%s: dropped what is no message of ours: %s", self._name, error)
                continue
            if message is not None:
                self._early.append(message)
            elif not self.rendezvous.ready:
                return False
        return True

    def greet(self) -> None:
        """Say hello to every neighbour that the handshake is not done with."""
        for peer in self.rendezvous.missing:
            self._put_all(self.rendezvous.hello(peer))

    def send(self, message: Message) -> None:
        header = message.header
        self._put(header.kind, message)

    def receive(self) -> Message | None:
        if self._early:
            return self._early.popleft()
        return self._next()

    def interrupt(self) -> None:
        self._interrupted = True
        try:
            self._session.put(self._own_key, b"", express=True)
        except zenoh.ZError:
            return  # closed, and so nobody waits

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            close_session(self._session)

    def _declare(self, keys: Keys) -> None:
        name = self._name
        self._publishers: dict[tuple[str, str], Any] = {
            (kind, peer): self._session.declare_publisher(
                keys.edge(kind, name, peer),
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME,
                reliability=zenoh.Reliability.RELIABLE,
                # a task message is followed by context, and leaves in the same batch
                express=kind != TASKS,
            )
            for peer, kinds in self.rendezvous.sends.items()
            for kind in kinds
        }
        self._inbox = self._session.declare_subscriber(keys.inbox(name), zenoh.handlers.FifoChannel(QUEUE_SIZE))
        liveliness = self._session.liveliness()
        # a token that nobody refers to undeclares itself
        self._token = liveliness.declare_token(keys.alive(name, self._instances.get(name, 0)))
        self._births = liveliness.declare_subscriber(keys.alive("*"), self._on_alive, history=True)

    def _on_alive(self, sample: zenoh.Sample) -> None:
        """Greet a neighbour as soon as its process is there; what is lost is said again by `greet`."""
        peer = str(sample.key_expr).split("/")[-2]
        if sample.kind != zenoh.SampleKind.PUT or peer not in self.rendezvous.missing:
            return
        try:
            self._put_all(self.rendezvous.hello(peer))
        except TransportError:
            return  # closing: nobody is to be greeted any more

    def _next(self, connecting: bool = False) -> Message | None:
        """The next message; None when interrupted, closed, or, while connecting, after a greeting that was the last."""
        while True:
            try:
                sample = self._wait()
            except zenoh.ZError:
                return None  # the session is closed
            key = str(sample.key_expr)
            if key == self._own_key:
                if self._interrupted:  # else it is not from us
                    self._interrupted = False
                    return None
                continue
            lane = self._lanes.get(key)
            message = decode_message(sample.payload.to_bytes())
            if lane is None or lane[0] != message.header.sender:
                raise SchemaError(
                    f"from {message.header.sender!r} on key {key}, where it has nothing to say", "message"
                )
            if message.header.kind == HELLO:
                self._put_all(self.rendezvous.heard(lane[1], message))
                if connecting and self.rendezvous.ready:
                    return None
            elif message.header.kind == lane[1]:
                return message
            else:
                raise SchemaError(f"a {message.header.kind} message on key {key}", "message.kind")

    def _wait(self) -> zenoh.Sample:
        """The next sample: looked for a moment, then slept for.

        In an epoch of small messages the next one is some ten microseconds away, and a
        thread that sleeps on a processor that sleeps takes longer than that to wake.
        """
        for _ in range(LOOKS):
            sample = self._inbox.try_recv()
            if sample is not None:
                return sample
            os.sched_yield()
        return self._inbox.recv()

    def _put_all(self, greetings: Iterable[tuple[str, Message]]) -> None:
        for kind, message in greetings:
            self._put(kind, message)

    def _put(self, kind: str, message: Message) -> None:
        publisher = self._publishers.get((kind, message.header.receiver))
        if publisher is None:
            raise TransportError(f"{self._name}: {message.header.receiver!r} takes no {kind} messages from it")
        data = encode_message(message)
        try:
            publisher.put(data)
        except zenoh.ZError as error:
            raise TransportError(f"{self._name}: cannot send to {message.header.receiver}: {error}") from error


class EpochPublisher:
    """Tells whoever listens each committed epoch and its digest; nothing waits for it."""

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._publisher: Any = session.declare_publisher(
            keys.epochs, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA_LOW
        )

    def publish(self, epoch: int, digest: bytes) -> None:
        """Publish the encoding of (epoch, digest)."""
        self._publisher.put(encode_value((epoch, digest)))
