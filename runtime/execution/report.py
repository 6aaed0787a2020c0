"""What a run has come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.execution.plain import Json, plain


@dataclass(frozen=True)
class NodeReport:
    """A node after the last epoch."""

    belief: Value  # its state
    policy: str  # likewise
    actions: Elements  # likewise
    metrics: Mapping[str, float]  # figures that it reports of its belief, by name

    def plain(self) -> Json:
        return {name: plain(value) for name, value in vars(self).items()}


@dataclass(frozen=True)
class Report:
    """A run after its last epoch."""

    hierarchy: str  # its name
    mode: str  # ``run`` or ``launch``
    epochs: int  # how many were committed
    seed: int  # of all random numbers
    digest: str  # of the last epoch, hexadecimal
    wall_s: float  # from the beginning of the first epoch to the commit of the last, in seconds
    p50_us: float | None  # median of an epoch's time, in microseconds; None where there was no epoch
    p99_us: float | None  # likewise
    nodes: Mapping[str, NodeReport]  # by name
    output: Path | None = None  # the folder that states and results were written to, or None
    start_s: float | None = None  # from the start of the processes to the first epoch, in seconds; None in one process
    epochs_us: Sequence[float] = field(default=(), repr=False)  # how long each epoch took, in microseconds
    interrupted: bool = False  # whether the run was broken off by a signal; then all is of the last epoch committed
    unreported: Mapping[str, str] = field(default_factory=dict)  # the nodes whose state is not told then, and why

    @property
    def epochs_per_s(self) -> float | None:
        """The mean rate; None where there was no epoch."""
        return self.epochs / self.wall_s if self.wall_s > 0 else None

    def plain(self) -> Json:
        """Give it as plain JSON; what only a run that was broken off has to say stands in no other."""
        broken: Json = {"interrupted": True, "unreported": sorted(self.unreported)} if self.interrupted else {}
        return {
            "hierarchy": self.hierarchy,
            "mode": self.mode,
            "epochs": self.epochs,
            "seed": self.seed,
            "digest": self.digest,
            "wall_s": self.wall_s,
            "epoch_us": {"p50": self.p50_us, "p99": self.p99_us},
            "nodes": {name: self.nodes[name].plain() for name in sorted(self.nodes)},
            **broken,
        }


class Interrupted(KeyboardInterrupt):
    """A run was broken off by a signal."""

    def __init__(self, report: Report, unreported: Mapping[str, str]) -> None:
        self.report = replace(report, interrupted=True, unreported=unreported)  # what was committed until then
        super().__init__("the run was broken off by a signal")


def make_report(
    hierarchy: str,  # see `Report`
    mode: str,  # likewise
    seed: int,  # likewise
    epochs: int,  # likewise
    digest: bytes,  # of the last epoch
    wall_s: float,  # likewise
    epochs_s: Sequence[float],  # how long each epoch took, in seconds
    nodes: Mapping[str, NodeReport],  # likewise
    output: Path | None = None,  # likewise
    start_s: float | None = None,  # likewise
) -> Report:
    epochs_us = [1e6 * epoch_s for epoch_s in epochs_s]
    p50_us, p99_us = (float(q) for q in np.percentile(epochs_us, (50, 99))) if epochs_us else (None, None)
    return Report(
        hierarchy, mode, epochs, seed, digest.hex(), wall_s, p50_us, p99_us, nodes, output, start_s, epochs_us
    )
