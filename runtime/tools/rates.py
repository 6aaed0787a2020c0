"""From two looks at a launch to what its nodes do in between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from hierax.runtime.execution.report import Json
from hierax.runtime.transport.launch_client import Answer, LaunchStatus

NS_PER_S = 1e9


@dataclass(frozen=True)
class NodeRates:
    """What a node did between two looks."""

    epochs: int  # how many it has completed; a node that was started again in between counts from there
    interval_s: float  # how long it was watched
    work_s: Mapping[str, float]  # time spent, by `hierax.runtime.watch.meter.WORK`
    waiting_s: Mapping[str, float]  # time waited, by whom it waited for; the empty name where nobody can be named
    cpu_s: float  # processor time of its process
    epochs_s: Sequence[float]  # durations of its last epochs

    @staticmethod
    def between(before: Answer | None, after: Answer) -> NodeRates:
        """Take it from two answers of its process; after another process or none, the second one stands alone."""
        new = after["meter"]
        same = before is not None and before["process"] == after["process"] and before["meter"]["ns"] <= new["ns"]
        old: Mapping[str, Any] = before["meter"] if same and before is not None else {}
        cpu_s = after["cpu_s"] - before["cpu_s"] if same and before is not None else 0.0
        return NodeRates(
            new["epochs"] - old.get("epochs", 0),
            (new["ns"] - old.get("ns", 0)) / NS_PER_S,
            _differences(old.get("work_ns", {}), new["work_ns"]),
            _differences(old.get("waiting_ns", {}), new["waiting_ns"]),
            cpu_s,
            [ns / NS_PER_S for ns in new["epochs_ns"]],
        )

    @property
    def epochs_per_s(self) -> float:
        """How many epochs it does in a second."""
        return self.epochs / (self.interval_s or inf)

    @property
    def spent_s(self) -> dict[str, float]:
        """Time by what it did, ``waiting`` among it."""
        return {**self.work_s, "waiting": sum(self.waiting_s.values())}

    def shares(self) -> dict[str, float]:
        """Which part of the time it spent at what."""
        return {what: seconds / (self.interval_s or inf) for what, seconds in self.spent_s.items()}

    def per_epoch_us(self) -> dict[str, float] | None:
        """How long an epoch took it, in microseconds, by what it did; None where it has completed none."""
        if not self.epochs:
            return None
        return {what: 1e6 * seconds / self.epochs for what, seconds in self.spent_s.items()}

    def waits_for(self) -> dict[str, float]:
        """Whom it waited for, longest first, as parts of its waiting."""
        total = sum(self.waiting_s.values())
        longest = sorted(self.waiting_s.items(), key=lambda item: (-item[1], item[0]))
        return {name: seconds / total for name, seconds in longest if seconds > 0 and total > 0}

    def epoch_us(self, quantile: float) -> float | None:
        """A quantile of the durations of its last epochs, in microseconds."""
        return float(np.quantile(self.epochs_s, quantile)) * 1e6 if self.epochs_s else None


def _differences(old: Mapping[str, int], new: Mapping[str, int]) -> dict[str, float]:
    # what was still under way at the first look may turn out to be less of this, and more of that
    return {what: max(ns - old.get(what, 0), 0) / NS_PER_S for what, ns in new.items()}


def doing(answer: Answer) -> str:
    """What a node does at this moment, in some words."""
    if answer["busy"]:
        return f"in {answer['busy']}"
    waited = sorted({sender for sender, _ in answer["waits_for"]})
    return f"waits for {', '.join(waited)}" if waited else "between epochs"


def overview(status: LaunchStatus, before: Mapping[str, Answer], after: Mapping[str, Answer]) -> Json:
    """All of a launch as plain JSON, from what its nodes have answered, twice; some may not have."""
    rates = {name: NodeRates.between(before.get(name), answer) for name, answer in after.items()}
    nodes = {name: _node(told, rates.get(name), after.get(name)) for name, told in status.nodes.items()}
    quickest = max(rates.values(), key=lambda each: each.epochs_per_s, default=None)
    return {
        "hierarchy": status.hierarchy,
        "run": status.run,
        "epoch": max([status.epoch, *(answer["epoch"] - 1 for answer in after.values())]),
        "roster": status.roster,
        "epochs_per_s": 0.0 if quickest is None else quickest.epochs_per_s,
        "epoch_us": {
            "p50": None if quickest is None else quickest.epoch_us(0.5),
            "p99": None if quickest is None else quickest.epoch_us(0.99),
        },
        "nodes": nodes,
    }


def _node(told: Mapping[str, Any], rates: NodeRates | None, after: Answer | None) -> Json:
    common = {key: told[key] for key in ("state", "pid", "instance", "restarts")}
    if after is None or rates is None:
        return {**common, "answers": False}
    return {
        **common,
        "pid": after["pid"],
        "answers": True,
        "epoch": after["epoch"],
        "doing": doing(after),
        "epochs": rates.epochs,
        "epochs_per_s": rates.epochs_per_s,
        "per_epoch_us": rates.per_epoch_us(),
        "share": rates.shares(),
        "waits_for": rates.waits_for(),
        "cpu": rates.cpu_s / (rates.interval_s or inf),
        "rss_bytes": after["rss_bytes"],
    }
