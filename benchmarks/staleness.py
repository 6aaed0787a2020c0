"""How much faster tracking is when epochs may overlap, and how well it tracks then.

    python benchmarks/staleness.py
    python benchmarks/staleness.py --rounds 1 --format json barrier free

Launches `tracking` (six simulated cubes, 60 frames) in every way, one after the other, and
that `--rounds` times, each time in another order. Epochs per second are the world's: frames
of the camera. In free running the arm leaves frames out, so how many it has done stands beside
that, and how often it had no pose for an object in a frame that it did.

Errors are of the arm's poses (``poses.csv``) against the simulated ones (``truth.csv``), over all
objects and all frames that the arm did: the median, and the worst. Figures of speed are the
median of the rounds, with the least and the greatest; ratios are against the barrier in the same
round, as other processes share the processors. Errors are the median of the rounds' medians, and
the worst of all rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from commands import reported

from hierax.nodes.tracking.evaluation.report import read_errors
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors

TIMEOUT_S = 300.0
FRAMES = 60
EPOCHS = ("--epochs", str(FRAMES))
"""Told to the launch, so that the last epoch is drained: without it the world's end is the run's."""

BARRIER = "barrier"
RATE_HZ = 15
"""Of the world and the spatial node where there are rates."""

_TURNS = ("nodes.spatial.every=2", "nodes.spatial.offset=1")
_DELAY = ("edges.arm -> spatial.delay=1", "nodes.arm.parameters.waits=1")
RATED: Mapping[str, Sequence[str]] = {
    "every-2": _TURNS,
    "delay-1": _DELAY,
    "delay-1-all": (*_DELAY, "edges.world -> arm.delay=1"),
    "both": (*_TURNS, *_DELAY),
}
"""Epochs may overlap by rates, too: the arm then waits for its first context."""

WAYS: Mapping[str, Sequence[str]] = {
    BARRIER: (),
    "1": ("staleness=1",),
    "2": ("staleness=2",),
    "free": ("staleness=null",),
    "free-rates": ("staleness=null", f"nodes.world.rate_hz={RATE_HZ}", f"nodes.spatial.rate_hz={RATE_HZ}"),
    **RATED,
}
"""By name, what is set of the deployment."""


class Launch(NamedTuple):
    """What one launch has come to.

    Attributes:
        epochs_hz: epochs per second, from the beginning of the first to the commit of the last.
        frames: how many the arm did, of `FRAMES`.
        lost: in those, how often it had no pose for an object.
        median_mm, worst_mm, median_deg, worst_deg: errors.
        staleness_mean: at the arm, in epochs.
        digest: of the last epoch.
    """

    epochs_hz: float
    frames: int
    lost: int
    median_mm: float
    worst_mm: float
    median_deg: float
    worst_deg: float
    staleness_mean: float
    digest: str


def launch(way: str, output: Path) -> Launch:
    """Launch the tracking deployment in one way."""
    changes = [word for change in (*WAYS[way], f"frames={FRAMES}") for word in ("--set", change)]
    words = ["tracking", "--output", str(output), *EPOCHS, *changes]
    report = reported(f"{way}: the launch failed", "launch", *words, timeout_s=TIMEOUT_S)
    metrics = report["nodes"]["arm"]["metrics"]
    return measured(read_errors(output), report, metrics.get("staleness_mean", 0.0))


def measured(errors: Sequence[ObjectErrors], report: Mapping[str, Any], staleness_mean: float) -> Launch:
    """The figures of a launch."""
    distances_mm = np.array([item.distance_mm for item in errors])
    angles_deg = np.array([item.angle_deg for item in errors])
    given = ~np.isnan(distances_mm)
    done = given.any(axis=0)
    return Launch(
        epochs_hz=report["epochs"] / report["wall_s"],
        frames=int(done.sum()),
        lost=int((~given[:, done]).sum()),
        median_mm=float(np.nanmedian(distances_mm)),
        worst_mm=float(np.nanmax(distances_mm)),
        median_deg=float(np.nanmedian(angles_deg)),
        worst_deg=float(np.nanmax(angles_deg)),
        staleness_mean=staleness_mean,
        digest=report["digest"],
    )


def summary(launches: Sequence[Launch], barriers: Sequence[Launch]) -> dict[str, Any]:
    """The rounds of one way in figures."""
    speeds_hz = [each.epochs_hz for each in launches]
    ratios = [each.epochs_hz / barrier.epochs_hz for each, barrier in zip(launches, barriers, strict=False)]
    return {
        "epochs_hz": round(statistics.median(speeds_hz), 1),
        "epochs_hz_range": [round(min(speeds_hz), 1), round(max(speeds_hz), 1)],
        "ratio": round(statistics.median(ratios), 2) if ratios else None,
        "frames": [min(each.frames for each in launches), max(each.frames for each in launches)],
        "lost": sum(each.lost for each in launches),
        "median_mm": round(statistics.median(each.median_mm for each in launches), 2),
        "worst_mm": round(max(each.worst_mm for each in launches), 2),
        "median_deg": round(statistics.median(each.median_deg for each in launches), 3),
        "worst_deg": round(max(each.worst_deg for each in launches), 2),
        "staleness_mean": round(statistics.median(each.staleness_mean for each in launches), 2),
        "digests": len({each.digest for each in launches}),
    }


def table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """All ways as text, one line each."""
    lines = [
        "way          epochs/s             ratio   frames      lost   position, mm      rotation, °      age   digests",
        "                                                            median  worst     median  worst",
    ]
    for way, each in results.items():
        least, most = each["epochs_hz_range"]
        speed = f"{each['epochs_hz']:.1f} ({least:.1f}–{most:.1f})"
        ratio = "–" if each["ratio"] is None else f"{each['ratio']:.2f}"
        frames = "–".join(str(count) for count in sorted(set(each["frames"])))
        errors = (
            f"{each['median_mm']:6.2f} {each['worst_mm']:6.2f}     {each['median_deg']:6.3f} {each['worst_deg']:6.2f}"
        )
        age = each["staleness_mean"]
        lines.append(
            f"{way:11}  {speed:20} {ratio:5}   {frames:10} {each['lost']:5}  {errors}   {age:4.2f}   {each['digests']}"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Launch in all ways, and print the figures.

    Returns:
        The exit code: 1 where rates or the barrier have given different digests.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ways", nargs="*", metavar="WAY", help=f"of {', '.join(WAYS)}; by default all")
    parser.add_argument("--rounds", type=int, default=3, help="how often each is launched (default: 3)")
    parser.add_argument("--format", choices=("text", "json"), default="text", help="how the figures are printed")
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error(f"--rounds: expected at least 1, got {options.rounds}")
    unknown = sorted(set(options.ways) - WAYS.keys())
    if unknown:
        parser.error(f"there is no way {unknown[0]!r}; expected one of {', '.join(WAYS)}")
    ways = [way for way in WAYS if not options.ways or way in options.ways]
    launches: dict[str, list[Launch]] = {way: [] for way in ways}
    for turn in range(options.rounds):
        for way in ways[turn % len(ways) :] + ways[: turn % len(ways)]:
            with tempfile.TemporaryDirectory() as folder:
                launches[way].append(launch(way, Path(folder)))
            print(f"round {turn + 1}, {way}: {launches[way][-1].epochs_hz:.1f} epochs/s", file=sys.stderr)
    barriers = launches.get(BARRIER, [])
    results = {way: summary(each, barriers) for way, each in launches.items()}
    if options.format == "json":
        print(json.dumps({"rounds": options.rounds, "load": os.getloadavg()[0], "ways": results}, indent=2))
    else:
        print(table(results))
    differ = [way for way in (BARRIER, *RATED) if way in results and results[way]["digests"] > 1]
    for way in differ:
        print(f"{way}: the digests of its launches differ", file=sys.stderr)
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
