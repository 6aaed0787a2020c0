"""Which messages somebody wants to see, and how many of them come, how large."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Message, decode_message

Edge = tuple[str, str, str]  # kind, sender and receiver
WINDOW = 100  # over how many messages, the last ones, a rate is taken
SHORTEST_S = 0.1  # over a shorter time than this none is: messages may come in bursts


def short_key(edge: Edge) -> str:
    """An edge and kind as ``KIND/FROM/TO``."""
    return "/".join(edge)


def edges_of(pairs: Iterable[tuple[str, str]]) -> list[Edge]:
    """The keys of all messages along edges, given as (lower, upper), in order."""
    found: list[Edge] = []
    for lower, upper in pairs:
        found += [(OBSERVATIONS, lower, upper), (TASKS, upper, lower), (CONTEXT, upper, lower)]
    return sorted(found)


def chosen(pattern: str, edges: Sequence[Edge]) -> list[Edge]:
    """The edges that a pattern stands for. `pattern`: ``KIND/FROM/TO``, where ``*`` stands for any name and ``?`` for
    any letter, or ``**`` for all that is left; as a key in full it may begin with ``hierax/…/…/``. `edges`: those that
    there are. Raises `HieraxError` if it stands for none; with the nearest one."""
    given = pattern.split("/")
    parts = given[3:] if given[0] == "hierax" and len(given) > 3 else given
    if parts and parts[-1] == "**":
        parts = [*parts[:-1], *("*" for _ in range(4 - len(parts)))]
    found = [edge for edge in edges if len(parts) == 3 and all(map(fnmatchcase, edge, parts))]
    if not found:
        known = did_you_mean(pattern, map(short_key, edges), "there are")
        raise HieraxError(f"no key fits {pattern!r}: expected KIND/FROM/TO, with * for any{known}")
    return found


def edge_of(key: str) -> Edge:
    """The edge that a key of copies names; of what nodes show beside messages the kind is no message's."""
    kind, sender, receiver = key.split("/")[-3:]
    return kind, sender, receiver


def message_of(edge: Edge, data: bytes) -> Message:
    """The message that was shown on the key of an edge. That key alone tells who may show something there, so one that
    says it is of another edge is none. Raises `SchemaError` if it is none."""
    message = decode_message(data)
    if message.header.line != edge:
        said = shown(short_key(message.header.line))
        raise SchemaError(f"expected what its key names, got {said}", "message")
    return message


class Echo(NamedTuple):
    """A message that somebody sees."""

    message: Message  # decoded
    size: int  # bytes on the wire
    rate_hz: float | None  # how often messages with this key have come of late; None where there are too few to say
    missed: int  # epochs between the last message with this key and this one of which none came here


class Counter:
    """Counts the messages of each key. `clock`: seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lanes: dict[Edge, deque[tuple[float, int]]] = {}  # when the last messages came, and their epochs

    def take(self, message: Message, size: int) -> Echo:
        kind, sender, receiver, epoch = message.header[:4]
        lane = self._lanes.setdefault((kind, sender, receiver), deque(maxlen=WINDOW))
        last = max((earlier for _, earlier in lane), default=epoch)
        lane.append((self._clock(), epoch))
        passed_s = lane[-1][0] - lane[0][0]
        rate_hz = (len(lane) - 1) / passed_s if passed_s >= SHORTEST_S else None
        return Echo(message, size, rate_hz, max(epoch - last - 1, 0))
