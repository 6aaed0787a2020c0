"""Which process runs which node, who is lost, who offers to come in; and the version that is on its way."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf

from hierax.runtime.owner.effects import RESTART, OwnerEffects, OwnerPolicy
from hierax.runtime.owner.roster_changes import Undo
from hierax.schemas.control import Dismiss
from hierax.schemas.roster import Change, Replace, Roster, new_nodes

UNDONE = "it had failed in its first epoch, and what it had replaced goes on"

REMEMBERED = 1024  # how many dead processes are remembered, so that what comes late does no harm


class Stage(Enum):
    """What a plan waits for."""

    PREPARE = "the processes that it touches"
    READY = "the end of the epoch"
    HAND_OVER = "the states of the nodes that are replaced"


Born = tuple[int, int, str]
"""The version with which a node came in, the first epoch that it took part in, and the request of it."""

Tried = tuple[str, Roster, str, Born, bool]


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
    states: dict[str, tuple[bytes, bytes]] = field(default_factory=dict)

    @property
    def requests(self) -> list[Request]:
        return [*self.along, *([] if self.request is None else [self.request])]

    @property
    def replaces(self) -> str:
        """The node in it that replaces another one; empty: there is none."""
        change = None if self.request is None else self.request.change
        return change.name if isinstance(change, Replace) else ""

    @property
    def tried(self) -> str:
        """The node in it whose first epoch is a trial; empty: there is none. With rates no epoch is done again."""
        return self.replaces if self.roster.timing is None else ""

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


class Members:
    """The roster in force, and the processes that the owner counts on."""

    def __init__(
        self,
        roster: Roster,  # in force
        processes: Mapping[str, str],  # of its nodes; one without is lost
        born: Mapping[str, Born] | None,  # by node; None: all were there at the beginning
        effects: OwnerEffects,  # of the owner
        clock: Callable[[], float],  # seconds
        policy: OwnerPolicy,  # what the deployment says
        # Of a node whose first epoch under the roster is under way, its name, the roster before it, and the process and
        # birth of what it has replaced, and whether that fails alone.
        tried: Tried | None = None,
        alone: Iterable[str] | None = None,  # the nodes that fail alone; None: as the policy says
    ) -> None:
        self.roster = roster  # in force
        self.processes = dict(processes)  # by node in force; of a lost one, the process that it had
        # By node in force.
        self.born: dict[str, Born] = {name: (born or {}).get(name, (0, 1, "")) for name in roster.nodes}
        self.lost: dict[str, float] = {}  # the nodes that have no process, and since when
        self.newcomers: dict[tuple[str, str], str] = {}  # to come, by node and request; empty for a lost one
        self.ended: dict[tuple[str, str], float] = {}  # nodes and processes that are to be killed, and since when
        self._effects = effects
        self._clock = clock
        self.alone = frozenset(policy.alone if alone is None else alone)  # those that are detached when they raise
        self.failures: dict[str, str] = {}  # by node that was detached for that, why
        self._on_loss = dict(policy.on_loss)
        self._rejoin_timeout_s = dict(policy.rejoin_timeout_s)
        self._given_up: set[str] = set()
        self._dead: OrderedDict[str, None] = OrderedDict()
        self._refused: dict[str, str] = {}
        self._heard_s: dict[str, float] = {}
        self._saved: dict[str, tuple[int, int]] = {}
        self.trial = None if tried is None else self._trial(*tried)  # what has replaced a node in this epoch
        self._outlived: list[tuple[str, str]] = []
        self._undone: dict[str, tuple[int, int]] = {}
        for name in sorted(roster.nodes.keys() - self.processes.keys()):
            self.lose(name)

    @property
    def back(self) -> set[str]:
        """The lost nodes for which there is another process."""
        return {name for name in self.lost if self.comes_back(name)}

    def comes_back(self, name: str) -> bool:
        """Whether there is another process for a lost node."""
        return (name, "") in self.newcomers

    def lose(self, name: str) -> None:
        self.lost[name] = self._clock()

    # --- processes

    def hear(self, process: str) -> None:
        self._heard_s.pop(process, None)
        self._heard_s[process] = self._clock()
        if len(self._heard_s) > REMEMBERED:
            del self._heard_s[next(iter(self._heard_s))]

    def heard_s(self, process: str) -> float:
        return self._heard_s.get(process, -inf)

    def is_dead(self, process: str) -> bool:
        return process in self._dead

    def died(self, name: str, process: str) -> str:
        """A process is dead; why it had been sent away, if it was."""
        self.ended.pop((name, process), None)
        self._dead[process] = None
        if len(self._dead) > REMEMBERED:
            self._dead.popitem(last=False)
        self._heard_s.pop(process, None)
        self._saved.pop(process, None)
        return self._refused.pop(process, "")

    def end(self, name: str, process: str, why: str) -> None:
        """Have a process killed; it is lost when its supervisor says so, or says nothing."""
        self.ended.setdefault((name, process), self._clock())
        self._effects.end(name, process, why)

    def send_away(self, name: str, process: str, why: str) -> None:
        """A process cannot run a node; when its supervisor says that it is gone, the node is given up."""
        self._effects.note(f"{name}: {why}; it cannot come back")
        self._refused[process] = why
        self._effects.send_order(process, Dismiss(why))

    # --- newcomers

    def come_back(self, name: str, process: str, epoch: int, attempt: int) -> None:
        """A process is to run a lost node, from a checkpoint of this epoch and attempt."""
        self.newcomers[name, ""] = process
        self._saved[process] = (epoch, attempt)

    def saved(self, process: str) -> tuple[int, int] | None:
        """Epoch and attempt of the checkpoint with which a process comes back."""
        return self._saved.get(process)

    def turn_away(self, key: str, why: str) -> None:
        """Send those away that are there for a request."""
        for name, of in [pair for pair in self.newcomers if pair[1] == key]:
            self._effects.send_order(self.newcomers.pop((name, of)), Dismiss(why))

    def missing(self, names: tuple[str, ...], key: str) -> list[str]:
        return [name for name in names if (name, key) not in self.newcomers]

    # --- what follows when a node does not come back

    def policy(self, name: str) -> str:
        """One of `RESTART`, `DETACH` and `STOP`."""
        return self._on_loss.get(name, RESTART)

    def is_late(self, name: str) -> bool:
        """Whether a lost node has taken longer than it may to come back."""
        if name not in self.lost or self.policy(name) == RESTART or self.comes_back(name):
            return False
        return self._clock() - self.lost[name] > self._rejoin_timeout_s.get(name, inf)

    def give_up(self, name: str) -> bool:
        """A lost node does not come back; whether that is news."""
        if name in self._given_up:
            return False
        self._given_up.add(name)
        return True

    # --- another version

    def alone_in(self, plan: Plan) -> tuple[str, ...]:
        new = {name: name in request.alone for request in plan.requests for name in request.new_nodes}
        if self.trial is not None and plan.undone:
            new[plan.undone] = self.trial.alone
        return tuple(name for name in sorted(plan.roster.nodes) if new.get(name, name in self.alone))

    def tried_in(self, plan: Plan) -> tuple[str, ...]:
        """The nodes that fail alone in the first epoch under a plan's roster."""
        if plan.urgent and self.trial is not None and not plan.undone:  # that epoch goes on under it
            return (self.trial.name,)
        return (plan.tried,) if plan.tried else ()

    def _trial(self, name: str, before: Roster, process: str, born: Born, alone: bool) -> Trial:
        """What becomes of a node if the one that replaces it fails."""
        on_loss, rejoin_timeout_s = self._on_loss.get(name), self._rejoin_timeout_s.get(name)
        return Trial(name, before, process, born, alone, on_loss, rejoin_timeout_s)

    def end_trial(self) -> bool:
        """What is tried counts from now on; whether anything was. `dismiss_outlived` follows."""
        trial, self.trial = self.trial, None
        if trial is not None and trial.process:
            self._outlived.append((trial.name, trial.process))
        return trial is not None

    def dismiss_outlived(self) -> None:
        """Tell those to go that were replaced for good, and that is recorded."""
        for name, process in self._outlived:
            known = name in self.born
            why = f"another process runs it from epoch {self.born[name][1]} on" if known else "it is detached"
            self._effects.send_order(process, Dismiss(f"{name}: {why}"))
        self._outlived.clear()

    def take_effect(self, plan: Plan, epoch: int) -> dict[str, str]:
        """A plan's roster is in force from this epoch on; gives, by node, the processes that have no place any more."""
        old, trial = self.processes, self.trial
        if plan.tried:
            name = plan.tried
            self.trial = self._trial(name, self.roster, self.processes[name], self.born[name], name in self.alone)
        self.alone = frozenset(self.alone_in(plan))
        self.failures = {name: why for name, why in self.failures.items() if name not in plan.roster.nodes}
        self.roster = plan.roster.as_of(epoch)
        self.processes = dict(plan.processes)
        self.lost.clear()
        self._given_up.clear()
        key = "" if plan.request is None else plan.request.key
        self.newcomers = {
            (name, of): process
            for (name, of), process in self.newcomers.items()
            if (of and of != key) or name == plan.undone
        }
        fresh = (plan.version, epoch, key)
        if plan.replaces:
            self.born[plan.replaces] = fresh
        self.born = {name: self.born.get(name, fresh) for name in self.roster.nodes}
        for request in plan.requests:
            self._on_loss.update(request.on_loss)
            self._rejoin_timeout_s.update(request.rejoin_timeout_s)
        if plan.undone and trial is not None:
            self._undo(trial, plan.version)
        elif self.trial is not None and self.trial.name not in self.roster.nodes:
            self.end_trial()
        waits = "" if self.trial is None else self.trial.process
        gone = sorted(old.items())  # whoever came back, and in which order, the same are told first
        return {name: process for name, process in gone if process not in (self.processes.get(name), waits)}

    def was_undone(self, name: str, version: int) -> bool:
        """Whether a node had failed in its place under a version, and what it had replaced goes on."""
        first, last = self._undone.get(name, (0, 0))
        return first <= version < last

    def _undo(self, trial: Trial, version: int) -> None:
        name = trial.name
        self._undone[name] = (self.born[name][0], version)
        newcomer = self.newcomers.pop((name, ""), None)
        if newcomer is not None:
            self._effects.send_order(newcomer, Dismiss(f"{name}: {UNDONE}"))
        self.trial = None
        self.born[name] = trial.born
        self._on_loss.pop(name, None)
        self._rejoin_timeout_s.pop(name, None)
        if trial.on_loss is not None:
            self._on_loss[name] = trial.on_loss
        if trial.rejoin_timeout_s is not None:
            self._rejoin_timeout_s[name] = trial.rejoin_timeout_s
