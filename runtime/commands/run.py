"""``hierax run``: a deployment, all nodes in this process."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hierax.runtime.commands.options import Epochs, File, Format, Output, OutputFormat, Overwrite, Seed, Settings
from hierax.runtime.commands.recordings import (
    Check,
    Exclude,
    MaxDuration,
    MaxSize,
    RecordFile,
    claimed_file,
    selection_of,
    tell_ending,
    tell_violations,
)

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.execution.report import Report
    from hierax.runtime.execution.single import Watch
    from hierax.runtime.recording.in_process import InProcess


def run(
    file: File,
    epochs: Epochs = None,
    seed: Seed = 0,
    settings: Settings = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="EPOCH:CHANGE",
            help="Change the roster at the start of an epoch: EPOCH:attach:FILE, EPOCH:detach:NODE[:cascade] or "
            "EPOCH:replace:NODE:FILE. May be given several times.",
            show_default=False,
        ),
    ] = None,
    output_format: OutputFormat = Format.text,
    output: Output = None,
    record: RecordFile = None,
    check: Check = False,
    exclude: Exclude = None,
    max_size: MaxSize = None,
    max_duration: MaxDuration = None,
    overwrite: Overwrite = False,
) -> int:
    """Run a deployment in this process: the deterministic mode."""
    from hierax.runtime.commands.run_deployment import run_deployment
    from hierax.runtime.deployment.schedule import read_schedule
    from hierax.runtime.execution import single
    from hierax.runtime.execution.breaker import Breaker
    from hierax.runtime.recording.in_process import InProcess

    selection = selection_of(exclude, max_size, max_duration, record is not None)
    taking: list[InProcess] = []

    def run_scheduled(deployment: Deployment, **options: Any) -> Report:
        schedule = read_schedule(at or (), deployment)
        if record is not None or check:
            taking.append(InProcess(deployment, seed, settings or (), target, check, selection))
        try:
            recording = taking[0] if taking else None
            return single.run(
                deployment,
                schedule=schedule,
                watch=_spans(deployment),
                record=recording,
                breaker=Breaker(),
                **options,
            )
        finally:
            for each in taking:
                each.finish()

    with claimed_file(record, overwrite) as target:
        code = run_deployment(
            run_scheduled,
            file,
            settings or (),
            epochs=epochs,
            seed=seed,
            output=output,
            output_format=output_format,
            overwrite=overwrite,
        )
    return max([code, *(_tell(each, record) for each in taking)])


def _tell(taking: InProcess, file: Path | None) -> int:
    """Say what is wrong with a recording or a check; the exit code."""
    code = 0 if file is None or taking.ending is None else tell_ending(file, taking.ending)
    return code if taking.checker is None else max(code, tell_violations(taking.checker.close()))


def _spans(deployment: Deployment) -> Watch | None:
    """What has every node's epochs told to OpenTelemetry, where the environment says so."""
    from hierax.runtime.watch import telemetry

    if not telemetry.wanted():
        return None
    return lambda name, runner: runner.watch(telemetry.open_spans(deployment.name, "run", name))
