"""``hierax replay``: a recording done again, whole or one node, as it was or with other parameters or classes."""

import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

from hierax.runtime.commands.errors import FAILED, OK, CommandError
from hierax.runtime.commands.options import Format, RecordingFile, RunOptions, WorldMode, offers
from hierax.runtime.commands.recordings import comparison_json, print_comparison, recording_of
from hierax.runtime.commands.show import print_json, print_report

if TYPE_CHECKING:
    from hierax.runtime.execution.report import Report
    from hierax.runtime.recording.diff import Comparison
    from hierax.runtime.recording.replay import Replay
    from hierax.runtime.recording.replayed_epoch import ReplayedEpoch


@offers(
    "node", "world", "speed", "classes", "verify", "tolerance", "first", "last", "overrides", "trust", "output_format"
)
def replay(file: RecordingFile, options: RunOptions) -> int:
    """Do a recording again, in this process: whole, from an epoch on, or one node on its recorded inputs."""
    from hierax.runtime.loading.allowance import module_of
    from hierax.runtime.loading.loader import extend_import_path
    from hierax.runtime.recording.diff import compare
    from hierax.runtime.recording.replay import Replay, allowance_of, check_names, other_settings, recorded_deployment

    recording = recording_of(file)
    info = recording.info
    allowance = allowance_of(recording, options.trust)
    extend_import_path(tuple(info.import_paths))
    replaced = _classes(options.classes or ())
    check_names(recording, [*replaced, *([] if options.node is None else [options.node])])
    named = [module_of(target) for target in replaced.values()]
    if options.overrides:
        named += recorded_deployment(info, options.overrides).modules
    replaying = Replay(
        recording,
        allowance.with_modules(named),
        node=options.node,
        world=options.world is WorldMode.again,
        rewrite=other_settings(info, options.overrides or (), replaced),
        first=options.first,
        last=options.last,
    )
    epochs = _Paced(replaying, options.speed)
    comparison: Comparison | None = None
    with redirect_stdout(sys.stderr):  # what a node prints must not mix with the report
        if options.verify:
            comparison = compare(recording.epochs(options.first, options.last), epochs, options.tolerance)
        else:
            for _ in epochs:
                pass
    if not epochs.times_s:
        to = "" if options.last is None else f" to {options.last}"
        which = f" from {options.first}{to}" if options.first > 1 or to else ""
        raise CommandError(f"{file}: there is no epoch to replay{which}")
    report = epochs.report()
    if options.output_format is Format.json:
        print_json({**report.plain(), "verify": None if comparison is None else comparison_json(comparison)})
    else:
        print_report(report)
        if comparison is not None:
            print()
            print_comparison(comparison, "recorded", "replayed")
    return OK if comparison is None or comparison.alike else FAILED


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
                time.sleep(max(due_s - time.monotonic(), 0.0))
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
        found[name.strip()] = target.strip()
    return found
