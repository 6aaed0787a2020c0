"""Copies of a node's messages, for who wants to see them; the run never waits for them."""

from __future__ import annotations

from collections.abc import Callable, Collection

from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import Message, encode_message

Edge = tuple[str, str, str]
"""Kind, sender and receiver."""


class Copier(Watcher):
    """Shows copies of the `wanted` messages, a set that is replaced and never changed; `show` must not wait."""

    def __init__(self, show: Callable[[str, str, str, bytes], None]) -> None:
        self._show = show
        self.wanted: Collection[Edge] = frozenset()

    def sent(self, message: Message) -> None:
        kind, sender, receiver = message.header[:3]
        if (kind, sender, receiver) in self.wanted:
            self._show(kind, sender, receiver, encode_message(message))
