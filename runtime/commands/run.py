"""``hierax run``: a deployment, all nodes in this process."""

from dataclasses import replace
from secrets import token_hex
from typing import TYPE_CHECKING, Any

from hierax.runtime.commands.errors import notify
from hierax.runtime.commands.options import OF_A_RUN, File, RunOptions, offers
from hierax.runtime.commands.recordings import claimed_file, report_outcome, selection_of

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.execution.report import Report
    from hierax.runtime.execution.single_nodes import Watch
    from hierax.runtime.recording.recorder import InProcess


@offers(*OF_A_RUN, "at")
def run(file: File, options: RunOptions) -> int:
    """Run a deployment in this process: the deterministic mode."""
    from hierax.runtime.commands.run_deployment import run_deployment
    from hierax.runtime.deployment.snippet import read_schedule
    from hierax.runtime.execution import single
    from hierax.runtime.execution.pacemaker import Breaker
    from hierax.runtime.watch.prints import named_turns
    from hierax.schemas.roster import new_nodes

    overrides, recorded = options.overrides or (), options.record is not None
    selection = selection_of(options, recorded)
    taking: list[InProcess] = []
    late: list[str] = []

    def run_scheduled(deployment: "Deployment", **given: Any) -> "Report":
        schedule = read_schedule(options.at or (), deployment)
        snippets = tuple(each.document for each in schedule if each.document is not None)
        explained = replace(deployment, snippets=snippets)
        if recorded or options.check:
            from hierax.runtime.recording.info import RunInfo
            from hierax.runtime.recording.recorder import InProcess, Recorder

            info = RunInfo.of(deployment, token_hex(4), "run", options.seed, overrides, from_start=True)
            taking.append(InProcess(Recorder(info, target, options.check, selection)))
        try:
            recording = taking[0] if taking else None
            given.update(schedule=schedule, watch=_spans(deployment), record=recording, breaker=Breaker())
            names = {*deployment.roster.nodes, *(name for each in schedule for name in new_nodes(each.change))}
            with explained.explaining(), named_turns(names, deployment.name) as turn:
                report = single.run(deployment, turn=turn, **given)
            late.extend(str(each.epoch) for each in schedule if each.epoch > report.epochs)
            return report
        finally:
            for each in taking:
                each.finish()

    with claimed_file(options.record, options.overwrite) as target:
        code = run_deployment(run_scheduled, file, options)
    if late:
        notify(f"--at: the run ended before epoch {', '.join(late)}: what was to change there is not made")
    for each in taking:
        violations = () if each.checker is None else each.checker.close()
        code = max(code, report_outcome(options.record, each.ending, violations))
    return code


def _spans(deployment: "Deployment") -> "Watch | None":
    """What has every node's epochs told to OpenTelemetry, where the environment says so."""
    from hierax.runtime.watch import telemetry

    if not telemetry.wanted():
        return None
    return lambda name, runner: runner.watch(telemetry.open_spans(deployment.name, "run", name))
