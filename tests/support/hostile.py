"""Somebody who speaks to a launch and is no part of it: hears all that is said, and says what it likes."""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType

import zenoh

from hierax.runtime.transport.zenoh_session import close_session, open_session
from hierax.schemas.control import Control, encode_control
from hierax.schemas.keys import Keys
from hierax.schemas.messages import Message, decode_message, encode_message
from hierax.schemas.values import Value, decode_value, encode_value
from support.live import until

KEPT = 4096


class Stranger:
    """A plain session beside a launch.

    Args:
        endpoint: of the launch's hub.
        keys: of the run.
        kept: how many of the last messages are remembered.
        secret: of the run; without it nothing is heard of a run that is closed.

    Attributes:
        heard: keys and bytes, the last ones.
    """

    def __init__(self, endpoint: str, keys: Keys, kept: int = KEPT, secret: str = "") -> None:
        self.keys = keys
        self.session = open_session(connect=[endpoint], shared_memory=False, links="all", secret=secret)
        self.heard: deque[tuple[str, bytes]] = deque(maxlen=kept)
        self._changed = threading.Event()
        self._ear = self.session.declare_subscriber(keys.everything, self._on_sample)

    def reaches(self, key: str) -> None:
        """Wait until somebody else hears a key: what is put there before is lost."""
        publisher = self.session.declare_publisher(key, allowed_destination=zenoh.Locality.REMOTE)
        until(lambda: publisher.matching_status.matching, f"somebody who hears {key}")
        publisher.undeclare()

    def put(self, key: str, data: bytes) -> None:
        """Say some bytes on a key."""
        self.session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

    def say(self, address: str, word: Control) -> None:
        """Say a control message: to a process by its token, or to the ``owner``, in the name that it has."""
        key = self.keys.words(getattr(word, "name", "low")) if address == "owner" else self.keys.control(address)
        self.put(key, encode_control(word))

    def send(self, message: Message) -> None:
        """Send a message along an edge."""
        header = message.header
        self.put(self.keys.edge(header.kind, header.sender, header.receiver), encode_message(message))

    def ask(self, key: str, question: bytes | Value, timeout_s: float = 5.0) -> list[Value]:
        """What is answered."""
        data = question if isinstance(question, bytes) else encode_value(question)
        replies = self.session.get(key, payload=data, timeout=timeout_s)
        return [decode_value(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]

    def next(self, kind: str, sender: str, receiver: str, timeout_s: float = 30.0) -> Message:
        """The next message of an edge that is heard."""
        key = self.keys.edge(kind, sender, receiver)
        before = self._last(key)
        while (found := self._last(key)) is None or found == before:
            self._changed.clear()
            if not self._changed.wait(timeout_s):
                raise AssertionError(f"nothing was heard on {key}")
        return decode_message(found)

    def _last(self, key: str) -> bytes | None:
        return next((data for heard, data in reversed(list(self.heard)) if heard == key), None)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes()))
        self._changed.set()

    def close(self) -> None:
        """Go away."""
        close_session(self.session)

    def __enter__(self) -> Stranger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
