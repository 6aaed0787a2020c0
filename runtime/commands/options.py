"""Arguments and options that several commands share, and the words for those of all."""

import glob
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from hierax.runtime.commands.which_launch import keys_here, nodes_here, runs_here
from hierax.schemas.limits import LARGEST

_WORDS = """
--at EPOCH:CHANGE: Change the roster at the start of an epoch: EPOCH:attach:FILE, EPOCH:detach:NODE[:cascade] or
    EPOCH:replace:NODE:FILE. May be given several times.
--audit: Who changed what, or tried to, and who was not let in, in place of all else.
--cascade: Also what only this node joins to the world.
--check: Check the formal order while it runs. Exit code 1 where it is broken.
--connect ENDPOINT: The launch on another machine: the endpoint that `hierax launch --host` prints.
--count: End after so many messages.
--decisions: List in which epochs a node that is done again would have chosen another policy, or other actions.
--deployment FILE: The launch's deployment file, where it has another path on this machine.
--dry: Also call every operator and edge function once, on the initial beliefs; no actuator is moved, no probe is told,
    and nothing is written.
--epoch K: Of a recording; by default its last one.
--epochs N: How many epochs; by default what the file says, or until the world has finished.
--exclude KEY-PATTERN: Leave out of the recording what comes on such keys: KIND/FROM/TO or steps/NODE, with * for any,
    as in obs/camera/*. May be given several times.
--expires TIME: After what time it is good for nothing, such as 30m, 8h or 2d.
--faults KIND,…: Kinds of faults; by default all. 'none': only changes.
--follow: Go on until the launch is over, or Ctrl-C.
--format: How the result is printed.
--from K: The first epoch; by default the first that can be done.
--full: In JSON, arrays with all their elements.
--grep REGEX: With this in message or traceback.
--here: Keep the new nodes' processes on this machine, until Ctrl-C.
--host ADDRESS: An address of this machine at which processes on others may join; by default none may.
--interval SECONDS: How long each look takes.
--jobs N: Processes; by default one for each core.
--key FILE: With --connect: a copy of the key of that launch's run, for you alone; where it is, `hierax launch --host`
    says. Or one that `hierax keys` has made of it.
--level: From this level on.
--max-duration TIME: End the recording after this time, such as 90s, 15m or 2h; the run goes on.
--max-size SIZE: End the recording with the last whole epoch before it is larger, such as 500MB; the run goes on.
--memory SIZE: How much the viewer keeps; what is older is dropped.
--mend: First remove what launches that were killed have left behind.
--native: In a window of Rerun's, in place of a browser.
--node NAME: This node alone, on its recorded inputs.
--once: Look for one interval, print it, and end.
--open: Open the page in a browser.
--output DIR: A folder for states, digests, the report and what probes write; made where it lacks.
--overwrite: Replace the output, recording or state of another run; of other files none is touched.
--port PORT: Of the page, on this machine's loopback; by default 9090, or a free one where that is taken.
--processes N: Put the nodes into so many processes, as many into each, or by --traffic; else as the file says.
--rates: Of hierarchies whose nodes take part now and then, and whose edges have delays.
--record FILE: Record the run into this MCAP file. Exit code 1 if something said is not in it.
--resume DIR: Go on with the run whose checkpoints are in this folder, at its next epoch. With FILE, begin there where
    there is none, and end well where it is over.
--rounds: How often ours and the rival take turns.
--role: A reader looks, asks and records; an operator may also attach, detach, replace and set.
--run RUN: Which launch: its identification, or how that begins, or its hierarchy's name; `hierax ps` lists them.
--save FILE.rrd: Into a file, for `rerun FILE.rrd`; no viewer.
--seed S: Of all random numbers.
--seeds A:B: Which seeds: from A to before B; or one.
--set PATH=VALUE: Change a value of the file: a name in its parameters, or a path such as nodes.arm.parameters.gain. The
    value is read as YAML. May be given several times.
--since TIME: From then on: how long ago, such as 30s, 10m, 2h, 1d, or a time such as 2030-01-02T03:04.
--speed S: S times as fast as it was; 0: as fast as it goes.
--state DIR: A folder for the nodes' checkpoints; it stays, for --resume. By default it goes with the run.
--sync: First copy the folder of the file to the hosts that `place` needs, by rsync over ssh; nothing is deleted there.
--to K: The last epoch; by default the last one.
--tolerance T: Numbers are alike that differ by no more than T, or than this share of the greater one. 0: to the bit.
--trace: Print all events of a single seed.
--traffic FILE: With --processes: a recording of this hierarchy; the fewest of its bytes are to pass between processes.
--trust: Load and run, as yourself, whatever code is named by who is not known to be you.
--verify: Compare every result and digest with the recording; exit code 1 where one differs.
--version: Print the version.
--wait EPOCH|NODE: First wait until a launch has committed this epoch, or has this node: a minute at most, and not for
    one that is over.
--within SECONDS: How long the launch has for its next epoch; 0: it only has to answer.
--with NODE=MODULE:CLASS: Another class in a node's place. May be given several times.
--world: The world gives what it gave, or, one without actuators, is done again like the others.
"""
"""Each option with its placeholder, and what it is for; a command that means something else by it says so itself."""

_OPTIONS = {found[1]: found for found in re.finditer(r"^(--\S+?)(?: (\S+?))?: ((?:.|\n )+)", _WORDS, re.M)}


def option(name: str, *more_names: str, **given: Any) -> Any:
    """An option by its name, with its words; what else is given is as `typer.Option` has it."""
    _, metavar, words = _OPTIONS[name].groups()
    return typer.Option(name, *more_names, **{"metavar": metavar, "help": " ".join(words.split()), **given})


def argument(metavar: str, words: str, **given: Any) -> Any:
    """An argument by its placeholder, with its words; what else is given is as `typer.Argument` has it."""
    return typer.Argument(metavar=metavar, help=words, **given)


def finite(value: float) -> float:
    """A number of an option that is one; raises `typer.BadParameter` if it is infinite, or none."""
    if not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    return value


class Format(str, Enum):
    """How a result is printed."""

    text = "text"
    json = "json"


class WorldMode(str, Enum):
    """What the world does in a replay."""

    recorded = "recorded"
    again = "again"


def deployments_here(incomplete: str) -> list[str]:
    """Give, for completion, shipped deployments, YAML files, and folders, which end with a slash."""
    from hierax.runtime.deployment.deployment import shipped

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


_FILE = "A deployment file, or the name of a shipped deployment."
File = Annotated[str, argument("FILE", _FILE, autocompletion=deployments_here)]
LaunchedFile = Annotated[
    str | None, argument("FILE", f"{_FILE[:-1]}; not needed with --resume.", autocompletion=deployments_here)
]
RecordingFile = Annotated[Path, argument("FILE", "A recording.", dir_okay=False)]
Node = Annotated[str, argument("NODE", "A node's name.", autocompletion=nodes_here)]
SNIPPET = "A YAML snippet with nodes and edges"
Snippet = Annotated[str, argument("SOURCE", f"{SNIPPET}.")]
_KEY = "KIND/FROM/TO, where KIND is obs, task or ctx; * stands for any name, ** for all that is left."
Key = Annotated[str, argument("KEY", _KEY, autocompletion=keys_here)]
Run = Annotated[str | None, option("--run", autocompletion=runs_here)]
Connect = Annotated[str | None, option("--connect")]
KeyFile = Annotated[Path | None, option("--key", dir_okay=False)]
Overrides = Annotated[list[str] | None, option("--set")]
OutputFormat = Annotated[Format, option("--format")]
Full = Annotated[bool, option("--full")]


@dataclass(kw_only=True)
class RunOptions:
    """All options of ``run``, ``launch``, ``replay`` and ``view``; what a command lacks stays at its default."""

    epochs: Annotated[int | None, option("--epochs", min=1, max=LARGEST)] = None
    seed: Annotated[int, option("--seed", min=0, max=LARGEST)] = 0
    overrides: Overrides = None
    overwrite: Annotated[bool, option("--overwrite")] = False
    trust: Annotated[bool, option("--trust")] = False
    output_format: OutputFormat = Format.text
    output: Annotated[Path | None, option("--output")] = None
    record: Annotated[Path | None, option("--record", dir_okay=False)] = None
    check: Annotated[bool, option("--check")] = False
    exclude: Annotated[list[str] | None, option("--exclude")] = None
    max_size: Annotated[str | None, option("--max-size")] = None
    max_duration: Annotated[str | None, option("--max-duration")] = None
    first: Annotated[int, option("--from", min=1)] = 1
    last: Annotated[int | None, option("--to", min=1)] = None
    at: Annotated[list[str] | None, option("--at")] = None
    state: Annotated[Path | None, option("--state")] = None
    resume: Annotated[Path | None, option("--resume")] = None
    host: Annotated[str | None, option("--host")] = None
    sync: Annotated[bool, option("--sync")] = False
    processes: Annotated[int | None, option("--processes", min=1, max=LARGEST)] = None
    traffic: Annotated[Path | None, option("--traffic", dir_okay=False)] = None
    run: Run = None
    connect: Connect = None
    key: KeyFile = None
    native: Annotated[bool, option("--native")] = False
    save: Annotated[Path | None, option("--save")] = None
    port: Annotated[int | None, option("--port", min=1, max=65535)] = None
    deployment_file: Annotated[str | None, option("--deployment")] = None
    opens: Annotated[bool, option("--open")] = False
    memory: Annotated[str, option("--memory")] = "1GiB"
    nodes: Annotated[list[str] | None, option("--node")] = None
    world: Annotated[WorldMode, option("--world")] = WorldMode.recorded
    speed: Annotated[float, option("--speed", min=0.0, callback=finite)] = 0.0
    classes: Annotated[list[str] | None, option("--with")] = None
    verify: Annotated[bool, option("--verify")] = False
    decisions: Annotated[bool, option("--decisions")] = False
    tolerance: Annotated[float, option("--tolerance", min=0.0, callback=finite)] = 0.0


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
