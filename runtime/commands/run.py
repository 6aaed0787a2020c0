"""``hierax run``: a deployment, all nodes in this process."""

from __future__ import annotations

from hierax.runtime.commands.options import Epochs, File, Format, Output, OutputFormat, Seed, Settings


def run(
    file: File,
    epochs: Epochs = None,
    seed: Seed = 0,
    settings: Settings = None,
    output_format: OutputFormat = Format.text,
    output: Output = None,
) -> int:
    """Run a deployment in this process: the deterministic mode."""
    from hierax.runtime import single
    from hierax.runtime.commands.running import run_deployment

    return run_deployment(
        single.run, file, settings or (), epochs=epochs, seed=seed, output=output, output_format=output_format
    )
