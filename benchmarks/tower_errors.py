"""How far from the truth the tower's cubes are believed to be as one is put down, and while a tower falls over.

    python benchmarks/tower_errors.py                                  # scenes 0 to 4, somebody knocks; ten minutes
    python benchmarks/tower_errors.py --without skills                 # no context from the builder and the skills node
    python benchmarks/tower_errors.py --scenes 0:20 --person take

In this process, epoch by epoch. Told are, in millimetres, how far the middles of cubes are believed from where they
truly are: of the cube that is let go and the one below, in the epoch in which the fingers open; of all cubes, in epochs
in which one that is not near the hand goes faster than 5 cm/s, and in the second after; and in all others. A cube that
is lost is counted, and has no error.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from tower_scenes import CONTEXTS, settings

import hierax
from hierax.nodes.tower.moving import OPEN
from hierax.nodes.tracking.schema import LOST

PLACING, FALLING, ELSE = "put down", "falling, and a second after", "all other epochs"
FAST_M_S = 0.05
AFTER_EPOCHS = 20
NEAR_HAND_M = 0.06


@dataclass
class Errors:
    """By occasion, errors in millimetres, and how often a cube was lost.

    Attributes:
        mm: the errors.
        lost: of how many cubes there is none.
    """

    mm: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    lost: defaultdict[str, int] = field(default_factory=lambda: defaultdict(int))

    def add(self, occasion: str, truth: Mapping[str, Any], believed: Mapping[str, Any]) -> None:
        """One more cube in an epoch."""
        if believed["status"] == LOST:
            self.lost[occasion] += 1
        else:
            apart = truth["pose"][:3, 3] - believed["pose"][:3, 3]
            self.mm[occasion].append(1000.0 * float(np.linalg.norm(apart)))

    def told(self) -> str:
        """A line for each occasion."""
        lines = []
        for occasion in (PLACING, FALLING, ELSE):
            found, lost = self.mm[occasion], self.lost[occasion]
            if not found:
                lines.append(f"  {occasion:29} none seen, {lost} lost")
                continue
            half, most = np.quantile(found, (0.5, 0.95))
            share = 100.0 * lost / (lost + len(found))
            lines.append(
                f"  {occasion:29} {half:7.1f} {most:7.1f} {max(found):8.1f} {share:6.1f} %  of {lost + len(found)}"
            )
        return "\n".join(lines)


def main() -> int:
    """Run the scenes, print the table; 1 where a scene was not done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="0:5", help="from one to below another one")
    parser.add_argument("--person", default="knock", help="what somebody does")
    parser.add_argument("--without", choices=sorted(CONTEXTS), help="no context from there; others: each as if alone")
    options = parser.parse_args()
    errors, done = Errors(), 0
    scenes = range(*map(int, options.scenes.split(":")))
    for scene in scenes:
        done += episode(scene, settings({"person": options.person}, scene, options.without), errors)
    without = "" if options.without is None else f", --without {options.without}"
    print(f"somebody does {options.person}{without}: {done} of {len(scenes)} scenes done")
    print(f"  {'mm':29} {'median':>7} {'95 %':>7} {'worst':>8} {'lost':>8}")
    print(errors.told())
    return int(done < len(scenes))


def episode(scene: int, set_to: Mapping[str, str], errors: Errors) -> bool:
    """Run a scene to its end; whether its tower stands then."""
    phase, falling = "", 0
    with hierax.run("tower", seed=scene, settings=[f"{path}={value}" for path, value in set_to.items()]) as run:
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
        return bool(run.report().nodes["world"].metrics["towers_done"] == 1)


def _falls(world: Mapping[str, Any]) -> bool:
    """Whether a cube goes fast that is not in the hand."""
    hand = world["setpoint"][:3, 3]
    return any(
        np.linalg.norm(body["velocity"][:3]) > FAST_M_S and np.linalg.norm(body["pose"][:3, 3] - hand) > NEAR_HAND_M
        for body in world["bodies"]
    )


if __name__ == "__main__":
    raise SystemExit(main())
