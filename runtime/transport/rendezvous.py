"""The handshake on the real keys that makes sure nothing is lost at the start; no input or output.

What is put on a Zenoh key before its subscriber is known at the sender is lost in
silence, and a liveliness token says only that a process is there. So the two ends of
an edge say hello to each other on every key of the edge, again and again, each time
with what they have heard of the other, until both have heard all: from then on the
keys carry whatever is put on them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, TASKS, Header, Message

UP = (OBSERVATIONS,)
DOWN = (TASKS, CONTEXT)
"""The kinds of messages along an edge, by direction."""


class Rendezvous:
    """One node's side of the handshakes with all its neighbours.

    Args:
        name: of the node.
        below, above: names of its neighbours.
        instances: instance numbers, of the node and of its neighbours.
        roster: the roster's version.
    """

    def __init__(
        self, name: str, below: Iterable[str], above: Iterable[str], instances: Mapping[str, int], roster: int
    ) -> None:
        self._name = name
        self._instances = instances
        self.version = roster
        self.sends: dict[str, tuple[str, ...]] = {**dict.fromkeys(above, UP), **dict.fromkeys(below, DOWN)}
        self.hears: dict[str, tuple[str, ...]] = {**dict.fromkeys(above, DOWN), **dict.fromkeys(below, UP)}
        # replaced, never changed in place: another thread may be reading them
        self._heard: dict[str, frozenset[str]] = dict.fromkeys(self.sends, frozenset())
        self._confirmed: set[str] = set()

    @property
    def lanes_out(self) -> list[tuple[str, str]]:
        """Neighbour and kind of all that goes out."""
        return [(peer, kind) for peer, kinds in self.sends.items() for kind in kinds]

    def take_over(self, earlier: Rendezvous) -> None:
        """Have the handshakes of another version count for neighbours whose processes, and ours, are the same."""
        if earlier._instance(self._name) != self._instance(self._name):
            return
        for peer, kinds in self.hears.items():
            same = earlier.hears.get(peer) == kinds and earlier._instance(peer) == self._instance(peer)
            if same and earlier._done(peer):
                self._heard[peer] = frozenset(kinds)
                self._confirmed.add(peer)

    @property
    def ready(self) -> bool:
        """Whether every neighbour hears this node and is heard."""
        return not self.missing

    @property
    def missing(self) -> tuple[str, ...]:
        """The neighbours that the handshake is not done with."""
        return tuple(peer for peer in sorted(self.sends) if not self._done(peer))

    def hello(self, peer: str, asks: bool = True) -> list[tuple[str, Message]]:
        """The greeting for a neighbour: by kind of key, what to put there.

        Args:
            peer: the neighbour.
            asks: whether it wants an answer; an answer wants none, or two that miss the same
                key would answer each other for ever.
        """
        payload = ({"heard": tuple(sorted(self._heard[peer])), "asks": asks and not self._done(peer)},)
        header = Header(HELLO, self._name, peer, 0, roster=self.version, instance=self._instance(self._name))
        return [(kind, Message(header, payload)) for kind in self.sends[peer]]

    def heard(self, kind: str, message: Message) -> list[tuple[str, Message]]:
        """Take in a greeting that came on the key of `kind`.

        Returns:
            The answer, if one is asked for; none to what is not the instance of the roster.

        Raises:
            SchemaError: it is no greeting from a neighbour.
        """
        header = message.header
        peer = header.sender
        if peer not in self.hears or kind not in self.hears[peer]:
            raise SchemaError(f"a greeting from {peer!r}, which sends no {kind} to {self._name!r}", "message.sender")
        if header.instance != self._instance(peer) or header.roster != self.version:
            return []
        heard, asks = _read(message)
        self._heard[peer] |= {kind}
        if set(self.sends[peer]) <= heard:
            self._confirmed.add(peer)
        return self.hello(peer, asks=False) if asks else []

    def _instance(self, name: str) -> int:
        return self._instances.get(name, 0)

    def _done(self, peer: str) -> bool:
        return peer in self._confirmed and len(self._heard[peer]) == len(self.hears[peer])


def _read(message: Message) -> tuple[set[str], bool]:
    body = message.payload[0] if len(message.payload) == 1 else None
    if not isinstance(body, dict) or not isinstance(body.get("heard"), tuple) or not isinstance(body.get("asks"), bool):
        raise SchemaError("expected one map with 'heard' and 'asks'", "message.payload")
    return {kind for kind in body["heard"] if isinstance(kind, str)}, body["asks"]
