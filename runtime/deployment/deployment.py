"""A deployment: what a deployment file says, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
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

Operators that may take longer (a training step, a large model) need another one.
"""


@dataclass(frozen=True)
class RestartPolicy:
    """What is done when a node's process ends or cannot be reached.

    The supervisor of a process restarts it by the first five; the roster's owner waits for it by
    the last two. The defaults start a process that was killed again at once, as far as
    anybody can see, and give up on one that falls over again and again within some seconds.

    Attributes:
        restart_policy: after which end another process is started: ``never``; ``on-failure``, an exit code other than 0
            or a signal; ``always``.
        max_restarts: how many within the window; the next end of the process is its last. 0: no limit.
        restart_delay_s: from the end of the process to a restart, doubled for each one within the window; a node's very
            first one is at once.
        max_restart_delay_s: what it is doubled up to.
        restart_window_s: restarts before so many seconds count no more; None: all count.
        rejoin_timeout_s: how long the epoch is held for a lost node, back-off included.
        on_loss: what follows then. ``restart``: it is waited for as long as its supervisor may restart it, then the run
            is stopped; ``detach``: it is detached, and what only it joins to the world; ``stop``: the run is stopped.
    """

    restart_policy: Literal["never", "on-failure", "always"] = "on-failure"
    max_restarts: int = 5
    restart_delay_s: float = 0.1
    max_restart_delay_s: float = 5.0
    restart_window_s: float | None = 60.0
    rejoin_timeout_s: float = 10.0
    on_loss: Literal["restart", "detach", "stop"] = "restart"

    @property
    def fails_alone(self) -> bool:
        """Whether the node is detached, and nothing else ends, when an operator or edge function of it raises."""
        return self.on_loss == "detach" and self.restart_policy != "always"


@dataclass(frozen=True)
class ViewSpec:
    """How a viewer shows a deployment; no part of the run.

    Attributes:
        show: ``module:name`` of a function of all nodes' steps of an epoch, or None.
        layout: columns, each of cells from top to bottom, each with the names of views that share it; None: by what the
            nodes show.
    """

    show: str | None = None
    layout: tuple[tuple[tuple[str, ...], ...], ...] | None = None


@dataclass(frozen=True)
class Deployment:
    """What a deployment file says, after ``--set``.

    Attributes:
        path: the file.
        name: of the hierarchy.
        description: in one line; may be empty.
        epochs: how many by default; None: until the world says finished.
        roster: nodes and edges.
        probes: in the file's order; where errors name one, it is ``probes[i]``.
        modules: ``package.module`` or ``package.*``: from which code may be loaded, now and when the roster changes;
            all modules that the file names are among them.
        restarts: by node, of all nodes.
        restart: of nodes that are attached later and say nothing else.
        durability: checkpoints outlive the death of a ``process``, or also that of the ``host``.
        epoch_deadline_s: how long an epoch may take before who holds it up counts as lost, in seconds; None: for ever.
        on_uncertain_act: whether a world of which nobody knows if it acted acts again, ``repeat`` (at least once), or
            not, ``skip`` (at most once).
        staleness: how old inputs from above may be.
        rates_hz: by node, how often at most it takes part in an epoch of a free run; of all that say so.
        start_timeout_s: how long all nodes may take to come up, in seconds.
        zenoh: Zenoh's own settings: a map, JSON5 text in braces, or the path of a file; None where none are given.
        low_latency: whether processes have links that carry short messages more quickly, and no long ones.
        import_paths: folders in which the deployment's own modules are looked for.
        document: where everything stands in the file.
        view: how a viewer shows it.
    """

    path: Path
    name: str
    description: str
    epochs: int | None
    roster: Roster
    probes: tuple[ProbeSpec, ...]
    modules: tuple[str, ...]
    restarts: Mapping[str, RestartPolicy]
    restart: RestartPolicy
    durability: Literal["process", "host"]
    epoch_deadline_s: float | None
    on_uncertain_act: Literal["repeat", "skip"]
    staleness: Staleness
    rates_hz: Mapping[str, float]
    start_timeout_s: float
    zenoh: Mapping[str, Value] | str | None
    low_latency: bool
    import_paths: tuple[str, ...]
    document: Document = field(repr=False, compare=False)
    view: ViewSpec = ViewSpec()

    @property
    def allowance(self) -> Allowance:
        """Which code may be loaded."""
        return Allowance(self.modules)

    def place(self, where: str) -> str:
        """``file:line`` of a path such as ``nodes.world.class``, or the ``--set`` that gave it."""
        return self.document.where(self.document.keys(where))

    def explain(self, error: HieraxError) -> HieraxError:
        """An error with its place in the file, if its `where`, as `LoadError` has it, is a path in the roster."""
        where = getattr(error, "where", "")
        if not where:
            return error
        return self.document.error(self.document.keys(where), str(error).removeprefix(f"{where}: "))
