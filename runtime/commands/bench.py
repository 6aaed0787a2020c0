"""``hierax bench``: hierax beside a rival, or beside itself with less, in the same run and on the same work."""

from __future__ import annotations

from typing import Annotated

import typer

from hierax.runtime.commands.options import Format, OutputFormat, option
from hierax.runtime.commands.show import RIGHT, print_json, print_table, show_progress


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
