"""``hierax bench``: hierax beside a rival, or beside itself with less, in the same run and on the same work."""

from __future__ import annotations

from typing import Annotated

import typer

from hierax.runtime.commands.options import Format, OutputFormat

_RIGHT = {"justify": "right"}


def epoch(
    epochs: Annotated[int, typer.Option(min=100, help="Epochs in each round.")] = 2000,
    rounds: Annotated[int, typer.Option(min=1, help="How often ours and the rival take turns.")] = 5,
    output_format: OutputFormat = Format.text,
) -> int:
    """Time an epoch of three processes beside the same chain in bare Zenoh and msgpack."""
    from hierax.runtime.bench.epoch import bench_epoch
    from hierax.runtime.commands.show import print_json, print_table, show_progress

    rows = bench_epoch(epochs, rounds, show_progress)
    if output_format is Format.json:
        print_json({"rows": [row.plain() for row in rows]})
        return 0
    shown = [row.plain() for row in rows]
    print_table(
        {
            "work": {},
            "ours p50 µs": _RIGHT,
            "ours p99": _RIGHT,
            "bare p50 µs": _RIGHT,
            "bare p99": _RIGHT,
            "ratio": _RIGHT,
            "of rounds": _RIGHT,
        },
        [
            (
                row["name"],
                *(f"{row[side][q]:.0f}" for side in ("ours_us", "bare_us") for q in ("p50", "p99")),
                f"{row['ratio']:.2f}",
                "{:.2f} to {:.2f}".format(*row["ratio_range"]),
            )
            for row in shown
        ],
    )
    return 0
