"""One engine by itself, and right messages for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.hierarchy import BoundEdge, Edge
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message
from hierax.schemas.values import encode_value
from support.hierarchies import Mix, MixingNode, MixingWorld
from support.recording import Output, Recorder

DIGEST = bytes(range(32))
ROSTER = 4
INSTANCES = {"low": 7, "mid": 8, "top": 9, "low2": 17, "top2": 19}
EPOCH = (OBSERVATIONS, TASKS, CONTEXT)
"""The kinds of messages that an epoch of a node in the middle takes, in order."""

POLICIES = 4


def wiring(
    name: str = "mid",
    below: tuple[str, ...] = ("low",),
    above: tuple[str, ...] = ("top",),
    roster: int = ROSTER,
    instances: Mapping[str, int] = INSTANCES,
    mixing: bool = False,
) -> Wiring:
    """A node among neighbours; those above it give it tasks, but for a world.

    Args:
        name: of the node; without any below, it is a world.
        below, above: names of the neighbours, in order.
        roster: its version.
        instances: by name.
        mixing: whether the edges have functions at the node's side.
    """
    setting = OperatorSetting()
    node = MixingNode(name, POLICIES) if below else MixingWorld(name, POLICIES)
    pairs = [(lower, name) for lower in below] + [(name, upper) for upper in above]
    edges = [_edge(*pair, mixing) for pair in pairs]
    tasking = frozenset((name, upper) for upper in above if below)
    place = Place(roster, DIGEST, instances, tasking)
    return Wiring(BoundNode(name, node, below, above, setting), [BoundEdge.of(edge, setting) for edge in edges], place)


class Solo:
    """One engine, and all that it calls.

    Args:
        wired: by default a node in the middle.
        saved, joins: of the engine.
    """

    def __init__(self, wired: Wiring | None = None, saved: Saved | None = None, joins: bool = False) -> None:
        self.recorder = Recorder()
        self.engine = Engine(wiring() if wired is None else wired, self.recorder, saved=saved, joins=joins)

    def take(self, *messages: Message) -> list[Output]:
        """What the engine calls when these come."""
        for each in messages:
            self.engine.receive(each)
        return self.recorder.take()

    def epoch(self, epoch: int = 1, **change: Any) -> list[Output]:
        """What the engine, one in the middle, calls when all of an epoch comes."""
        return self.take(*(message(kind, epoch, **change) for kind in EPOCH))

    def begin(self, attempt: int = 0) -> list[Output]:
        """What the engine, a world's, calls when it begins an epoch."""
        self.engine.begin(attempt)
        return self.recorder.take()

    def begin_again(self, attempt: int) -> list[Output]:
        """What the engine, a world's, calls when it begins the epoch again."""
        self.engine.begin_again(attempt)
        return self.recorder.take()

    def prepare(self, wired: Wiring) -> list[Output]:
        """What the engine calls when it is given a wiring."""
        self.engine.prepare(wired)
        return self.recorder.take()


def message(kind: str, epoch: int = 1, text: str | None = None, **change: Any) -> Message:
    """A right message to the middle node: from `low` or `top`, where nothing else is said.

    Args:
        kind: of the message.
        epoch: which.
        text: the element in it; by default of kind and epoch.
        change: other fields of the header.
    """
    sender = change.get("sender", "low" if kind == OBSERVATIONS else "top")
    digest = DIGEST if kind == CONTEXT else b""
    header = Header(kind, sender, "mid", epoch, 0, ROSTER, INSTANCES.get(sender, 0), 0.5, digest)
    return Message(header._replace(**change), (f"{kind} {epoch}" if text is None else text,))


def other(kind: str, epoch: int = 1, **change: Any) -> Message:
    """A right message from `low2` or `top2`, the second ones below and above."""
    sender = "low2" if kind == OBSERVATIONS else "top2"
    return message(kind, epoch, **{"sender": sender, **change})


def encoded(active: ActiveNode) -> bytes:
    """The bytes of a state."""
    return encode_value(tuple(active))


def _edge(lower: str, upper: str, mixing: bool) -> Edge:
    if not mixing:
        return Edge(lower, upper)
    functions = {kind: Mix(f"{lower}->{upper} {kind}") for kind in ("sense", "task", "context")}
    return Edge(lower, upper, **functions)
