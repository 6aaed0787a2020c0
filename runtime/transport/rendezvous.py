"""The handshake on the real keys that makes sure nothing is lost, and who is missed; no input or output.

What is put on a Zenoh key before its subscriber is known at the sender is lost in silence, and a liveliness token says
only that a process is there. So the two ends of an edge say hello to each other on every key of the edge, again and
again, each time with what they have heard of the other, until both have heard all: from then on the keys carry whatever
is put on them, until the link breaks. Then it is done anew.

Each end has a mark: its process's token, and how often its link broke. A greeting holds the mark of who sends it, and
that of who it was heard from. What is said to another mark counts for nothing: it may be older than the break, or for a
process that was killed. A mark that is another than before is itself a break, which the one end has noticed and the
other may not have."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, TASKS, Header, Message

UP = (OBSERVATIONS,)
DOWN = (TASKS, CONTEXT)  # the kinds of messages along an edge, by direction
UNKNOWN = ""  # the mark of a neighbour that was not heard of yet

# How long after a process was last heard of it is asked for; most that are gone have died.
TRIES_S = (0.3, 1.0, 3.0, 10.0)

FIRST_TRY = 2  # which of these comes first for a process that nobody has answered yet: most others only start up


@dataclass(eq=False)
class Handshake:
    """One node's side of the handshake with one process of a neighbour."""

    name: str  # of the node
    process: str  # of the node, by its token
    peer: str  # the neighbour's name
    ends: tuple[int, int]  # the instance numbers of the node and of the neighbour
    sends: tuple[str, ...]  # kinds of messages that go to the neighbour
    hears: tuple[str, ...]  # kinds of messages that come from there
    broken: bool = False  # whether it was done once, and the link broke since
    _breaks: int = 0
    _theirs: str = UNKNOWN
    _heard: frozenset[str] = frozenset()
    _confirmed: bool = False

    @property
    def done(self) -> bool:
        """Whether the neighbour hears this node and is heard."""
        return self._confirmed and len(self._heard) == len(self.hears)

    @property
    def peer_process(self) -> str:
        """The token of the neighbour's process, as it was last heard of; may be empty."""
        return self._theirs.rpartition("/")[0]

    def hello(self, version: int, asks: bool = True) -> list[tuple[str, Message]]:
        """The greeting: by kind of key, what to put there.

        An answer does not ask for one, or two that miss the same key would answer each other for ever."""
        body = {
            "heard": tuple(sorted(self._heard)),
            "asks": asks and not self.done,
            "from": self._mark,
            "to": self._theirs,
        }
        header = Header(HELLO, self.name, self.peer, 0, roster=version, instance=self.ends[0])
        return [(kind, Message(header, (body,))) for kind in self.sends]

    def heard(self, version: int, kind: str, message: Message) -> list[tuple[str, Message]]:
        """Take in a greeting; the answer, if it wants one. Raises `SchemaError` if it is none."""
        if kind not in self.hears or message.header.instance != self.ends[1]:
            return []
        heard, asks, theirs, ours = _read(message)
        if theirs != self._theirs:
            self._begin_anew()
            self._theirs = theirs
        if ours in (UNKNOWN, self._mark):
            self._heard |= {kind}
        if ours == self._mark and set(self.sends) <= heard:
            self._confirmed = True
        return self.hello(version, asks=False) if asks else []

    def interrupted(self) -> None:
        """The link broke: what was under way is lost, and the handshake is to be done anew."""
        self._breaks += 1
        self._begin_anew()

    @property
    def _mark(self) -> str:
        return f"{self.process}/{self._breaks}"

    def _begin_anew(self) -> None:
        self.broken |= self.done
        self._heard = frozenset()
        self._confirmed = False


class Rendezvous:
    """One node's side of the handshakes with all its neighbours, under a version of the roster."""

    def __init__(
        self,
        name: str,  # of the node
        below: Iterable[str],  # names of its neighbours
        above: Iterable[str],  # likewise
        instances: Mapping[str, int],  # instance numbers, of the node and of its neighbours
        roster: int,  # the roster's version
        process: str = "0",  # the token of the node's process
    ) -> None:
        self.version = roster  # of the roster
        ends = {**dict.fromkeys(above, (UP, DOWN)), **dict.fromkeys(below, (DOWN, UP))}
        own = instances.get(name, 0)
        self.handshakes = {
            peer: Handshake(name, process, peer, (own, instances.get(peer, 0)), sends, hears)
            for peer, (sends, hears) in ends.items()
        }

    @property
    def lanes_out(self) -> list[tuple[str, str]]:
        return [(peer, kind) for peer, handshake in self.handshakes.items() for kind in handshake.sends]

    @property
    def lanes_in(self) -> list[tuple[str, str]]:
        return [(peer, kind) for peer, handshake in self.handshakes.items() for kind in handshake.hears]

    def take_over(self, earlier: "Rendezvous") -> None:
        """Share the handshakes of another version with neighbours whose processes, and ours, are the same."""
        for peer, handshake in self.handshakes.items():
            known = earlier.handshakes.get(peer)
            if known is not None and (known.ends, known.hears) == (handshake.ends, handshake.hears):
                self.handshakes[peer] = known

    @property
    def ready(self) -> bool:
        return not self.missing

    @property
    def missing(self) -> tuple[str, ...]:
        """The neighbours that the handshake is not done with."""
        return tuple(peer for peer in sorted(self.handshakes) if not self.handshakes[peer].done)


def _read(message: Message) -> tuple[frozenset[str], bool, str, str]:
    """What a greeting holds: the kinds that its sender has heard, whether it asks, its mark, and the other's."""
    body = message.payload[0] if len(message.payload) == 1 else None
    types = {"heard": tuple, "asks": bool, "from": str, "to": str}
    if not isinstance(body, dict) or any(not isinstance(body.get(key), type_) for key, type_ in types.items()):
        raise SchemaError("expected one map with 'heard', 'asks', 'from' and 'to'", "message.payload")
    heard = frozenset(kind for kind in body["heard"] if isinstance(kind, str))
    return heard, body["asks"], body["from"], body["to"]


class AbsentProcesses:
    """Processes that one end has lost sight of, though they may live: their link broke, and nobody dials it again.

    Zenoh dials the hub again by itself, and peers when the hub tells of them anew. Where the link between two peers
    breaks and both keep theirs to the hub, nobody does, nor where it could not be opened in the first place. Whoever
    misses a process, or waits for an answer itself, then says so, and the hub tells of all anew (`Hub.introduce`)."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock  # seconds
        self._since: dict[str, tuple[float, int]] = {}
        self._waiting: set[str] = set()

    def gone(self, process: str) -> None:
        """Note that its liveliness token is not there any more; any thread may say so."""
        self._since[process] = (self._clock(), 0)

    def came(self, process: str) -> None:
        """Note that its liveliness token is there."""
        self._waiting.discard(process)
        self._since.pop(process, None)

    def waits(self, process: str) -> None:
        """Note that this process waits for others that it may have no link to yet; until it `came` to have them.

        It asks as long as it waits: on a busy machine the links that it was told of may not open in time either."""
        self._waiting.add(process)
        self._since.setdefault(process, (self._clock(), FIRST_TRY))

    def due(self) -> list[str]:
        now = self._clock()
        missed = []
        for process, (since_s, tries) in list(self._since.items()):
            if now - since_s < TRIES_S[tries]:
                continue
            missed.append(process)
            if process in self._waiting and tries + 1 == len(TRIES_S):
                self._since[process] = (now, tries)
            elif tries + 1 == len(TRIES_S):
                self._since.pop(process, None)
            elif process in self._since:
                self._since[process] = (since_s, tries + 1)
        return missed
