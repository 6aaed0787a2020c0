"""``hierax record``: a launch that runs, into an MCAP file."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Annotated

import typer

from hierax.runtime.commands.errors import CommandError, notify
from hierax.runtime.commands.options import LARGEST, Format, RunOptions, argument, offers, option
from hierax.runtime.commands.recordings import claimed_file, report_ending, selection_of
from hierax.runtime.commands.show import print_json
from hierax.runtime.commands.which import client_of


@offers("run", "connect", "exclude", "max_size", "max_duration", "overwrite", "output_format")
def record(
    options: RunOptions,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The MCAP file.", dir_okay=False)],
    hierarchy: Annotated[
        str | None, argument("LAUNCH", "Its hierarchy's name, or its run, as `hierax ps` lists them.")
    ] = None,
    host: Annotated[str | None, option("--host", help="With --connect: this machine's address for the others.")] = None,
    epochs: Annotated[int | None, option("--epochs", min=1, max=LARGEST, help="Stop after N epochs.")] = None,
) -> int:
    """Record a launch that runs, until it is over, or Ctrl-C. Exit code 1 if something said is not in the file."""
    from hierax.runtime.recording.info import RunInfo
    from hierax.runtime.recording.live_recording import LiveRecording

    if hierarchy is not None and options.run is not None:
        raise CommandError("give the launch or --run, not both")
    selection = selection_of(options)
    with claimed_file(output, options.overwrite) as target:
        with client_of(options.run if hierarchy is None else hierarchy, options.connect) as client:
            info = RunInfo.read(client.ask({"ask": "record", "pid": 0 if options.connect else os.getpid()}))
        recording = LiveRecording(
            info, client.endpoint, target, check=False, host=host, epochs=epochs, watches=True, selection=selection
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: recording.stop())
        notify(f"recording {info.hierarchy}, run {info.run}; Ctrl-C ends it")
        ending = recording.record()
    if options.output_format is Format.json:
        print_json({"file": str(output), "hierarchy": info.hierarchy, "run": info.run, **ending.plain()})
    else:
        count = max(ending.last - ending.first + 1, 0) if ending.first else 0
        print(f"{output}: {count} epochs, {ending.first} to {ending.last}, {ending.messages} messages")
    return report_ending(output, ending)
