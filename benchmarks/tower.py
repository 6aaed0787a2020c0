"""How often the arm of the tower deployment builds what is asked for: scene by scene, also while somebody interferes.

    python benchmarks/tower.py                              # scenes 0 to 19, a tower of four cubes; half an hour
    python benchmarks/tower.py --scenes 3:5 --launch
    python benchmarks/tower.py --builder reactive,planner
    python benchmarks/tower.py --person knock,take          # a cell of 20 scenes each
    python benchmarks/tower.py --person every               # all eight, one cell each
    python benchmarks/tower.py --person random              # three drawn for each scene, one after the other
    python benchmarks/tower.py --without skills             # no context from the builder and the skills node
    python benchmarks/tower.py --set cubes=6 --set tower='[[3, 1, 4], [2, 5, 6]]'

Each scene is an own layout with own errors of the start, and is run with its number as the run's seed, too. Beside what
the world says by the truth stands how many moves the builder's rules take at least, from how the scene is laid out, if
nobody interferes. A scene is done when all towers stand at the end. Exit code 1 where one was not.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import planned
from hierax.nodes.tower.builder import REACTIVE
from hierax.nodes.tower.goals import Towers, read_towers
from hierax.nodes.tower.interferences import ACTS
from hierax.nodes.tower.rules import TABLE, wish_of
from hierax.nodes.tower.symbols import Symbols
from hierax.nodes.tower.world import NONE
from hierax.runtime.deployment.tree import read_tree

HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
CUBES, TOWER = 4, "[1, 3, 4, 2]"
EVERY, RANDOM, THREE = "every", "random", 3
CONTEXTS = {
    "skills": ("edges.spatial -> skills.context", "edges.skills -> builder.context"),
    "builder": ("edges.skills -> builder.context",),
    "spatial": ("edges.arm -> spatial.context",),
}
"""By the node without whose context it is tried, and those above it: what is left out of the deployment."""


def main() -> int:
    """Run the cells, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:20", help="from one to below another one")
    parser.add_argument("--launch", action="store_true", help="each node in a process of its own")
    parser.add_argument("--builder", default=REACTIVE, help="one, or several separated by commas")
    parser.add_argument("--person", default=NONE, help=f"likewise: {NONE}, {', '.join(ACTS)}, every, random")
    parser.add_argument("--without", choices=sorted(CONTEXTS), help="no context from there down")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="as hierax run has it")
    options = parser.parse_args()
    scenes = range(*map(int, options.scenes.split(":")))
    given = {"cubes": str(CUBES), "tower": TOWER, "pictures": "100000"}
    given |= dict(each.split("=", 1) for each in options.set)
    given |= dict.fromkeys(CONTEXTS.get(options.without, ()), "null")
    persons = list(ACTS) if options.person == EVERY else options.person.split(",")
    failed = 0
    for builder in options.builder.split(","):
        for person in persons:
            failed += cell(scenes, "launch" if options.launch else "run", {**given, "builder": builder}, person)
    return int(failed > 0)


def cell(scenes: range, command: str, given: dict[str, str], person: str) -> int:
    """Run the scenes of one cell, and print a row of each and what they come to; how many were not done."""
    print(f"\nbuilder {given['builder']}, person {person}")
    heads = ("scene", 5), ("done", 5), ("placed, mm", 11), ("moves", 6), ("least", 6), ("acts", 5), ("frames", 7)
    print(*(f"{head:>{width}}" for head, width in (*heads, ("epochs/s", 9))), " digest", flush=True)
    cubes, tower = (read_tree(given[name], name).value for name in ("cubes", "tower"))
    towers = read_towers(tower, cubes)
    failed, placed_mm, more, frames = 0, [], [], []
    for scene in scenes:
        acts = drawn(scene) if person == RANDOM else [person]
        said = episode(scene, command, {**given, "person": json.dumps(acts)})
        world = said["nodes"]["world"]["metrics"]
        moves, least = int(said["nodes"]["skills"]["metrics"]["moves"]), least_moves(scene, cubes, towers)
        done = world["towers_done"] == len(towers)
        row = f"{scene:5} {'yes' if done else 'NO':>5} {world['placed_mm_max']:11.1f} {moves:6} {least:6}"
        rate = f"{int(world['interferences']):5} {said['epochs']:7} {said['epochs'] / said['wall_s']:9.1f}"
        print(f"{row} {rate}  {said['digest'][:16]} {' '.join(acts) if person == RANDOM else ''}", flush=True)
        failed += not done
        if done:
            placed_mm.append(world["placed_mm_max"])
            more.append(moves - least)
            frames.append(said["epochs"])
    print(f"{len(scenes) - failed} of {len(scenes)} done", end="")
    if placed_mm:
        near = f"at most {max(placed_mm):.1f} mm from the middle of the cube below"
        mean = f"{statistics.mean(more):.1f} moves more than the least in the mean"
        print(f"; {near}; {mean}; {statistics.median(frames):.0f} frames", end="")
    print(flush=True)
    return failed


def drawn(scene: int) -> list[str]:
    """Three interferences of a scene, drawn by its number."""
    return [str(name) for name in np.random.default_rng([scene, THREE]).choice(list(ACTS), THREE, replace=False)]


def episode(scene: int, command: str, given: dict[str, str]) -> dict[str, Any]:
    """What one scene comes to, as the command tells it."""
    settings = [word for path, value in given.items() for word in ("--set", f"{path}={value}")]
    words = [command, "tower", "--set", f"scene={scene}", "--seed", str(scene), *settings, "--format", "json"]
    done = subprocess.run([*HIERAX, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"scene {scene}: {done.stderr.strip()}")
    return dict(json.loads(done.stdout))


def least_moves(scene: int, cubes: int, towers: Towers) -> int:
    """How many moves the rules take from how a scene is laid out, if each succeeds."""
    blocks = {place.id: place.below for place in planned(scene, cubes)}
    moves = 0
    while True:
        on = tuple(sorted((upper, lower) for upper, lower in blocks.items() if lower != TABLE))
        table = tuple(sorted(cube for cube, lower in blocks.items() if lower == TABLE))
        wish = wish_of(towers, Symbols(on, table, (), None, {}))
        if wish.cube is None:
            return moves
        blocks[wish.cube] = wish.onto
        moves += 1


if __name__ == "__main__":
    sys.exit(main())
