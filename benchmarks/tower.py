"""How often the arm of the tower deployment builds what is asked for: scene by scene.

    python benchmarks/tower.py                              # scenes 0 to 19, a tower of all cubes; half an hour
    python benchmarks/tower.py --scenes 3:5 --launch
    python benchmarks/tower.py --set tower='[[3, 1], [4, 2]]'

Each scene is an own layout with own errors of the start, and is run with its number as the run's seed, too. Beside what
the world says by the truth stands how many moves the builder's rules take at least, from how the scene is laid out.
Exit code 1 where a tower was not done.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from typing import Any

import yaml

from hierax.nodes.picking.layout import planned
from hierax.nodes.tower.goals import read_towers
from hierax.nodes.tower.rules import TABLE, wish_of
from hierax.nodes.tower.symbols import Symbols

HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
CUBES, TOWER = 4, "[1, 3, 4, 2]"
PLACED_MM = 8.0


def main() -> int:
    """Run the scenes, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:20", help="from one to below another one")
    parser.add_argument("--launch", action="store_true", help="each node in a process of its own")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="as hierax run has it")
    options = parser.parse_args()
    first, last = map(int, options.scenes.split(":"))
    given = {"cubes": str(CUBES), "tower": TOWER, **dict(each.split("=", 1) for each in options.set)}
    settings = [word for path, value in given.items() for word in ("--set", f"{path}={value}")]
    cubes, tower = yaml.safe_load(given["cubes"]), yaml.safe_load(given["tower"])
    heads = ("scene", 5), ("done", 5), ("placed, mm", 11), ("moves", 6), ("least", 6), ("frames", 7), ("epochs/s", 9)
    print(*(f"{head:>{width}}" for head, width in heads), " digest")
    failed, placed_mm, more = 0, [], []
    for scene in range(first, last):
        said = episode(scene, "launch" if options.launch else "run", settings)
        world = said["nodes"]["world"]["metrics"]
        moves, least = int(said["nodes"]["skills"]["metrics"]["moves"]), least_moves(scene, cubes, tower)
        done = world["towers_done"] == len(read_towers(tower, cubes))
        rate = said["epochs"] / said["wall_s"]
        row = f"{scene:5} {'yes' if done else 'NO':>5} {world['placed_mm_max']:11.1f} {moves:6} {least:6}"
        print(f"{row} {said['epochs']:7} {rate:9.1f}  {said['digest'][:16]}", flush=True)
        failed += not done
        if done:
            placed_mm.append(world["placed_mm_max"])
            more.append(moves - least)
    count = last - first
    print(f"{count - failed} of {count} done", end="")
    if placed_mm:
        near = f"at most {max(placed_mm):.1f} mm from the middle of the cube below"
        print(f"; {near}; {statistics.mean(more):.1f} moves more than the least in the mean", end="")
    print()
    return int(failed > 0)


def episode(scene: int, command: str, settings: list[str]) -> dict[str, Any]:
    """What one scene comes to, as the command tells it."""
    words = [command, "tower", "--set", f"scene={scene}", "--seed", str(scene), *settings, "--format", "json"]
    done = subprocess.run([*HIERAX, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"scene {scene}: {done.stderr.strip()}")
    return dict(json.loads(done.stdout))


def least_moves(scene: int, cubes: int, tower: Any) -> int:
    """How many moves the rules take from how a scene is laid out, if each succeeds."""
    blocks = {place.id: place.below for place in planned(scene, cubes)}
    towers, moves = read_towers(tower, cubes), 0
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
