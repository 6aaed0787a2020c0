"""A deployment: what a deployment file says, read and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment.document import Document
from hierax.runtime.loading.allowance import Allowance
from hierax.schemas.roster import ProbeSpec, Roster
from hierax.schemas.values import Value

EPOCH_DEADLINE_S = 60.0
"""The default: long for a robot, and a hang is told of before its user gives up.

Operators that may take longer (a training step, a large model) need another one."""


@dataclass(frozen=True)
class RestartPolicy:
    """What is done when a node's process ends or cannot be reached. The supervisor of a process restarts it by the
    first five; the roster's owner waits for it by the last two. The defaults start a process that was killed again at
    once, as far as anybody can see, and give up on one that falls over again and again within some seconds."""

    restart_policy: Literal["never", "on-failure", "always"] = "on-failure"  # after which end of a process
    max_restarts: int = 5  # how many within the window; the next end of the process is its last. 0: no limit.
    restart_delay_s: float = 0.1  # until a restart, doubled for each one within the window; the very first is at once
    max_restart_delay_s: float = 5.0  # what it is doubled up to
    restart_window_s: float | None = 60.0  # restarts before so many seconds count no more; None: all count
    rejoin_timeout_s: float = 10.0  # how long the epoch is held for a lost node, back-off included
    # What follows then. ``restart``: it is waited for as long as its supervisor may restart it, then the run is
    # stopped; ``detach``: it is detached, and what only it joins to the world; ``stop``: the run is stopped.
    on_loss: Literal["restart", "detach", "stop"] = "restart"

    @property
    def fails_alone(self) -> bool:
        """Whether the node is detached, and nothing else ends, when an operator or edge function of it raises."""
        return self.on_loss == "detach" and self.restart_policy != "always"


@dataclass(frozen=True)
class ViewSpec:
    """How a viewer shows a deployment; no part of the run."""

    show: str | None = None  # ``module:name`` of a function of all nodes' steps of an epoch, or None
    # columns of cells from top to bottom, each with the names of views that share it; None: by what nodes show
    layout: tuple[tuple[tuple[str, ...], ...], ...] | None = None


@dataclass(frozen=True)
class Deployment:
    """What a deployment file says, after ``--set``."""

    path: Path  # the file
    name: str  # of the hierarchy
    description: str  # in one line; may be empty
    epochs: int | None  # how many by default; None: until the world says finished
    roster: Roster  # nodes and edges
    probes: tuple[ProbeSpec, ...]  # in the file's order; where errors name one, it is ``probes[i]``
    modules: tuple[str, ...]  # from which code may be loaded, now and later; those that the file names are among them
    restarts: Mapping[str, RestartPolicy]  # by node, of all nodes
    restart: RestartPolicy  # of nodes that are attached later and say nothing else
    durability: Literal["process", "host"]  # whose death checkpoints outlive
    epoch_deadline_s: float | None  # how long until who holds an epoch up counts as lost, in seconds; None: for ever
    on_uncertain_act: Literal["repeat", "skip"]  # of a world of which nobody knows if it acted: at least, at most once
    staleness: Staleness  # how old inputs from above may be
    rates_hz: Mapping[str, float]  # by node, how often at most it takes part in an epoch of a free run, if it says so
    start_timeout_s: float  # how long all nodes may take to come up, in seconds
    zenoh: Mapping[str, Value] | str | None  # its own settings: a map, JSON5 text in braces, or the path of a file
    low_latency: bool  # whether processes have links that carry short messages more quickly, and no long ones
    import_paths: tuple[str, ...]  # folders in which the deployment's own modules are looked for
    document: Document = field(repr=False, compare=False)  # where everything stands in the file
    view: ViewSpec = ViewSpec()  # how a viewer shows it

    @property
    def allowance(self) -> Allowance:
        """Which code may be loaded."""
        return Allowance(self.modules)

    def place(self, where: str) -> str:
        """``file:line`` of a path such as ``nodes.world.class``, or the ``--set`` that gave it."""
        return self.document.where(self.document.keys(where))

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """Raise errors with their place in the file, as `explain` gives them, in place of those without."""
        try:
            yield
        except HieraxError as error:
            explained = self.explain(error)
            if explained is error:
                raise
            raise explained from error

    def explain(self, error: HieraxError) -> HieraxError:
        """An error with its place in the file, if its `where`, as `LoadError` has it, is a path in the roster."""
        where = getattr(error, "where", "")
        if not where:
            return error
        return self.document.error(self.document.keys(where), str(error).removeprefix(f"{where}: "))
