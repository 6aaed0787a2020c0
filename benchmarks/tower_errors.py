"""How far from the truth the tower's cubes are believed to be as one is put down, and while a tower falls over.

    python benchmarks/tower_errors.py                                  # scenes 0 to 4, somebody knocks; ten minutes
    python benchmarks/tower_errors.py --without skills                 # no context from the builder and the skills node
    python benchmarks/tower_errors.py --scenes 0:20 --person take --jobs 2
    python benchmarks/tower_errors.py --set frames=1600                # and what else hierax run sets
    python benchmarks/tower_errors.py --keep errors.jsonl              # goes on where it was ended

By `hierax.run`, epoch by epoch. Told are, in millimetres, how far the middles of cubes are believed from where they
truly are: of the cube that is let go and the one below, in the epoch in which the fingers open; of all cubes, in epochs
in which one that is not near the hand goes faster than 5 cm/s, and in the second after; and in all others. A cube that
is lost is counted, and has no error. Exit code 1 where fewer scenes were done than --least has it.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from tower_kept import Kept
from tower_scenes import CONTEXTS, given_of, scenes_of, settings, towers_of

import hierax
from hierax.nodes.tower.moving import OPEN
from hierax.nodes.tracking.schema import LOST

PLACING, FALLING, ELSE = "put down", "falling, and a second after", "all other epochs"
FAST_M_S = 0.05
AFTER_EPOCHS = 20
NEAR_HAND_M = 0.06
OWN = ("person", "scene")  # what has an option of its own


@dataclass
class Errors:
    """By occasion, how far cubes were believed from where they were, and how often they were lost.

    Attributes:
        tenths: how often the error was so many tenths of a millimetre, as text, which is what JSON has for keys.
        lost: of how many cubes there is none.
    """

    tenths: dict[str, dict[str, int]] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)

    def add(self, occasion: str, truth: Mapping[str, Any], believed: Mapping[str, Any]) -> None:
        """One more cube in an epoch."""
        if believed["status"] == LOST:
            self.lost[occasion] = self.lost.get(occasion, 0) + 1
            return
        apart_m = float(np.linalg.norm(truth["pose"][:3, 3] - believed["pose"][:3, 3]))
        tenths, tenth = self.tenths.setdefault(occasion, {}), str(round(10_000.0 * apart_m))
        tenths[tenth] = tenths.get(tenth, 0) + 1

    def told(self) -> str:
        """A line for each occasion."""
        return "\n".join(map(self._told, (PLACING, FALLING, ELSE)))

    def _told(self, occasion: str) -> str:
        counts, lost = self.tenths.get(occasion, {}), self.lost.get(occasion, 0)
        if not counts:
            return f"  {occasion:29} none seen, {lost} lost"
        found = np.repeat([int(tenth) / 10.0 for tenth in counts], list(counts.values()))
        half, most = np.quantile(found, (0.5, 0.95))
        all_cubes = lost + len(found)
        share = 100.0 * lost / all_cubes
        return f"  {occasion:29} {half:7.1f} {most:7.1f} {max(found):8.1f} {share:6.1f} %  of {all_cubes}"


@dataclass(frozen=True)
class Outcome:
    """What was set in a scene, whether its tower stood at its end, after how many epochs that was, and the errors on
    the way, as `Errors` has them."""

    set_to: dict[str, str]
    done: bool
    epochs: int
    tenths: dict[str, dict[str, int]]
    lost: dict[str, int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the scenes, print the table; 1 where too few were done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:5", help="from one to below another one")
    parser.add_argument("--person", default="knock", help="what somebody does")
    parser.add_argument("--without", choices=sorted(CONTEXTS), help="no context from there; others: each as if alone")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="as hierax run has it")
    parser.add_argument("--jobs", type=int, default=1, help="so many scenes at a time")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="add rows to it, and take those that are there")
    parser.add_argument("--least", type=int, help="so many scenes have to be done; if not given, all")
    options = parser.parse_args(arguments)
    if options.jobs < 1:
        parser.error("--jobs: expected 1 or more")
    scenes, given = scenes_of(options.scenes, parser), given_of(options, parser, OWN)
    each = [settings({**given, "person": options.person}, scene, options.without) for scene in scenes]
    kept = Kept(options.keep, Outcome, lambda outcome: _key(outcome.set_to))
    spawn = get_context("spawn")  # each scene begins in a process that knows nothing of another one
    with (
        ProcessPoolExecutor(options.jobs, mp_context=spawn, max_tasks_per_child=1) as processes,
        ThreadPoolExecutor(options.jobs) as threads,
    ):

        def outcome(set_to: dict[str, str]) -> Outcome:
            return kept.row(_key(set_to), lambda: processes.submit(episode, set_to).result())

        outcomes = list(threads.map(outcome, each))
    without = "" if options.without is None else f", --without {options.without}"
    print(f"somebody does {options.person}{without}: {told(outcomes)}")
    print(f"  {'mm':29} {'median':>7} {'95 %':>7} {'worst':>8} {'lost':>8}")
    print(merged(outcomes).told())
    return int(sum(outcome.done for outcome in outcomes) < (len(scenes) if options.least is None else options.least))


def told(outcomes: Sequence[Outcome]) -> str:
    """How many scenes were done, and how many epochs those took in the middle."""
    took = [outcome.epochs for outcome in outcomes if outcome.done]
    middle = f", {statistics.median(took):.0f} epochs in the middle" if took else ""
    return f"{len(took)} of {len(outcomes)} scenes done{middle}"


def merged(outcomes: Sequence[Outcome]) -> Errors:
    """The errors of all scenes."""
    tenths: defaultdict[str, Counter[str]] = defaultdict(Counter)
    lost: Counter[str] = Counter()
    for outcome in outcomes:
        lost.update(outcome.lost)
        for occasion, counts in outcome.tenths.items():
            tenths[occasion].update(counts)
    return Errors({occasion: dict(counts) for occasion, counts in tenths.items()}, dict(lost))


def _key(set_to: Mapping[str, str]) -> str:
    return json.dumps(set_to, sort_keys=True)


def episode(set_to: dict[str, str]) -> Outcome:
    """Run a scene to its end."""
    errors, phase, falling = Errors(), "", 0
    with hierax.run(
        "tower", seed=int(set_to["scene"]), settings=[f"{path}={value}" for path, value in set_to.items()]
    ) as run:
        for _ in run:
            world, skills = run.belief("world"), run.belief("skills")
            believed = {body["id"]: body for body in run.belief("spatial")["bodies"]}
            begun = skills["phase"] == OPEN != phase
            phase = skills["phase"]
            falling = AFTER_EPOCHS if _falls(world) else falling - 1
            moved = skills["goal"] if begun and skills["goal"] else ()
            for body in world["bodies"]:
                if body["id"] in moved:
                    errors.add(PLACING, body, believed[body["id"]])
                errors.add(FALLING if falling > 0 else ELSE, body, believed[body["id"]])
        report = run.report()
        done = bool(report.nodes["world"].metrics["towers_done"] == len(towers_of(set_to)))
        return Outcome(set_to, done, report.epochs, errors.tenths, errors.lost)


def _falls(world: Mapping[str, Any]) -> bool:
    """Whether a cube goes fast that is not in the hand."""
    hand = world["setpoint"][:3, 3]
    return any(
        np.linalg.norm(body["velocity"][:3]) > FAST_M_S and np.linalg.norm(body["pose"][:3, 3] - hand) > NEAR_HAND_M
        for body in world["bodies"]
    )


if __name__ == "__main__":
    raise SystemExit(main())
