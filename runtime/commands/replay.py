"""``hierax replay``: a recording done again, whole or one node, as it was or with other parameters or classes."""

import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

from hierax.runtime.commands.errors import FAILED, OK, CommandError, UsageError
from hierax.runtime.commands.options import Format, RecordingFile, RunOptions, WorldMode, offers
from hierax.runtime.commands.recordings import comparison_json, print_comparison, recording_of
from hierax.runtime.commands.show import RIGHT, brief, print_json, print_report, print_table

SLOWEST = 1e-6  # with less, a second takes weeks
LONGEST_S = 1e9  # how long it waits for an epoch at most: what a recording says of its times may be anything
LISTED = 60  # how many stretches of epochs are listed as text

if TYPE_CHECKING:
    from hierax.runtime.execution.report import Report
    from hierax.runtime.recording.decisions import Decision, Decisions
    from hierax.runtime.recording.diff import Comparison
    from hierax.runtime.recording.replay import Replay
    from hierax.runtime.recording.replayed_epoch import ReplayedEpoch


@offers(
    *("nodes", "world", "speed", "classes", "verify", "decisions", "tolerance"),
    *("first", "last", "overrides", "trust", "output_format"),
)
def replay(file: RecordingFile, options: RunOptions) -> int:
    """Do a recording again, in this process: whole, from an epoch on, or one node on its recorded inputs."""
    from hierax.runtime.loading.allowance import module_of
    from hierax.runtime.loading.loader import extend_import_path
    from hierax.runtime.recording.decisions import Decisions
    from hierax.runtime.recording.diff import compare
    from hierax.runtime.recording.replay import (
        Replay,
        allowance_of,
        changed_nodes,
        check_names,
        other_settings,
        recorded_deployment,
    )

    if 0 < options.speed < SLOWEST:
        raise CommandError(f"--speed {options.speed:g}: expected 0, or a number from {SLOWEST:g} on")
    if options.verify and options.decisions:
        raise CommandError("give --verify or --decisions, not both: the first ends where something differs")
    node = _one(options.nodes or ())
    recording = recording_of(file)
    info = recording.info
    allowance = allowance_of(recording, options.trust)
    extend_import_path(tuple(info.import_paths))
    replaced = _classes(options.classes or ())
    wanted = [*replaced, *([] if node is None else [node])]
    check_names(recording, wanted)
    if options.overrides or replaced:
        recorded = recorded_deployment(info).roster
        for setting in options.overrides or ():
            changed = changed_nodes(recorded, recorded_deployment(info, [setting]).roster)
            _check_changes(f"--set {setting}", changed, recorded.world, node, options)
        for name, target in replaced.items():
            _check_changes(f"--with {name}={target}", frozenset([name]), recorded.world, node, options)
    named = [module_of(target) for target in replaced.values()]
    if options.overrides:
        named += recorded_deployment(info, options.overrides).modules
    replaying = Replay(
        recording,
        allowance.with_modules(named),
        node=node,
        world=options.world is WorldMode.again,
        rewrite=other_settings(info, options.overrides or (), replaced),
        first=options.first,
        last=options.last,
    )
    epochs = _Paced(replaying, options.speed)
    comparison: Comparison | None = None
    decisions = Decisions(options.tolerance) if options.decisions else None
    with redirect_stdout(sys.stderr):  # what a node prints must not mix with the report
        if options.verify:
            comparison = compare(recording.epochs(options.first, options.last), epochs, options.tolerance)
        elif decisions is not None:
            decisions.gather(epochs)
        else:
            for _ in epochs:
                pass
    if not epochs.times_s:
        to = "" if options.last is None else f" to {options.last}"
        which = f" from {options.first}{to}" if options.first > 1 or to else ""
        raise CommandError(f"{file}: there is no epoch to replay{which}")
    missing = [each for each in wanted if each not in replaying.wirings]
    if missing:
        what = f"in none of the {len(epochs.times_s)} epochs that were replayed was there a node {missing[0]}"
        raise CommandError(f"{file}: {what}; expected some with it")
    report = epochs.report()
    if options.output_format is Format.json:
        told = {} if decisions is None else {"decisions": decisions_json(decisions)}
        print_json({**report.plain(), "verify": None if comparison is None else comparison_json(comparison), **told})
    else:
        print_report(report)
        if comparison is not None:
            print()
            print_comparison(comparison, "recorded", "replayed")
        if decisions is not None:
            print()
            print_decisions(decisions)
    return OK if comparison is None or comparison.alike else FAILED


def _one(nodes: Sequence[str]) -> str | None:
    """The node that is done again alone; None: all are. Raises `UsageError` if there are several."""
    if len(nodes) > 1:
        raise UsageError(f"--node {' --node '.join(nodes)}: expected one node, which is done again alone")
    return nodes[0] if nodes else None


def _check_changes(given: str, changed: frozenset[str], world: str, node: str | None, options: RunOptions) -> None:
    """Raises `CommandError` where what is given changes nodes alone that are not done again."""
    again = changed if node is None else changed & {node}
    if options.world is not WorldMode.again:
        again -= {world}
    if changed and not again:
        what = "the other nodes do" if node is not None else "the world does"
        changes = f"changes {', '.join(sorted(changed))} alone"
        raise CommandError(f"{given}: {changes}; {what} here what the recording says")


def decisions_json(decisions: "Decisions") -> "dict[str, Any]":
    """Of each node how many epochs were compared, in how many it would have done something else, and what."""
    from hierax.runtime.execution.report import plain

    def told(decision: "Decision") -> dict[str, Any]:
        return {"policy": decision.policy, "actions": plain(decision.actions)}

    found: dict[str, dict[str, Any]] = {
        node: {"epochs": epochs, "otherwise": decisions.otherwise(node), "stretches": []}
        for node, epochs in decisions.compared.items()
    }
    for each in decisions.stretches:
        sides = {"recorded": told(each.recorded), "replayed": told(each.replayed)}
        found[each.node]["stretches"].append({"from": each.first, "to": each.last, **sides})
    return found


def print_decisions(decisions: "Decisions") -> None:
    """The same as text: a line for each node, and a table of the epochs."""
    for node, epochs in decisions.compared.items():
        count = decisions.otherwise(node)
        print(f"{node}: the same in {epochs - count} of {epochs} epochs, something else in {count}")
    if not decisions.stretches:
        return
    print()
    rows = [
        (
            each.node,
            str(each.first),
            str(each.last),
            _said(each.recorded, each.replayed),
            _said(each.replayed, each.recorded),
        )
        for each in decisions.stretches[:LISTED]
    ]
    print_table({"node": {}, "from": RIGHT, "to": RIGHT, "recorded": {}, "replayed": {}}, rows)
    left = len(decisions.stretches) - len(rows)
    if left:
        print(f"… {left} more; --format json has all")


def _said(decision: "Decision", other: "Decision") -> str:
    """Actions in a line, and the policy where that is another one."""
    actions = ", ".join(map(brief, decision.actions)) or "nothing"
    return actions if decision.policy == other.policy else f"{decision.policy}: {actions}"


class _Paced:
    """Epochs of a replay, each when it is due."""

    def __init__(self, replay: "Replay", speed: float) -> None:
        self._replay = replay
        self._speed = speed
        self._epochs: Iterable[ReplayedEpoch] = replay.epochs()
        self._last: ReplayedEpoch | None = None
        self.times_s: list[float] = []

    def __iter__(self) -> "Iterator[ReplayedEpoch]":
        begun_s, begun_ns = time.monotonic(), 0
        done_s = time.perf_counter()
        for epoch in self._epochs:
            self.times_s.append(time.perf_counter() - done_s)
            heard_ns = epoch.recorded.heard_ns
            if self._speed and heard_ns:
                begun_ns = begun_ns or heard_ns
                due_s = begun_s + (heard_ns - begun_ns) / 1e9 / self._speed
                time.sleep(min(max(due_s - time.monotonic(), 0.0), LONGEST_S))
            self._last = epoch
            yield epoch
            done_s = time.perf_counter()

    def report(self) -> "Report":
        """What the replay has come to: the live nodes after its last epoch."""
        from hierax.runtime.core.binding import metrics_of
        from hierax.runtime.execution.report import NodeReport, Report

        assert self._last is not None
        epoch, states = self._last.epoch, self._replay.states
        nodes = {
            node: NodeReport(*state, metrics_of(node, self._replay.wirings[node].node.node, state.belief, epoch))
            for node, state in sorted(states.items())
        }
        info, times_s = self._replay.recording.info, self.times_s
        digest, total_s = self._last.digest.hex(), sum(times_s)
        return Report(info.hierarchy, "replay", info.seed, len(times_s), digest, total_s, times_s, nodes)


def _classes(texts: Sequence[str]) -> Mapping[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, equals, target = text.partition("=")
        if not equals or target.count(":") != 1:
            raise CommandError(f"--with {text}: expected NODE=package.module:Class")
        name = name.strip()
        if name in found:
            raise UsageError(f"--with {text}: {name} is {found[name]} already; expected one class for a node")
        found[name] = target.strip()
    return found
