"""Scenes of the tower deployment for the benchmarks: what is set in one, who interferes, what it takes at least."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from commands import reported

from hierax.nodes.picking.layout import planned
from hierax.nodes.tower.goals import Towers, read_towers
from hierax.nodes.tower.interferences import ACTS
from hierax.nodes.tower.planner import planned as shortest_plan
from hierax.nodes.tower.world import NONE
from hierax.nodes.tracking.schema import TABLE
from hierax.runtime.deployment.tree import read_tree

DEFAULTS = {"cubes": "4", "tower": "[1, 3, 4, 2]", "person": NONE, "pictures": "100000"}
RANDOM, THREE = "random", 3
EARLY = "swap"  # takes two cubes that are in no tower yet, so of several it comes first
_BUILDER, _SKILLS, _SPATIAL = (
    f"edges.{edge}.context" for edge in ("skills -> builder", "spatial -> skills", "arm -> spatial")
)
_ALONE = "{function: hierax.nodes.tracking.render:SegmentedDepth, parameters: {occlusion: false}}"
CONTEXTS = {
    "skills": {_SKILLS: "null", _BUILDER: "null"},
    "builder": {_BUILDER: "null"},
    "spatial": {_SPATIAL: "null"},
    "others": {_SPATIAL: _ALONE},
}
"""What is set where a context is left out: by the node that it comes from, and those above it; or ``others``: each cube
is expected to be seen as if it were alone."""


def scenes_of(said: str, parser: argparse.ArgumentParser, option: str = "--scenes") -> range:
    """The scenes that an option says. Ends the program where there are none."""
    first, _, above = said.partition(":")
    try:
        scenes = range(int(first), int(above))
    except ValueError:
        scenes = range(0)
    if not scenes:
        parser.error(f"{option} {said}: expected the first scene and one above the last, such as 0:20")
    return scenes


def given_of(options: argparse.Namespace, parser: argparse.ArgumentParser, own: Sequence[str]) -> dict[str, str]:
    """What each ``--set PATH=VALUE`` says. Ends the program where one says nothing, or what has an ``own`` option."""
    given: dict[str, str] = {}
    for each in options.set:
        path, equals, value = each.partition("=")
        if not equals or path in own:
            parser.error(f"--set {each}: expected PATH=VALUE, and for {', '.join(own)} the option of that name")
        given[path] = value
    return given


def settings(given: Mapping[str, str], scene: int, without: str | None = None) -> dict[str, str]:
    """What is set in a scene, PATH: VALUE; of what is not given there are `DEFAULTS`."""
    all_given = {**DEFAULTS, **given, **CONTEXTS.get(without or "", {})}
    acts = interferences(all_given["person"], scene)
    return {**all_given, "person": json.dumps(acts[0] if len(acts) == 1 else acts), "scene": str(scene)}


def words(set_to: Mapping[str, str]) -> list[str]:
    """The arguments of a command that has the scene, with its number as seed."""
    each = (word for path, value in set_to.items() for word in ("--set", f"{path}={value}"))
    return ["tower", "--seed", set_to["scene"], *each]


def interferences(person: str, scene: int) -> list[str]:
    """What somebody does: one, several separated by '+', or `RANDOM`, three that the scene's number draws."""
    if person != RANDOM:
        return person.split("+")
    drawn = np.random.default_rng([scene, THREE]).choice(list(ACTS), THREE, replace=False)
    return sorted((str(name) for name in drawn), key=lambda name: name != EARLY)


def asked_of(set_to: Mapping[str, str]) -> int:
    """How many interferences are asked of somebody."""
    person = json.loads(set_to["person"])
    return len(person) if isinstance(person, list) else int(person != NONE)


def episode(command: str, set_to: Mapping[str, str]) -> dict[str, Any]:
    """The report of a scene to its end, by a command, run or launch; ends the program where that fails."""
    return reported(f"scene {set_to['scene']}", command, *words(set_to))


def towers_of(set_to: Mapping[str, str]) -> Towers:
    """The towers that are asked for."""
    return read_towers(read_tree(set_to["tower"], "tower").value, _cubes(set_to))


def _cubes(set_to: Mapping[str, str]) -> int:
    cubes = read_tree(set_to["cubes"], "cubes").value
    if type(cubes) is not int:
        raise ValueError(f"cubes is {cubes!r}; expected a whole number")
    return cubes


def least_moves(set_to: Mapping[str, str]) -> int:
    """How many moves the shortest plan has from how a scene is laid out, which all succeed while nobody interferes.
    Raises ValueError: what plans is not there, or the towers cannot be built."""
    blocks = {place.id: place.below or TABLE for place in planned(int(set_to["scene"]), _cubes(set_to))}
    plan = shortest_plan(towers_of(set_to), blocks)
    if plan is None:
        raise ValueError(f"no plan builds {set_to['tower']} of {blocks}")
    return len(plan)
