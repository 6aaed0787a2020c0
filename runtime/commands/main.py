"""The command ``hierax``."""

import functools
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter, Signature, signature
from typing import Annotated, get_type_hints

import typer

from hierax.runtime.commands import set_parameters
from hierax.runtime.commands.ctrl_c import CTRL_C, INTERRUPTED
from hierax.runtime.commands.doctor import doctor
from hierax.runtime.commands.echo import echo
from hierax.runtime.commands.errors import OK, CommandError, exit_code
from hierax.runtime.commands.graph import graph, validate
from hierax.runtime.commands.health import health
from hierax.runtime.commands.inspect import inspect
from hierax.runtime.commands.keys import keys
from hierax.runtime.commands.launch import launch
from hierax.runtime.commands.logs import logs
from hierax.runtime.commands.membership import attach, detach, ps, replace
from hierax.runtime.commands.new import new
from hierax.runtime.commands.options import Format, OutputFormat, RunOptions, option
from hierax.runtime.commands.recordings import check, diff, record
from hierax.runtime.commands.replay import replay
from hierax.runtime.commands.run import run
from hierax.runtime.commands.show import RIGHT, print_json, print_table, show_progress
from hierax.runtime.commands.sim import sim
from hierax.runtime.commands.top import top
from hierax.runtime.commands.view import view

COMMANDS: tuple[Callable[..., int], ...] = (
    *(run, launch, attach, detach, replace, set_parameters.set),
    *(ps, health, top, inspect, echo, logs, view, keys),
    *(record, replay, diff, check),
    *(new, validate, graph, sim, doctor),
)


def epoch(
    epochs: Annotated[int, typer.Option(min=100, help="Epochs in each round.")] = 2000,
    rounds: Annotated[int, option("--rounds", min=1)] = 5,
    output_format: OutputFormat = Format.text,
) -> int:
    """Time an epoch of three processes beside the same chain in bare Zenoh and msgpack."""
    from hierax.runtime.bench.epoch import bench_epoch

    rows = [row.plain() for row in bench_epoch(epochs, rounds, show_progress)]
    if output_format is Format.json:
        print_json({"rows": rows})
        return 0
    figures = ("ours p50 µs", "ours p99", "bare p50 µs", "bare p99", "ratio", "of rounds")
    cells = []
    for row in rows:
        times = [f"{row[side][quantile]:.0f}" for side in ("ours_us", "bare_us") for quantile in ("p50", "p99")]
        low, high = row["ratio_range"]
        cells.append((row["name"], *times, f"{row['ratio']:.2f}", f"{low:.2f} to {high:.2f}"))
    print_table({"work": {}, **dict.fromkeys(figures, RIGHT)}, cells)
    return 0


def peers(
    epochs: Annotated[int, typer.Option(min=100, help="Epochs in each round.")] = 1000,
    rounds: Annotated[int, option("--rounds", min=1)] = 5,
    output_format: OutputFormat = Format.text,
) -> int:
    """Time an epoch of three processes beside the same chain in plain Zenoh, ezmsg, dora and ROS 2 (`make peers`)."""
    from hierax.runtime.bench.peers import bench_peers

    tables = bench_peers(epochs, rounds, show_progress)
    if output_format is Format.json:
        print_json({"tables": tables})
        return 0
    for table in tables:
        print(f"\n{table['work']}, {'beside busy loops' if table['busy_loops'] else 'no other load'}")
        ours = [each for each in table["peers"] if "ratios" in each and each["name"].startswith("hierax")]
        cells = []
        for each in table["peers"]:
            if "missing" in each:
                cells.append((f"{each['name']}: {each['missing']}", "", "", *("" for _ in ours)))
                continue
            ratios = (f"{own['ratios'][each['name']]:.2f}" if each is not own else "" for own in ours)
            cells.append((each["name"], f"{each['p50_us']:.0f}", f"{each['p99_us']:.0f}", *ratios))
        columns = ("p50 µs", "p99", *(f"{own['name']}, times" for own in ours))
        print_table({"peer": {}, **dict.fromkeys(columns, RIGHT)}, cells)
    return 0


def main(arguments: Sequence[str]) -> int:
    """Do what the command line says. Returns the exit code."""
    code = exit_code(lambda: _dispatch(arguments))
    return INTERRUPTED if CTRL_C.came and code != OK else code


def _dispatch(arguments: Sequence[str]) -> int:
    try:
        typer.main.get_command(app_of(arguments)).main(args=list(arguments), prog_name="hierax")
    except SystemExit as finished:
        return finished.code if isinstance(finished.code, int) else OK
    return OK


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"hierax {version('hierax')}")
        raise typer.Exit


def _options(version: Annotated[bool, option("--version", callback=_print_version, is_eager=True)] = False) -> None:
    """Run cognitive hierarchies with perceptual context."""


def _register(command: Callable[..., int], group: typer.Typer, name: str = "") -> None:
    """Make a command of a function; those of `RunOptions` that it offers are arguments beside its own."""
    offered = getattr(command, "offers", ())

    @functools.wraps(command)
    def guarded(**given: object) -> None:
        if offered:
            given["options"] = RunOptions(**{name: given.pop(name) for name in offered})  # type: ignore[arg-type]
        raise typer.Exit(exit_code(lambda: command(**given)))

    if offered:
        hints = get_type_hints(RunOptions, include_extras=True) | get_type_hints(command, include_extras=True)
        every = signature(RunOptions).parameters | signature(command).parameters
        names = [name for name in (*signature(command).parameters, *offered) if name != "options"]
        own = [every[name].replace(annotation=hints[name], kind=Parameter.KEYWORD_ONLY) for name in names]
        guarded.__signature__ = Signature(own)  # type: ignore[attr-defined]
        guarded.__annotations__ = hints
    group.command(name or command.__name__)(guarded)


def _load(found: EntryPoint) -> Callable[..., int]:
    """What comes with nodes; where it cannot be loaded it answers why, and the others are not touched."""
    try:
        command: Callable[..., int] = found.load()
    except Exception as error:
        why = f"{found.value} cannot be loaded: {type(error).__name__}: {error}"

        def command() -> int:
            """Comes with a package of nodes that is broken."""
            raise CommandError(why)

    return command


def app_of(arguments: Sequence[str]) -> typer.Typer:
    """What understands these arguments: where they begin with one of `COMMANDS` it has that one alone, as making the
    others ready takes longer than many a command does."""
    app = typer.Typer(
        name="hierax",
        help="Run cognitive hierarchies with perceptual context.",
        epilog="Exit codes: 0 fine, 1 an expected failure, 2 usage, 3 a bug, 130 Ctrl-C. "
        "With HIERAX_TRACEBACK=1 failures are shown with the traceback.",
        add_completion=True,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
        callback=_options,
    )
    asked = [command for command in COMMANDS if [command.__name__] == [*arguments[:1]]]
    for command in asked or COMMANDS:
        _register(command, app)
    if not asked:
        _register_all("hierax.commands", app)
        bench = typer.Typer(
            name="bench", help="hierax beside a rival, or with less, in the same run.", no_args_is_help=True
        )
        app.add_typer(bench)
        _register(epoch, bench)
        _register(peers, bench)
        _register_all("hierax.benchmarks", bench)
    return app


def _register_all(kind: str, group: typer.Typer) -> None:
    """Register what comes with nodes."""
    for found in sorted(entry_points(group=kind), key=lambda found: found.name):
        _register(_load(found), group, found.name)
