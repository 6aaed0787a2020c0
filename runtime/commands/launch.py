"""``hierax launch``: a deployment, each node in a process of its own."""

from __future__ import annotations

from hierax.runtime.commands.options import Epochs, File, Format, Output, OutputFormat, Seed, Settings


def launch(
    file: File,
    epochs: Epochs = None,
    seed: Seed = 0,
    settings: Settings = None,
    output_format: OutputFormat = Format.text,
    output: Output = None,
) -> int:
    """Run a deployment with each node in a process of its own, over Zenoh."""
    from hierax.runtime.commands.running import run_deployment
    from hierax.runtime.launch import supervisor

    return run_deployment(
        supervisor.launch, file, settings or (), epochs=epochs, seed=seed, output=output, output_format=output_format
    )
