"""From two looks at a launch to what its nodes do in between."""

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np

from hierax.runtime.execution.report import Json, plain
from hierax.runtime.execution.timing import timing_of
from hierax.runtime.transport.launch_client import Answer, LaunchStatus
from hierax.runtime.watch.meter import WORK

NS_PER_S = 1e9


def rates_between(before: Answer | None, after: Answer) -> dict[str, Json]:
    """What a node did between two answers of its process; after another process or none, the second one stands alone.

    ``share`` is which part of the time it spent at what, ``waiting`` among it; ``per_epoch_us`` how long an epoch took
    it by that, in microseconds, None where it has completed none; ``waits_for`` whom it waited for, longest first, as
    parts of its waiting, by the empty name where nobody can be named."""
    new = after["meter"]
    if before is not None and (before["process"] != after["process"] or before["meter"]["ns"] > new["ns"]):
        before = None
    old: Mapping[str, Any] = {} if before is None else before["meter"]
    epochs = new["epochs"] - old.get("epochs", 0)
    interval_s = (new["ns"] - old.get("ns", 0)) / NS_PER_S or inf
    waiting_s = _differences(old.get("waiting_ns", {}), new["waiting_ns"])
    work_s = {**dict.fromkeys(WORK, 0.0), **_differences(old.get("work_ns", {}), new["work_ns"])}
    spent_s = {**work_s, "waiting": sum(waiting_s.values())}
    longest = sorted(waiting_s.items(), key=lambda item: (-item[1], item[0]))
    return {
        "epochs": epochs,
        "epochs_per_s": epochs / interval_s,
        "per_epoch_us": {what: 1e6 * seconds / epochs for what, seconds in spent_s.items()} if epochs else None,
        "share": {what: seconds / interval_s for what, seconds in spent_s.items()},
        "waits_for": {name: seconds / spent_s["waiting"] for name, seconds in longest if seconds > 0},
        "cpu": 0.0 if before is None else (after["cpu_s"] - before["cpu_s"]) / interval_s,
    }


def _differences(old: Mapping[str, int], new: Mapping[str, int]) -> dict[str, float]:
    # what was still under way at the first look may turn out to be less of this, and more of that
    return {what: max(ns - old.get(what, 0), 0) / NS_PER_S for what, ns in new.items()}


def doing(answer: Answer) -> str:
    """What a node does at this moment, in some words."""
    if answer["busy"]:
        return f"in {answer['busy']}"
    waited = sorted({sender for sender, _ in answer["waits_for"]})
    return f"waits for {', '.join(waited)}" if waited else "between epochs"


def _timing(answers: Mapping[str, Answer]) -> Json:
    """How a launch keeps its times, as `timing_of` has it. A pace is the world's to tell: of several none counts."""
    told = {name: answer.get("timing", {}) for name, answer in answers.items()}
    if sum("pace" in each for each in told.values()) > 1:
        told = {name: {what: each for what, each in said.items() if what != "pace"} for name, said in told.items()}
    return timing_of(told)


def overview(status: LaunchStatus, before: Mapping[str, Answer], after: Mapping[str, Answer]) -> Json:
    """All of a launch as plain JSON, from what its nodes have answered, twice; some may not have."""
    nodes: dict[str, Json] = {}
    for name, told in status.nodes.items():
        answer = after.get(name)
        shown = ("state", "host", "pid", "shares", "instance", "restarts")
        nodes[name] = {key: told[key] for key in shown if key in told}
        nodes[name]["answers"] = answer is not None
        if answer is not None:
            said = {key: plain(answer[key]) for key in ("pid", "epoch", "rss_bytes", "metrics")}
            if answer.get("in_force"):  # where nodes have rates
                said["in_force"] = answer["in_force"]
            nodes[name] |= {**said, "doing": doing(answer), **rates_between(before.get(name), answer)}
    there = [name for name in nodes if name in after]
    timing = _timing(after)
    quickest = max(there, key=lambda name: nodes[name]["epochs_per_s"], default="")
    epochs_ns = after[quickest]["meter"]["epochs_ns"] if quickest else ()
    return {
        "hierarchy": status.hierarchy,
        "run": status.run,
        "epoch": max([status.epoch, *(answer["epoch"] - 1 for answer in after.values())]),
        "roster": status.roster,
        "epochs_per_s": nodes[quickest]["epochs_per_s"] if quickest else 0.0,
        "epoch_us": {
            f"p{percent}": float(np.percentile(epochs_ns, percent)) / 1e3 if epochs_ns else None for percent in (50, 99)
        },
        "nodes": nodes,
        **({} if timing is None else {"timing": timing}),
    }
