"""Results on the terminal or as JSON."""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hierax.runtime.execution.report import Json, Report
    from hierax.schemas.values import Value

RIGHT = {"justify": "right"}  # the options of a column of numbers
PIPE_COLUMNS = 200  # width of tables that are not printed on a terminal
SHOWN_CHARS = 60
SHOWN_ITEMS = 8


def print_json(value: "Json") -> None:
    """A result as JSON on standard output."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")
    sys.stdout.flush()


def show_progress(what: str, end: str = "\n") -> None:
    """What is going on, on standard error; only a terminal gets it."""
    if sys.stderr.isatty():
        print(what, file=sys.stderr, end=end)


def console() -> "Console":
    """Standard output, for tables."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPE_COLUMNS, highlight=False, markup=False)


def by_process(nodes: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Nodes, by name, as a launch tells of them: those that share a process are beside one another, and come first."""
    order = sorted(nodes, key=lambda name: (not nodes[name].get("shares"), nodes[name].get("shares") or ""))
    return {name: nodes[name] for name in order}


def in_force_text(in_force: Mapping[str, int]) -> str:
    """Of a node with rates: the nodes above it, and which epochs of theirs count; ``-`` where none does yet."""
    return ", ".join(f"{upper} {epoch or '-'}" for upper, epoch in sorted(in_force.items()))


def print_table(columns: Mapping[str, Mapping[str, Any]], rows: Sequence[tuple[str, ...]]) -> None:
    """A table on standard output; see `table_of`."""
    console().print(table_of(columns, rows))


def table_of(columns: Mapping[str, Mapping[str, Any]], rows: Sequence[tuple[str, ...]], **options: Any) -> "Table":
    """A table, of columns' headings with rich's options, and rows of texts; with further options of the table's."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    from hierax.runtime.host.streams import printable

    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, **options)
    for heading, of_column in columns.items():
        table.add_column(heading, overflow="fold", **of_column)
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    return table


def print_report(report: "Report") -> None:
    """A run's report as text."""
    from hierax.runtime.execution.timing import lines_of

    rate = report.epochs_per_s
    speed = f" in {report.wall_s:.3g} s ({rate:.4g} epochs/s)" if rate else ""
    epochs = "1 epoch" if report.epochs == 1 else f"{report.epochs} epochs"
    lines = [f"{report.hierarchy}: {report.mode}, seed {report.seed}, {epochs}{speed}"]
    times = [f"{name} {time_us:.0f} µs" for name, time_us in report.epoch_us.items() if time_us is not None]
    if times:
        lines.append(f"epoch: {', '.join(times)}")
    if report.start_s is not None:
        lines.append(f"start to first epoch: {report.start_s:.2f} s")
    lines += lines_of(report.timing)
    lines.append(f"digest: {report.digest}")
    if report.output is not None:
        lines.append(f"output: {report.output}")
    print("\n".join(lines), end="\n\n")
    rows = []
    for name in sorted(report.nodes):
        node = report.nodes[name]
        metrics = ", ".join(f"{key} {value:.6g}" for key, value in sorted(node.metrics.items()))
        rows.append((name, node.policy, metrics, brief(node.belief)))
    print_table({"node": {}, "policy": {}, "metrics": {}, "belief": {}}, rows)


def brief(value: "Value") -> str:
    """A value in one short line."""
    from hierax.runtime.tools.summary import in_line

    text = in_line(value, SHOWN_ITEMS)
    return text if len(text) <= SHOWN_CHARS else f"{text[: SHOWN_CHARS - 1]}…"
