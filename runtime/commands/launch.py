"""``hierax launch``: a deployment, each node in a process of its own."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.errors import OK, CommandError
from hierax.runtime.commands.options import (
    Epochs,
    Format,
    Output,
    OutputFormat,
    Overwrite,
    Seed,
    Settings,
    Trust,
    deployments_here,
)
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
    from hierax.runtime.launch.recorder_process import Wanted


def launch(
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="A deployment file, or the name of a shipped deployment; none with --resume.",
            show_default=False,
            autocompletion=deployments_here,
        ),
    ] = None,
    epochs: Epochs = None,
    seed: Seed = 0,
    settings: Settings = None,
    output_format: OutputFormat = Format.text,
    output: Output = None,
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            metavar="DIR",
            help="A folder for the nodes' checkpoints; it stays, for --resume. By default it goes with the run.",
            show_default=False,
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Go on with the run whose checkpoints are in this folder, at its next epoch.",
            show_default=False,
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            "--host",
            metavar="ADDRESS",
            help="An address of this machine at which processes on others may join; by default none may.",
            show_default=False,
        ),
    ] = None,
    trust: Trust = False,
    record: RecordFile = None,
    check: Check = False,
    exclude: Exclude = None,
    max_size: MaxSize = None,
    max_duration: MaxDuration = None,
    overwrite: Overwrite = False,
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            metavar="NODE:INSTANT:N",
            help="Have a node's process kill itself the N-th time it comes to an instant; its next process takes the "
            "node's next one. For tests.",
            hidden=True,
        ),
    ] = None,
) -> int:
    """Run a deployment with each node in a process of its own, over Zenoh."""
    from hierax.runtime.commands.run_deployment import run_deployment
    from hierax.runtime.deployment.secrets import completed
    from hierax.runtime.launch import supervisor
    from hierax.runtime.launch.faults import read_faults
    from hierax.runtime.launch.recorder_process import Wanted
    from hierax.runtime.launch.run_file import read_run
    from hierax.runtime.watch import telemetry

    telemetry.wanted()  # what is wrong there is told once, not by every process
    run = None
    if resume is not None:
        if file is not None or state is not None:
            raise CommandError("--resume: the run knows its deployment file and folder; give neither")
        state, run = resume, read_run(resume, trust)
        file, settings, seed = run.deployment, completed(run.settings, settings or ()), run.seed
        epochs = run.epochs if epochs is None else epochs
        output = output or (Path(run.output) if run.output else None)
    elif trust:
        raise CommandError("--trust: only with --resume; a deployment file that you name is yours to judge")
    if file is None:
        raise CommandError("expected a deployment file, or --resume DIR")
    selection = selection_of(exclude, max_size, max_duration, record is not None)
    with claimed_file(record, overwrite) as target:
        wanted = Wanted(target, check, selection) if target is not None or check else None
        runner = functools.partial(
            supervisor.launch,
            tell=lambda what: print(f"hierax: {what}", file=sys.stderr, flush=True),
            state=None if state is None else state.absolute(),
            run=run,
            host=host,
            settings=tuple(settings or ()),
            faults=read_faults(faults or ()),
            record=wanted,
        )
        code = run_deployment(
            runner,
            file,
            settings or (),
            epochs=epochs,
            seed=seed,
            output=output,
            output_format=output_format,
            overwrite=overwrite,
            goes_on=run is not None and output is not None and output.absolute() == Path(run.output).absolute(),
        )
    return code if wanted is None else max(code, _tell(wanted))


def _tell(wanted: Wanted) -> int:
    """Say what is wrong with a recording or a check; the exit code."""
    if wanted.failure:
        raise CommandError(wanted.failure)
    code = OK if wanted.file is None or wanted.ending is None else tell_ending(wanted.file, wanted.ending)
    return max(code, tell_violations(wanted.violations))
