"""Results on the terminal or as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hierax.runtime.execution.plain import Json
from hierax.schemas.values import Value

if TYPE_CHECKING:
    from rich.console import Console

    from hierax.runtime.execution.report import Report

PIPE_COLUMNS = 200  # width of tables that are not printed on a terminal

SHOWN_CHARS = 60
SHOWN_ITEMS = 8


def print_json(value: Json) -> None:
    """A result as JSON on standard output."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")
    sys.stdout.flush()


def show_progress(what: str) -> None:
    """What is going on, on standard error; only a terminal gets it."""
    if sys.stderr.isatty():
        print(what, file=sys.stderr)


def console() -> Console:
    """Standard output, for tables."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPE_COLUMNS, highlight=False, markup=False)


def print_table(columns: Mapping[str, Mapping[str, Any]], rows: Sequence[tuple[str, ...]]) -> None:
    """A table.

    Args:
        columns: options of rich's columns, by heading.
        rows: texts, one for each column.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading, options in columns.items():
        table.add_column(heading, overflow="fold", **options)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console().print(table)


def print_report(report: Report) -> None:
    """A run's report as text."""
    rate = report.epochs_per_s
    speed = f" in {report.wall_s:.3g} s ({rate:.4g} epochs/s)" if rate else ""
    lines = [f"{report.hierarchy}: {report.mode}, seed {report.seed}, {_count(report.epochs, 'epoch')}{speed}"]
    if report.p50_us is not None and report.p99_us is not None:
        lines.append(f"epoch: p50 {report.p50_us:.0f} µs, p99 {report.p99_us:.0f} µs")
    if report.start_s is not None:
        lines.append(f"start to first epoch: {report.start_s:.2f} s")
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


def brief(value: Value) -> str:
    """A value in one short line."""
    text = _brief(value)
    return text if len(text) <= SHOWN_CHARS else f"{text[: SHOWN_CHARS - 1]}…"


def _brief(value: Value) -> str:
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, np.ndarray):
        if value.size <= SHOWN_ITEMS:
            return _brief(value.tolist())
        return f"{value.dtype} array {'×'.join(map(str, value.shape))}"
    if isinstance(value, dict):
        return "{" + _items([f"{key}: {_brief(item)}" for key, item in _first(value.items())], len(value)) + "}"
    if isinstance(value, (tuple, list)):
        return "[" + _items([_brief(item) for item in _first(value)], len(value)) + "]"
    return str(value)


def _first(items: Any) -> list[Any]:
    return [item for _, item in zip(range(SHOWN_ITEMS), items, strict=False)]


def _items(texts: list[str], count: int) -> str:
    return ", ".join([*texts, *(("…",) if count > len(texts) else ())])


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
