"""How a launch has kept its times: epochs that began late, and the nodes that took longer than they may."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hierax.runtime.execution.report import Json

Told = Mapping[str, Mapping[str, Any]]
"""By node, what its process tells: of the world's ``pace``, by `Pace.told`, ``budget``, by `Budget.told`, and
``overruns``, by `Overruns.told`."""


def timing_of(told: Told) -> Json:
    """All of a launch; None where nothing is held to a time.

    ``rate`` has how late epochs began, in milliseconds, and after whom: an epoch begins late as the one before was not
    done, so those are named for which all waited in it, or in the one before the first of several that began late in a
    row: they were over their budget in it, or over a delay by more than a period. ``budgets`` has by node how many
    epochs took it longer, and the longest of them, ``overruns`` by node above, and by node below, in how many epochs
    that has waited for what the edge's delay should have given it the time for."""
    paces = [each["pace"] for each in told.values() if "pace" in each]
    budgets = {name: each["budget"] for name, each in told.items() if "budget" in each}
    kept = {name: {what: each[what] for what in ("budget_ms", "over", "max_ms")} for name, each in budgets.items()}
    waits = [(lower, upper, said) for lower, each in told.items() for upper, said in each.get("overruns", {}).items()]
    waited: dict[str, dict[str, int]] = {}
    for lower, upper, said in waits:
        waited.setdefault(upper, {})[lower] = said["count"]
    overruns: dict[str, Any] = {"overruns": waited} if waited else {}
    if not paces:
        return {"budgets": kept, **overruns} if kept or overruns else None
    (pace,) = paces
    over = {name: list(each["epochs"]) for name, each in budgets.items()}
    for _, upper, said in waits:
        over.setdefault(upper, []).extend(said["epochs"])
    after = culprits(pace["epochs"], over)
    rate = {what: each for what, each in pace.items() if what != "epochs"}
    return {"rate": {**rate, "after": dict(after)}, "budgets": kept, **overruns}


def culprits(late: Sequence[int], over: Mapping[str, Sequence[int]]) -> Counter[str]:
    """How many epochs that began late each node is to blame for.

    Args:
        late: the epochs that began late, in order.
        over: by node, the epochs that ended later as it took too long, in any order.
    """
    epochs = {name: set(each) for name, each in over.items()}
    blamed: Counter[str] = Counter()
    before, names = 0, list[str]()
    for epoch in late:
        found = [name for name in sorted(epochs) if epoch - 1 in epochs[name]]
        names = found or (names if before == epoch - 1 else [])
        blamed.update(names)
        before = epoch
    return blamed


def lines_of(timing: Json) -> list[str]:
    """The same for people to read."""
    lines = []
    rate = (timing or {}).get("rate")
    if rate is not None:
        times = ", ".join(f"{what} {rate[f'{what}_ms']:.2f} ms" for what in ("p50", "p99", "max"))
        after = ", ".join(f"{name} {count}" for name, count in sorted(rate["after"].items()))
        skipped = f", {_counted(rate['skipped'], 'time')} skipped" if rate["skipped"] else ""
        said = f"{_counted(rate['late'], 'epoch')} begun late{f' (after {after})' if after else ''}{skipped}"
        lines.append(f"every {rate['period_ms']:g} ms: {said}; lateness {times}")
    for name, budget in sorted((timing or {}).get("budgets", {}).items()):
        if budget["over"]:
            took = f"{_counted(budget['over'], 'epoch')} took longer, the longest {budget['max_ms']:.1f} ms"
            lines.append(f"{name}: a budget of {budget['budget_ms']:g} ms; {took}")
    for upper, waited in sorted((timing or {}).get("overruns", {}).items()):
        who = ", ".join(f"{lower} {count}" for lower, count in sorted(waited.items()))
        lines.append(f"{upper}: longer than its delays; epochs in which it was waited for: {who}")
    return lines


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
