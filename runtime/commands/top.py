"""``hierax top``: what the nodes of a launch spend their time on."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.commands.options import Connect, Format, KeyFile, OutputFormat, Run, option
from hierax.runtime.commands.show import by_process, console, in_force_text, print_json, table_of
from hierax.runtime.commands.which_launch import client_at, launch_meant
from hierax.runtime.host.streams import printable

if TYPE_CHECKING:
    from rich.table import Table

    from hierax.runtime.transport.launch_client import LaunchClient

_TIMES = ("observe", "policy", "predict", "edges", "act", "other", "waiting")
_COLUMNS = ("process", "node", "host", "state", "epoch", "with", *_TIMES, "for", "cpu", "memory", "restarts")
_DISPENSABLE = ("state", "other", "cpu")
_LEFT = ("process", "node", "host", "state", "with", "for")
WIDE, NARROW = 140, 100
"""Widths of a terminal, from which columns have space between them, and below which some are left out."""

_UNITS = ((1e6, "s"), (1e3, "ms"), (1.0, "µs"))
_WAITED_FOR = 3  # how many of those that a node waits for are named in its row


def top(
    run: Run = None,
    connect: Connect = None,
    key: KeyFile = None,
    once: Annotated[bool, option("--once")] = False,
    interval: Annotated[float, option("--interval", min=0.1, max=3600)] = 1.0,
    output_format: OutputFormat = Format.text,
) -> int:
    """Show where the time of a launch's nodes goes, until Ctrl-C: per epoch, in which operator, waiting for whom."""
    with client_at(launch_meant(run, connect, key)) as client:
        looks = overviews(client, interval, time.sleep)
        if once:
            _print_once(next(looks, None), output_format)
        elif output_format is Format.json or not sys.stdout.isatty():
            for look in looks:
                _print(look, output_format)
        else:
            _show_live(looks)
    return 0


def overviews(client: "LaunchClient", interval_s: float, sleep: Callable[[float], None]) -> Iterator[Mapping[str, Any]]:
    """One overview after the other, each of an interval; ends when the launch does."""
    from hierax.runtime.tools.rates import overview
    from hierax.runtime.transport.port import TransportError

    question = {"look": "meter"}
    status = client.status()
    before = client.ask_nodes(status, question, status.nodes)
    while True:
        sleep(interval_s)
        try:
            status = client.status()
        except TransportError:
            return  # it is over
        after = client.ask_nodes(status, question, status.nodes)
        yield overview(status, before, after)
        before = after


def _print_once(look: Mapping[str, Any] | None, output_format: Format) -> None:
    """The only one. Raises `CommandError` if there is none, as the launch has ended meanwhile."""
    if look is None:
        raise CommandError("the launch is over")
    if output_format is Format.json:
        print_json(look)
    else:
        _print(look, output_format)


def _print(look: Mapping[str, Any], output_format: Format) -> None:
    """One of many: a line of JSON each, or one table below the other."""
    if output_format is Format.json:
        print(json.dumps(look, allow_nan=False), flush=True)
        return
    print(headline(look), flush=True)
    out = console()
    out.print(table(look, out.width))


def _show_live(looks: Iterator[Mapping[str, Any]]) -> None:
    from rich.console import Group
    from rich.live import Live

    out = console()
    with Live(console=out, auto_refresh=False, transient=True) as live:
        shown = None
        for look in looks:
            shown = Group(headline(look), table(look, out.width))
            live.update(shown, refresh=True)
    if shown is not None:
        out.print(shown)
    print("the launch is over")


def headline(look: Mapping[str, Any]) -> str:
    """A launch in one line, and in further ones how it keeps its times."""
    from hierax.runtime.execution.timing import lines_of

    line = f"{look['hierarchy']}, run {look['run']}: epoch {look['epoch']}, {look['epochs_per_s']:.4g} epochs/s"
    if look["epoch_us"]["p50"] is not None:
        line += f", an epoch p50 {_time(look['epoch_us']['p50'])}, p99 {_time(look['epoch_us']['p99'])}"
    counts = [
        f"; {name}: " + ", ".join(f"{what} {float(figure):.6g}" for what, figure in sorted(node["metrics"].items()))
        for name, node in look["nodes"].items()
        if node.get("metrics")
    ]
    line += f", roster version {look['roster']}{printable(''.join(counts), kept='')}"
    return "\n".join([line, *lines_of(look.get("timing"))])


def table(look: Mapping[str, Any], width: int = WIDE) -> "Table":
    """The nodes of a launch as rows: times are per epoch. On a narrow terminal, some columns are left out."""
    acts = any((node.get("per_epoch_us") or {}).get("act") for node in look["nodes"].values())
    some = {what: any(node.get(what) for node in look["nodes"].values()) for what in ("shares", "host", "in_force")}
    told = (("act", acts), ("process", some["shares"]), ("host", some["host"]), ("with", some["in_force"]))
    left_out = {name for name, is_there in told if not is_there}
    shown = [column for column in _COLUMNS if column not in left_out]
    if width < NARROW:
        shown = [column for column in shown if column not in _DISPENSABLE]
    columns = {heading: {} if heading in _LEFT else {"justify": "right", "no_wrap": True} for heading in shown}
    rows = [_cells(name, node) for name, node in by_process(look["nodes"]).items()]
    cells = [tuple(printable(row.get(heading, ""), kept="") for heading in shown) for row in rows]
    return table_of(columns, cells, padding=(0, 1) if width >= WIDE else 0)


def _cells(name: str, node: Mapping[str, Any]) -> dict[str, str]:
    """A node's row, by heading."""
    cells = {"process": node.get("shares", ""), "node": name, "host": node.get("host", "")}
    cells["restarts"] = str(node["restarts"])
    if not node["answers"]:
        state = node["state"] if node["state"] != "running" else "no answer"
        return {**cells, "state": state, "for": state}
    spent = node["per_epoch_us"]
    waits = [f"{who or 'its turn'} {part:.0%}" for who, part in list(node["waits_for"].items())[:_WAITED_FOR]]
    return {
        **cells,
        "state": node["doing"] if spent is None else node["state"],
        "epoch": str(node["epoch"]),
        "with": in_force_text(node.get("in_force", {})),
        **{what: f"{node['share'][what]:.0%}" if spent is None else _time(spent[what]) for what in _TIMES},
        "for": ", ".join(waits),
        "cpu": f"{node['cpu']:.0%}",
        "memory": f"{node['rss_bytes'] / 2**20:.0f} MB",
    }


def _time(us: float) -> str:
    for size, unit in _UNITS:
        if us >= size:
            return f"{us / size:.3g} {unit}"
    return f"{us:.1f} µs" if us >= 0.05 else "0"
