"""Copies of a node's messages, for who wants to see them; the run never waits for them."""

from __future__ import annotations

from collections.abc import Callable, Collection

from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import Message, encode_message

Edge = tuple[str, str, str]
"""Kind, sender and receiver."""


class Copier(Watcher):
    """Shows copies of what a node sends, by kind, sender and receiver; `show` must not wait.

    Attributes:
        wanted: of which messages; replaced, never changed in place.
    """

    def __init__(self, show: Callable[[str, str, str, bytes], None]) -> None:
        self._show = show
        self.wanted: Collection[Edge] = frozenset()

    def sent(self, message: Message) -> None:
        kind, sender, receiver = message.header[:3]
        if (kind, sender, receiver) in self.wanted:
            self._show(kind, sender, receiver, encode_message(message))
