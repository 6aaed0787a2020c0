"""``hierax run``: a deployment, all nodes in this process."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hierax.runtime.commands.options import Epochs, File, Format, Output, OutputFormat, Seed, Settings

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.report import Report


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
) -> int:
    """Run a deployment in this process: the deterministic mode."""
    from hierax.runtime import single
    from hierax.runtime.commands.running import run_deployment
    from hierax.runtime.deployment.schedule import read_schedule

    def run_scheduled(deployment: Deployment, **options: Any) -> Report:
        return single.run(deployment, schedule=read_schedule(at or (), deployment), **options)

    return run_deployment(
        run_scheduled, file, settings or (), epochs=epochs, seed=seed, output=output, output_format=output_format
    )
