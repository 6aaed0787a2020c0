"""How often the arm of the tower deployment builds what is asked for: scene by scene, also while somebody interferes.

    python benchmarks/tower.py                              # scenes 0 to 19, a tower of four cubes; half an hour
    python benchmarks/tower.py --scenes 3:5 --launch
    python benchmarks/tower.py --builder reactive,planner --jobs 2
    python benchmarks/tower.py --person knock,take          # a cell of 20 scenes each; knock+take: both in each scene
    python benchmarks/tower.py --person every --launched 3:8  # all eight, a cell each, these scenes of it launched, too
    python benchmarks/tower.py --person random              # three drawn for each scene, one after the other
    python benchmarks/tower.py --without skills             # no context from the builder and the skills node
    python benchmarks/tower.py --set cubes=6 --set tower='[[3, 1, 4], [2, 5, 6]]'
    python benchmarks/tower.py --person every --keep rows.jsonl   # goes on where it was ended

Each scene is an own layout with own errors of the start, and is run with its number as the run's seed, too. Beside what
the world says by the truth stands how many moves the shortest plan has, from how the scene is laid out, if nobody
interferes (which takes `hierax[plan]`). A scene is done when all towers stand at the end. Where that is so, but not all
that was asked of somebody has happened, as when no two cubes could be swapped, another scene is run in its place, above
all others. Exit code 1 where fewer were done than --least has it, or a launch has another digest than the run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tower_kept
from tower_scenes import CONTEXTS, RANDOM, asked_of, episode, given_of, least_moves, scenes_of, settings, towers_of

from hierax.nodes.tower.builder import REACTIVE
from hierax.nodes.tower.interferences import ACTS
from hierax.nodes.tower.world import NONE

EVERY = "every"
RUN, LAUNCH = "run", "launch"
HEADS = (
    ("scene", 5),
    ("done", 5),
    ("placed, mm", 11),
    ("actions", 7),
    ("moves", 6),
    ("least", 6),
    ("acts", 5),
    ("frames", 7),
)
OWN = ("builder", "person", "scene")  # what has an option of its own


@dataclass(frozen=True)
class Row:
    """What a scene came to.

    Attributes:
        set_to: what was set in it.
        command: by which command.
        done: whether all towers stood at its end.
        placed_mm: how far the middle of a cube is beside that of the one below at most.
        actions: how many times the hand has raised a cube.
        moves: how many moves of the hand began.
        acts: in how many interferences a cube was gripped or moved.
        frames: how long it took.
        wall_s: likewise, by the clock.
        digest: of the run.
    """

    set_to: dict[str, str]
    command: str
    done: bool
    placed_mm: float
    actions: int
    moves: int
    acts: int
    frames: int
    wall_s: float
    digest: str

    def told(self) -> str:
        """A line of the table."""
        row = f"{self.set_to['scene']:>5} {'yes' if self.done else 'NO':>5} {self.placed_mm:11.1f}"
        counts = f"{self.actions:7} {self.moves:6} {least_moves(self.set_to):6} {self.acts:5}"
        rate = f"{self.frames:7} {self.frames / self.wall_s:9.1f}  {self.digest[:16]}"
        return f"{row} {counts} {rate} {self.set_to['person']}"

    @property
    def is_spared(self) -> bool:
        """Whether the towers stand though not all that was asked of somebody has happened."""
        return self.done and self.acts < asked_of(self.set_to)


class Kept(tower_kept.Kept[Row]):
    """Rows by command and by what is set, as they are kept, or made."""

    def __init__(self, path: Path | None) -> None:
        super().__init__(path, Row, lambda row: _key(row.command, row.set_to))

    def of(self, command: str, set_to: dict[str, str]) -> Row:
        """What a scene came to."""
        return self.row(_key(command, set_to), lambda: _row(command, set_to))


def _key(command: str, set_to: dict[str, str]) -> str:
    return json.dumps([command, set_to], sort_keys=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the cells, print the tables."""
    options, given, scenes = _read(arguments)
    try:
        least_moves(settings(given, scenes.start))
    except ValueError as error:  # before minutes of work, for a column of the table
        raise SystemExit(str(error)) from error
    persons = [each for person in options.person.split(",") for each in (ACTS if person == EVERY else (person,))]
    kept, good = Kept(options.keep), True
    for builder in options.builder.split(","):
        for person in persons:
            print(f"\nbuilder {builder}, person {person}")
            cell = {**given, "builder": builder, "person": person}
            good &= _cell(cell, scenes, kept, options)
    return int(not good)


def _read(arguments: list[str] | None) -> tuple[argparse.Namespace, dict[str, str], range]:
    """The options, what is set, and which scenes are run."""
    how = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=how, allow_abbrev=False)
    parser.add_argument("--scenes", default="0:20", help="from one to below another one")
    parser.add_argument("--launch", action="store_true", help="each node in a process of its own")
    parser.add_argument("--launched", help="from one to below another one of a cell's scenes, launched after it, too")
    parser.add_argument("--jobs", type=int, default=1, help="so many scenes at a time; those launched too, one by one")
    parser.add_argument("--builder", default=REACTIVE, help="one, or several separated by commas")
    parser.add_argument("--person", default=NONE, help=f"likewise: {NONE}, {', '.join(ACTS)}, {EVERY}, {RANDOM}")
    parser.add_argument("--without", choices=sorted(CONTEXTS), help="no context from there; others: each as if alone")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="as hierax run has it")
    parser.add_argument("--least", type=int, help="so many scenes of a cell have to be done; if not given, all")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="add rows to it, and take those that are there")
    options = parser.parse_args(arguments)
    scenes = scenes_of(options.scenes, parser)
    if options.jobs < 1:
        parser.error("--jobs: expected 1 or more")
    if options.launch and options.launched:
        parser.error("--launched compares launches with runs; --launch makes no runs")
    options.launched = scenes_of(options.launched, parser, "--launched") if options.launched is not None else range(0)
    return options, given_of(options, parser, OWN), scenes


def _cell(cell: dict[str, str], scenes: range, kept: Kept, options: argparse.Namespace) -> bool:
    """Run the scenes of one cell, print a row of each and what they come to; whether all is as it should be."""
    print(*(f"{head:>{width}}" for head, width in (*HEADS, ("epochs/s", 9))), " digest", " person", flush=True)
    rows: list[Row] = []
    spared: list[Row] = []
    following = scenes
    while following:
        found = list(_rows(cell, following, kept, options))
        rows += (row for row in found if not row.is_spared)
        spared += (row for row in found if row.is_spared)
        missing = len(scenes) - len(rows) if len(spared) <= len(scenes) else 0
        following = range(following.stop, following.stop + missing)
    print(_summed_up(rows, spared), flush=True)
    alike = [_is_launched_alike(row, kept) for row in rows + spared if int(row.set_to["scene"]) in options.launched]
    least = len(scenes) if options.least is None else options.least
    return all(alike) and sum(row.done for row in rows) >= least


def _rows(cell: dict[str, str], scenes: range, kept: Kept, options: argparse.Namespace) -> Iterator[Row]:
    """What some scenes of a cell came to; a row of each is printed."""
    each = [settings(cell, scene, options.without) for scene in scenes]
    with ThreadPoolExecutor(options.jobs) as pool:
        for row in pool.map(lambda set_to: kept.of(LAUNCH if options.launch else RUN, set_to), each):
            print(row.told(), flush=True)
            yield row


def _is_launched_alike(run: Row, kept: Kept) -> bool:
    launched = kept.of(LAUNCH, run.set_to)
    alike = launched.digest == run.digest
    print(launched.told(), "launched,", "equal" if alike else "OTHER DIGEST", flush=True)
    return alike


def _summed_up(rows: list[Row], spared: list[Row]) -> str:
    done = [row for row in rows if row.done]
    told = [f"{len(done)} of {len(rows)} done"]
    if spared:
        told.append(f"not counted: {', '.join(row.set_to['scene'] for row in spared)}, where not all happened")
    if done:
        more = statistics.mean(row.moves - least_moves(row.set_to) for row in done)
        told.append(f"at most {max(row.placed_mm for row in done):.1f} mm from the middle of the cube below")
        told.append(f"{more:.2f} moves more than the least in the mean")
        told.append(f"{statistics.median(row.frames for row in done):.0f} frames")
    return "; ".join(told)


def _row(command: str, set_to: dict[str, str]) -> Row:
    said: dict[str, Any] = episode(command, set_to)
    world, skills = (said["nodes"][name]["metrics"] for name in ("world", "skills"))
    done, acts = world["towers_done"] == len(towers_of(set_to)), int(world["interferences"])
    counted = {name: int(number) for name, number in (("actions", world["actions"]), ("moves", skills["moves"]))}
    counted |= {"acts": acts, "frames": said["epochs"], "wall_s": said["wall_s"]}
    return Row(set_to, command, done, world["placed_mm_max"], digest=said["digest"], **counted)


if __name__ == "__main__":
    sys.exit(main())
