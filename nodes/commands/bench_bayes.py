"""``hierax bench bayes``: exact inference beside other libraries, in one run."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.commands.options import Format, OutputFormat
from hierax.runtime.commands.show import print_json, print_table, show_progress

if TYPE_CHECKING:
    from hierax.nodes.benchmarks.bayes import Cell

SIZES = "10,100,1000,10000"


def bayes(
    nodes: Annotated[str, typer.Option(metavar="N,…", help="Sizes of the random trees.")] = SIZES,
    rounds: Annotated[int, typer.Option(min=1, help="How often all ways take turns.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Of networks and evidence.")] = 1,
    output_format: OutputFormat = Format.text,
) -> int:
    """Time exact posteriors in causal trees beside pyAgrum and pgmpy (pip install 'hierax[bench]')."""
    from hierax.nodes.benchmarks.bayes import bench_bayes

    cells = bench_bayes(_sizes(nodes), rounds, seed, show_progress)
    if output_format is Format.json:
        print_json({"cells": [asdict(cell) for cell in cells]})
    else:
        _print(cells)
    return 0


def _sizes(text: str) -> list[int]:
    sizes = [int(part) for part in text.split(",") if part.strip().isdecimal() and int(part) > 0]
    if len(sizes) != text.count(",") + 1:
        raise CommandError(
            f"--nodes: expected numbers of at least 1, separated by commas, such as {SIZES}, got {text!r}"
        )
    return sizes


def _print(cells: "Sequence[Cell]") -> None:
    rows: dict[str, list[str]] = {}
    for cell in cells:
        rows.setdefault(cell.way, [cell.way]).append(_shown(cell))
    columns = {"way": {}, **{f"{cell.nodes} nodes": {"justify": "right"} for cell in cells}}
    print("One update of 30 % of the leaves, all posteriors: CPU ms (largest error)", end="\n\n")
    print_table(columns, [tuple(row) for row in rows.values()])
    notes = [f"{cell.way}, {cell.nodes} nodes: {cell.note}" for cell in cells if cell.note]
    if notes:
        print("\n" + "\n".join(notes))


def _shown(cell: "Cell") -> str:
    if cell.update_ms is None or cell.error is None:
        return "–"
    return f"{cell.update_ms:.3g} ({cell.error:.0e})"
