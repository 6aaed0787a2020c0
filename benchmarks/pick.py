"""How often the arm of the pick deployment picks up a cube: scene by scene.

    python benchmarks/pick.py                    # scenes 0 to 19, each in one process; some six minutes
    python benchmarks/pick.py --scenes 3:5 --launch
    python benchmarks/pick.py --set target=3     # the cube that stands close to another one

Each scene is an own layout of five cubes, with own errors of the start, and is run with its
number as the run's seed, too. A cube counts as grasped when it was lifted by 10 cm and touched by
nothing but the two fingers for two seconds without a break. Errors are those of the cube that was
tried last, as the camera sees it: of the arm node's poses (``poses.csv``) against the world's (``truth.csv``).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from commands import reported

from hierax.nodes.tracking.evaluation.report import read_errors
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors

TIMEOUT_S = 600.0
SCENES = "0:20"
SETTLED_FRAMES = 20
"""So many frames the tracker has before its errors count."""


class Errors(NamedTuple):
    """How wrong the tracker was about a cube.

    Attributes:
        start_mm, start_deg: in the first frame.
        median_mm, median_deg, worst_mm: after the first second.
    """

    start_mm: float
    start_deg: float
    median_mm: float
    median_deg: float
    worst_mm: float


class Episode(NamedTuple):
    """What has come of one scene.

    Attributes:
        scene: its number.
        grasped: whether a cube was lifted and held as it should.
        cube: id of the last one that was tried, 0 for none; `attempts`: how many there were.
        lift_mm: how far it was lifted at the end; `held_s`: how long it has been held by then.
        errors: the tracker's of that cube; None where none was tried.
        frames: how many the episode took; `wall_s`: in how many seconds.
        digest: of the last epoch.
    """

    scene: int
    grasped: bool
    cube: int
    attempts: int
    lift_mm: float
    held_s: float
    errors: Errors | None
    frames: int
    wall_s: float
    digest: str


def episode(scene: int, command: str, settings: Sequence[str] = ()) -> Episode:
    """Run or launch one scene.

    Args:
        scene: its number.
        command: ``run`` or ``launch``.
        settings: further ones of the deployment, as ``path=value``.

    Raises:
        SystemExit: it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        words = ["pick", "--seed", str(scene), "--output", folder]
        words += [word for setting in (*settings, f"scene={scene}") for word in ("--set", setting)]
        report = reported(f"scene {scene}: {command} failed", command, *words, timeout_s=TIMEOUT_S)
        return measured(scene, report, read_errors(Path(folder)))


def measured(scene: int, report: dict[str, Any], errors: Sequence[ObjectErrors]) -> Episode:
    """The figures of a report, and of the tracker's errors of all cubes."""
    world, grasp = (report["nodes"][name]["metrics"] for name in ("world", "grasp"))
    cube = int(grasp["target"])
    tried = [errors_of(item) for item in errors if item.obj_id == cube]
    return Episode(
        scene=scene,
        grasped=world["grasped"] == 1.0,
        cube=cube,
        attempts=int(grasp["attempts"]),
        lift_mm=world["lift_mm"],
        held_s=world["held_s"],
        errors=tried[0] if tried else None,
        frames=report["epochs"],
        wall_s=report["wall_s"],
        digest=report["digest"],
    )


def errors_of(item: ObjectErrors) -> Errors:
    """A cube's errors in short, over the frames in which it has a pose."""
    later = np.arange(len(item.frames)) >= SETTLED_FRAMES
    later &= ~np.isnan(item.distance_mm)
    return Errors(
        start_mm=float(item.distance_mm[0]),
        start_deg=float(item.angle_deg[0]),
        median_mm=float(np.median(item.distance_mm[later])),
        median_deg=float(np.median(item.angle_deg[later])),
        worst_mm=float(np.max(item.distance_mm[later])),
    )


def line(each: Episode) -> str:
    """An episode as a row of the table."""
    errors = "     –    –       –      –      –"
    if each.errors is not None:
        start_mm, start_deg, median_mm, median_deg, worst_mm = each.errors
        errors = f"{start_mm:6.2f} {start_deg:4.1f}  {median_mm:6.2f} {median_deg:6.2f} {worst_mm:6.2f}"
    return (
        f"{each.scene:5}  {'yes' if each.grasped else 'NO':7}  {each.cube:4}  {each.attempts:8}  {each.lift_mm:8.1f}"
        f"  {each.held_s:7.2f}  {errors}  {each.frames:6}  {each.wall_s:6.1f}  {each.digest[:12]}"
    )


HEAD = (
    "                                           start         later\n"
    "scene  grasped  cube  attempts  lift, mm  held, s      mm    °      mm      °  worst  frames  wall, s  digest"
)


def as_dict(each: Episode) -> dict[str, Any]:
    """An episode as JSON has it."""
    return {**each._asdict(), "errors": None if each.errors is None else each.errors._asdict()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all scenes, and print the table.

    Returns:
        The exit code: 1 where more than one scene in twenty has failed.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=SCENES, metavar="A:B", help=f"from A to B - 1 (default: {SCENES})")
    parser.add_argument("--launch", action="store_true", help="each node a process, in place of all in one")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="of the deployment")
    parser.add_argument("--format", choices=("text", "json"), default="text", help="how the figures are printed")
    options = parser.parse_args(arguments)
    first, _, last = options.scenes.partition(":")
    if not (first.isdigit() and last.isdigit() and int(first) < int(last)):
        parser.error(f"--scenes: expected A:B with A < B, got {options.scenes!r}")
    episodes = []
    if options.format == "text":
        print(HEAD)
    for scene in range(int(first), int(last)):
        episodes.append(episode(scene, "launch" if options.launch else "run", options.set))
        if options.format == "text":
            print(line(episodes[-1]), flush=True)
    grasped = sum(each.grasped for each in episodes)
    if options.format == "json":
        print(json.dumps([as_dict(each) for each in episodes], indent=2))
    else:
        print(
            f"{grasped} of {len(episodes)} grasped, {sum(each.attempts == 1 for each in episodes)} at the first attempt"
        )
    return 0 if 20 * (len(episodes) - grasped) <= len(episodes) else 1


if __name__ == "__main__":
    sys.exit(main())
