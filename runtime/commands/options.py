"""Arguments and options that several commands share."""

from __future__ import annotations

import glob
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from hierax.runtime.commands.recordings import Exclude, First, Last, MaxDuration, MaxSize, Tolerance, WorldMode
from hierax.runtime.commands.which import Connect, Run

LARGEST = 2**63 - 1  # what a message can carry


class Format(str, Enum):
    """How a result is printed."""

    text = "text"
    json = "json"


def deployments_here(incomplete: str) -> list[str]:
    """Give, for completion, shipped deployments, YAML files, and folders, which end with a slash."""
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
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Load and run, as yourself, whatever code is named by who is not known to be you."),
]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace the output or recording of another run; of other files none is touched."),
]
DeploymentFile = Annotated[
    str | None,
    typer.Option(
        "--deployment",
        metavar="FILE",
        help="The launch's deployment file, where it has another path on this machine.",
    ),
]


@dataclass(kw_only=True)
class RunOptions:
    """All options of ``run``, ``launch``, ``replay`` and ``view``; what a command lacks stays at its default."""

    epochs: Annotated[
        int | None,
        typer.Option(
            "--epochs",
            min=1,
            max=LARGEST,
            metavar="N",
            help="How many epochs; by default what the file says, or until the world has finished.",
        ),
    ] = None
    seed: Annotated[int, typer.Option("--seed", min=0, max=LARGEST, metavar="S", help="Of all random numbers.")] = 0
    overrides: Overrides = None
    overwrite: Overwrite = False
    trust: Trust = False
    output_format: OutputFormat = Format.text
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="DIR",
            help="A folder for states, digests, the report and what probes write; made where it lacks.",
        ),
    ] = None
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FILE",
            help="Record the run into this MCAP file. Exit code 1 if something said is not in it.",
            dir_okay=False,
        ),
    ] = None
    check: Annotated[
        bool, typer.Option("--check", help="Check the formal order while it runs. Exit code 1 where it is broken.")
    ] = False
    exclude: Exclude = None
    max_size: MaxSize = None
    max_duration: MaxDuration = None
    first: First = 1
    last: Last = None
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="EPOCH:CHANGE",
            help="Change the roster at the start of an epoch: EPOCH:attach:FILE, EPOCH:detach:NODE[:cascade] or "
            "EPOCH:replace:NODE:FILE. May be given several times.",
        ),
    ] = None
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            metavar="DIR",
            help="A folder for the nodes' checkpoints; it stays, for --resume. By default it goes with the run.",
        ),
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Go on with the run whose checkpoints are in this folder, at its next epoch.",
        ),
    ] = None
    host: Annotated[
        str | None,
        typer.Option(
            "--host",
            metavar="ADDRESS",
            help="An address of this machine at which processes on others may join; by default none may.",
        ),
    ] = None
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            metavar="NODE:INSTANT:N",
            help="Have a node's process kill itself the N-th time it comes to an instant; its next process takes the "
            "node's next one. For tests.",
            hidden=True,
        ),
    ] = None
    run: Run = None
    connect: Connect = None
    native: Annotated[bool, typer.Option("--native", help="In a window of Rerun's, in place of a browser.")] = False
    save: Annotated[
        Path | None, typer.Option("--save", metavar="FILE.rrd", help="Into a file, for `rerun FILE.rrd`; no viewer.")
    ] = None
    port: Annotated[
        int | None,
        typer.Option(
            "--port",
            min=1,
            max=65535,
            metavar="PORT",
            help="Of the page, on this machine's loopback; by default 9090, or a free one where that is taken.",
        ),
    ] = None
    deployment_file: DeploymentFile = None
    opens: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False
    memory: Annotated[
        str, typer.Option("--memory", metavar="SIZE", help="How much the viewer keeps; what is older is dropped.")
    ] = "1GiB"
    node: Annotated[
        str | None, typer.Option("--node", metavar="NAME", help="This node alone, on its recorded inputs.")
    ] = None
    world: Annotated[
        WorldMode,
        typer.Option(
            "--world", help="The world gives what it gave, or, one without actuators, is done again like the others."
        ),
    ] = WorldMode.recorded
    speed: Annotated[
        float, typer.Option("--speed", min=0.0, metavar="S", help="S times as fast as it was; 0: as fast as it goes.")
    ] = 0.0
    classes: Annotated[
        list[str] | None,
        typer.Option(
            "--with", metavar="NODE=MODULE:CLASS", help="Another class in a node's place. May be given several times."
        ),
    ] = None
    verify: Annotated[
        bool,
        typer.Option(
            "--verify", help="Compare every result and digest with the recording; exit code 1 where one differs."
        ),
    ] = False
    tolerance: Tolerance = 0.0


OF_A_RUN = (
    *("epochs", "seed", "overrides", "overwrite", "output_format", "output"),
    *("record", "check", "exclude", "max_size", "max_duration"),
)
"""What ``run`` and ``launch`` both offer, in the order of their help."""

Command = TypeVar("Command", bound=Callable[..., int])


def offers(*names: str) -> Callable[[Command], Command]:
    """Say which of the `RunOptions` a command offers on its command line."""

    def offering(command: Command) -> Command:
        vars(command)["offers"] = names
        return command

    return offering
