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
    """A node that has replaced another one, until its first epoch is committed."""

    name: str  # of the node
    before: Roster  # the roster that was in force before
    process: str  # of what it has replaced, which waits; empty: it has died, and another one may come
    born: Born  # of that
    alone: bool  # what held for that; None where nothing was said
    on_loss: str | None  # likewise
    rejoin_timeout_s: float | None  # likewise
    came_back: bool = False  # whether that process has come in the place of one that has died
    gone: str = ""  # why no process of what it has replaced can come; empty: one may


@dataclass
class Request:
    """A change that somebody asked for."""

    key: str  # by which the answer is told apart; empty: the owner itself asks
    change: Change | Undo  # what is wanted
    since_s: float  # when it was asked for
    on_loss: Mapping[str, str] = field(default_factory=dict)  # of its new nodes, as `OwnerPolicy` has them
    rejoin_timeout_s: Mapping[str, float] = field(default_factory=dict)  # likewise
    alone: tuple[str, ...] = ()  # likewise
    tries: int = 0  # how often a plan with it had to be dropped

    @property
    def new_nodes(self) -> tuple[str, ...]:
        """The nodes for which it needs processes."""
        return () if isinstance(self.change, Undo) else tuple(sorted(new_nodes(self.change)))


@dataclass
class Plan:
    """A version that is prepared."""

    roster: Roster  # what will be
    processes: Mapping[str, str]  # by node
    request: Request | None  # the change in it; None: there is none, or only those along with it
    along: tuple[Request, ...]  # lost nodes that are detached with it
    back: frozenset[str]  # nodes that come back
    waiting: set[str]  # nodes of which an answer is missing
    urgent: bool  # the epoch under way cannot end without it
    since_s: float  # when its stage began
    told_s: float  # when those that are waited for were last told
    replaced: Mapping[str, str]  # by node that is replaced, its old process
    stage: Stage = Stage.PREPARE
    states: dict[str, bytes] = field(default_factory=dict)

    @property
    def requests(self) -> list[Request]:
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
        return self.roster.version

    def is_for(self, name: str, key: str) -> bool:
        """Whether a newcomer for a node, there for a request or without one, has a place in it."""
        return name in self.back if not key else self.request is not None and self.request.key == key
