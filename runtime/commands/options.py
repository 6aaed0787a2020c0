"""Arguments and options that several commands share."""

from __future__ import annotations

import glob
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from hierax.runtime.commands.recordings import Check, Exclude, MaxDuration, MaxSize, RecordFile

LARGEST = 2**63 - 1  # what a message can carry


class Format(str, Enum):
    """How a result is printed."""

    text = "text"
    json = "json"


def deployments_here(incomplete: str) -> list[str]:
    """For completion: shipped deployments, YAML files, and folders, which end with a slash."""
    from hierax.runtime.deployment.locating import shipped

    folder, _, begin = incomplete.rpartition("/")
    base = Path(f"{folder}/" if incomplete.startswith("/") else folder or ".")
    found = [name for name in shipped() if name.startswith(incomplete)]
    for path in sorted(base.glob(f"{glob.escape(begin)}*")):
        shown = f"{folder}/{path.name}" if "/" in incomplete else path.name
        if path.is_dir():
            found.append(f"{shown}/")
        elif path.suffix in (".yaml", ".yml"):
            found.append(shown)
    return found


File = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help="A deployment file, or the name of a shipped deployment.",
        autocompletion=deployments_here,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Change a value of the file: a name in its parameters, or a path such as "
        "nodes.arm.parameters.gain. The value is read as YAML. May be given several times.",
    ),
]
OutputFormat = Annotated[Format, typer.Option("--format", help="How the result is printed.")]
Epochs = Annotated[
    int | None,
    typer.Option(
        "--epochs",
        min=1,
        max=LARGEST,
        metavar="N",
        help="How many epochs; by default what the file says, or until the world has finished.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST, metavar="S", help="Of all random numbers.")]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Load and run, as yourself, whatever code is named by who is not known to be you."),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace the output or recording of another run; of other files none is touched."),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        metavar="DIR",
        help="A folder for states, digests, the report and what probes write; made where it lacks.",
    ),
]


@dataclass(kw_only=True)
class DeploymentOptions:
    """How a deployment is run, whatever runs it: ``run``, ``launch`` or ``view``."""

    epochs: Epochs = None  # how many; None: what the file says
    seed: Seed = 0  # of all random numbers
    overrides: Overrides = None  # of values of the file
    overwrite: Overwrite = False  # whether what another run has left is replaced


@dataclass(kw_only=True)
class RunOptions(DeploymentOptions):
    """What ``run`` and ``launch`` have in common."""

    output_format: OutputFormat = Format.text  # of the report
    output: Output = None  # folder for the states, digests, the report and what probes write; None: nothing is written
    record: RecordFile = None  # the file of the recording; None: there is none
    check: Check = False  # whether the formal order is checked
    exclude: Exclude = None  # what is left out of the recording, and how long it may be
    max_size: MaxSize = None  # likewise
    max_duration: MaxDuration = None  # likewise
