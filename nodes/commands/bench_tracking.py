"""``hierax bench tracking``: tracking with and without context, physics and prior."""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.options import Format, OutputFormat, Overrides
from hierax.runtime.commands.show import RIGHT, print_json, print_table, show_progress
from hierax.runtime.core.errors import HieraxError

if TYPE_CHECKING:
    from hierax.nodes.benchmarks.tracking import Gain, Row, Scene, Speed


def tracking(
    kinds: Annotated[
        str, typer.Option(metavar="NAMES", help="Kinds of generated scenes, separated by commas; by default all.")
    ] = "",
    seeds: Annotated[int, typer.Option(min=1, help="How many scenes of each kind.")] = 1,
    frames: Annotated[int, typer.Option(min=2, help="Of each generated scene.")] = 150,
    generator: Annotated[
        str,
        typer.Option(metavar="A|B|FILE", help="Who generates: the package, another hand (in a checkout), a program."),
    ] = "A",
    exact: Annotated[bool, typer.Option("--exact", help="Generated scenes tell start and camera as they are.")] = False,
    scene: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A scene in the BOP format, in place of generated ones.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of its scene_gt.json of all frames; by default DATASET/truth/000001, or else the scene.",
        ),
    ] = None,
    table: Annotated[bool, typer.Option("--table", help="The scene's plane z = 0 carries the objects.")] = False,
    ways: Annotated[
        str, typer.Option(metavar="NAMES", help="Ways of tracking, separated by semicolons; by default all.")
    ] = "",
    start: Annotated[
        str, typer.Option(metavar="given|search", help="search: no first poses are told; how many objects are found.")
    ] = "given",
    speed: Annotated[bool, typer.Option("--speed", help="Time launches over Zenoh instead.")] = False,
    rounds: Annotated[int, typer.Option(min=1, help="How often each is launched, with --speed.")] = 3,
    keep: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for scenes, poses and beliefs; by default one that goes.")
    ] = None,
    settings: Overrides = None,
    output_format: OutputFormat = Format.text,
) -> int:
    """Track scenes with and without context, physics and prior, beside the truth."""
    from hierax.nodes.benchmarks import tracking as bench
    from hierax.nodes.tracking.world import GIVEN, SEARCH

    as_json = output_format is Format.json
    if start not in (GIVEN, SEARCH):
        raise HieraxError(f"--start is {start!r}; expected {GIVEN} or {SEARCH}")
    with ExitStack() as stack:
        folder = keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        if speed:
            speeds = bench.bench_speed(frames, rounds, settings or (), folder, show_progress)
            if as_json:
                print_json({"speeds": [each.plain() for each in speeds]})
            else:
                _print_speeds(speeds)
            return 0
        chosen_ways = bench.chosen("way", _names(ways, ";"), bench.WAYS)
        if scene is None:
            by = bench.generator(generator)
            chosen_kinds = bench.chosen("kind", _names(kinds, ","), by.kinds())
            scenes = bench.generated(by, chosen_kinds, seeds, frames, exact, folder, show_progress)
        else:
            scenes = [_given(scene, truth, table)]
        if start == SEARCH:
            return _bench_starts(scenes, settings or (), folder, as_json)
        rows = bench.bench_tracking(scenes, chosen_ways, settings or (), folder, show_progress)
        certainty = bench.certainty(scenes, chosen_ways, folder)
    gains = bench.gains(rows)
    if as_json:
        plain = {"rows": [row.plain() for row in rows], "gains": [gain.plain() for gain in gains]}
        print_json({**plain, "certainty": certainty and certainty.plain()})
    else:
        _print_rows(rows)
        _print_gains(gains)
        if certainty is not None:
            print("\nWith all, of poses said to be tracked:\n" + certainty.text())
    return 0


def _bench_starts(scenes: "Sequence[Scene]", settings: Sequence[str], folder: Path, as_json: bool) -> int:
    from hierax.nodes.benchmarks.first_poses import bench_starts

    found = bench_starts(scenes, settings, folder, show_progress)
    if as_json:
        print_json({"starts": [asdict(each) for each in found]})
        return 0
    heads = ("seen by 0.6", "right", "given", "wrong", "ms an object", "gone after (never)", "found after (never)")
    rows = []
    for each in found:
        counts = (each.seen, each.right, each.given, each.wrong, round(each.object_ms))
        rows.append((each.name, *map(str, counts), _after(each.gone), _after(each.found)))
    print_table({"scene": {}, **dict.fromkeys(heads, RIGHT)}, rows)
    print(
        "Objects in frame 30, or the last: seen by 0.6 of them or more, right within 5 mm and 5°; poses given, and\n"
        "wrong by more than 20 mm or 10°. After how many frames, in the mean, what was taken out is gone, and what\n"
        "was put in is right."
    )
    return 0


def _after(frames: Sequence[int | None]) -> str:
    """After how many frames in the mean, and how often never."""
    known = [each for each in frames if each is not None]
    mean = f"{sum(known) / len(known):.1f}" if known else "–"
    return f"{mean} ({len(frames) - len(known)})" if frames else "–"


def _names(text: str, separator: str) -> list[str]:
    return [name.strip() for name in text.split(separator) if name.strip()]


def _given(scene: Path, truth: Path | None, table: bool) -> "Scene":
    from hierax.nodes.benchmarks.tracking import Scene
    from hierax.nodes.tracking.datasets.bop import dataset_of

    if not scene.is_dir():
        raise HieraxError(f"{scene}: no such folder; expected a BOP scene, DATASET/SPLIT/000001")
    name = scene.absolute().name
    apart = dataset_of(scene) / "truth" / name
    return Scene(name, 0, scene, truth or (apart if apart.is_dir() else scene), table)


def _print_rows(rows: "Sequence[Row]") -> None:
    heads = ["2/2", "5/5", "10/5", "5/5: 0.1–0.5", "0.5–0.9", "0.9–1", "mm (worst)", "° (worst)"]
    heads += ["no pose", "astray", "lost", "back", "ms world", "arm", "spatial"]
    columns = {"scene": {}, "way": {}, **dict.fromkeys(heads, RIGHT)}
    print_table(columns, [_cells(row) for row in rows])
    print(
        "Shares in % of frames within mm/°; 5/5 also by the visible share of an object (below 0.1 it is not counted).\n"
        "Errors are means; astray: off by more than 20 mm or 10°; back: frames until right again (never)."
    )


def _cells(row: "Row") -> tuple[str, ...]:
    from hierax.nodes.tracking.evaluation.scoring import percent

    score = row.score
    bands = (score.hidden, score.band(0.5, 0.9), score.band(0.9, 1.0))
    right = (*score.shares, *(band.shares[1] for band in bands))
    errors = (f"{score.mean_mm:.2f} ({score.worst_mm:.1f})", f"{score.mean_deg:.2f} ({score.worst_deg:.1f})")
    wrong = (percent(score.missing), percent(score.astray), str(score.lost), _after(score.again_frames))
    times = (f"{row.stage_ms.get(stage, float('nan')):.1f}" for stage in ("world", "arm", "spatial"))
    return (row.name, row.way, *map(percent, right), *errors, *wrong, *times)


def _print_gains(gains: "Sequence[Gain]") -> None:
    if not gains:
        return
    print("\nContext against own models: difference of the share within 5 mm/5° where more than half is hidden")
    rows = []
    for gain in gains:
        plain = gain.plain()
        mean, least, most = (f"{100.0 * plain[name]:+.1f}" for name in ("mean", "least", "most"))
        spread = "–" if plain["spread"] is None else f"{100.0 * plain['spread']:.1f}"
        rows.append((gain.name, str(plain["seeds"]), mean, spread, least, most))
    heads = ("seeds", "mean, points", "spread", "least", "most")
    print_table({"scene": {}, **dict.fromkeys(heads, RIGHT)}, rows)


def _print_speeds(speeds: "Sequence[Speed]") -> None:
    from hierax.nodes.benchmarks.tracking import STAGES

    rows = []
    for each in speeds:
        stages = [f"{each.stage_ms[stage]:.1f}" for stage in STAGES]
        rounds = ", ".join(f"{rate:.1f}" for rate in each.rounds)
        rows.append((str(each.objects), f"{each.epochs_hz:.1f}", rounds, *stages))
    heads = {"objects": RIGHT, "epochs/s": RIGHT, "rounds": {}}
    print_table({**heads, **{f"ms {stage}": RIGHT for stage in STAGES}}, rows)
