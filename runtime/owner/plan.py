"""A version of the roster on its way to take effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from hierax.runtime.owner.roster_changes import Undo
from hierax.schemas.changes import Change, Replace, new_nodes
from hierax.schemas.roster import Roster


class Stage(Enum):
    """What a plan waits for."""

    PREPARE = "the processes that it touches"
    READY = "the end of the epoch"
    HAND_OVER = "the states of the nodes that are replaced"


Born = tuple[int, int, str]
"""The version with which a node came in, the first epoch that it took part in, and the request of it."""


@dataclass(frozen=True)
class Trial:
    """A node that has replaced another one, until its first epoch is committed.

    Attributes:
        name: of the node.
        before: the roster that was in force before.
        process: of what it has replaced, which waits; empty: it has died.
        born: of that.
        alone, on_loss, rejoin_timeout_s: what held for that; None where nothing was said.
    """

    name: str
    before: Roster
    process: str
    born: Born
    alone: bool
    on_loss: str | None
    rejoin_timeout_s: float | None


@dataclass
class Request:
    """A change that somebody asked for.

    Attributes:
        key: by which the answer is told apart; empty: the owner itself asks.
        change: what is wanted.
        since_s: when it was asked for.
        on_loss, rejoin_timeout_s, alone: of its new nodes, as `OwnerPolicy` has them.
        tries: how often a plan with it had to be dropped.
    """

    key: str
    change: Change | Undo
    since_s: float
    on_loss: Mapping[str, str] = field(default_factory=dict)
    rejoin_timeout_s: Mapping[str, float] = field(default_factory=dict)
    alone: tuple[str, ...] = ()
    tries: int = 0

    @property
    def new_nodes(self) -> tuple[str, ...]:
        """The nodes for which it needs processes."""
        return () if isinstance(self.change, Undo) else tuple(sorted(new_nodes(self.change)))


@dataclass
class Plan:
    """A version that is prepared.

    Attributes:
        roster: what will be.
        processes: by node.
        request: the change in it; None: there is none, or only those along with it.
        along: lost nodes that are detached with it.
        back: nodes that come back.
        waiting: nodes of which an answer is missing.
        urgent: the epoch under way cannot end without it.
        since_s: when its stage began.
        told_s: when those that are waited for were last told.
        replaced: by node that is replaced, its old process.
    """

    roster: Roster
    processes: Mapping[str, str]
    request: Request | None
    along: tuple[Request, ...]
    back: frozenset[str]
    waiting: set[str]
    urgent: bool
    since_s: float
    told_s: float
    replaced: Mapping[str, str]
    stage: Stage = Stage.PREPARE
    states: dict[str, bytes] = field(default_factory=dict)

    @property
    def requests(self) -> list[Request]:
        """All that is asked for in it."""
        return [*self.along, *([] if self.request is None else [self.request])]

    @property
    def tried(self) -> str:
        """The node in it that replaces another one; empty: there is none."""
        change = None if self.request is None else self.request.change
        return change.name if isinstance(change, Replace) else ""

    @property
    def undone(self) -> str:
        """The node that is what it was before it was replaced; empty: there is none."""
        change = None if self.request is None else self.request.change
        return change.name if isinstance(change, Undo) else ""

    @property
    def version(self) -> int:
        """Of its roster."""
        return self.roster.version

    def is_for(self, name: str, key: str) -> bool:
        """Whether a newcomer for a node, there for a request or without one, has a place in it."""
        return name in self.back if not key else self.request is not None and self.request.key == key
