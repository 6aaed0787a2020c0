"""Hierarchies that `changes.py` changes, and random changes that they bear."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from hierax.runtime.deployment.deployment import shipped
from hierax.runtime.owner.roster_changes import ChangeError, next_roster
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge

MIXING = "hierax.runtime.sim.nodes"
LETTERS = "hierax.nodes.letters"
SERVO = "hierax.nodes.servo"
RANDOM_NODES = 12
KINDS = ("attach", "detach", "replace")


@dataclass(frozen=True)
class Subject:
    """A hierarchy, and what may become of it.

    Attributes:
        name: of `HIERARCHIES`.
        plain: its deployment file.
        extra: what may be attached to it beside its own nodes, given a random generator and the roster.
        other: what may replace a node, given a random generator and what it is.
    """

    name: str
    plain: dict[str, Any]
    extra: Callable[[random.Random, Roster], Attach]
    other: Callable[[random.Random, Reference], Reference]


def subject(name: str, seed: int) -> Subject:
    """The hierarchy of a name."""
    if name == "random":
        return Subject(name, random_deployment(random.Random(seed)), mixing_extra, mixing_other)
    plain = yaml.safe_load(shipped()[name].read_text(encoding="utf-8"))
    if name == "letters":
        return Subject(name, plain, another_word, another_vocabulary)
    return Subject(name, plain, another_motion, lambda rng, reference: reference)


def another_word(rng: random.Random, roster: Roster) -> Attach:
    """A further word node over some of the letters, which tells them what it expects or does not."""
    name = rng.choice(("word2", "word3", "word4"))
    letters = [letter for letter in (1, 2, 3) if f"letter{letter}" in roster.nodes]
    words = roster.nodes[roster.world].parameters["words"]
    edges = []
    for letter in rng.sample(letters, rng.randint(1, len(letters))) if letters else ():
        parameters = {"words": words, "letter": letter}
        context = Reference(f"{LETTERS}:WordSupport", parameters) if rng.random() < 0.5 else None
        sense = Reference(f"{LETTERS}:LetterEvidence", parameters)
        edges.append(RosterEdge(f"letter{letter}", name, sense, None, context))
    return Attach({name: Reference(f"{LETTERS}:WordNode", {"words": words})}, tuple(edges))


def another_vocabulary(rng: random.Random, reference: Reference) -> Reference:
    """A word node with other priors; letter nodes stay what they are."""
    if not reference.target.endswith(":WordNode"):
        return reference
    priors = (round(rng.uniform(0.1, 0.9), 3), round(rng.uniform(0.1, 0.9), 3))
    return Reference(reference.target, {**reference.parameters, "priors": priors})


def another_motion(rng: random.Random, roster: Roster) -> Attach:
    """A second motion node, or a second camera node above the world."""
    seen = Reference(f"{SERVO}:position")
    if rng.random() < 0.5:
        edge = RosterEdge("camera", "motion2", seen, None, seen if rng.random() < 0.5 else None)
        return Attach({"motion2": Reference(f"{SERVO}:MotionNode")}, (edge,))
    measured = Reference(f"{SERVO}:MeasuredPosition", {"noise": round(rng.uniform(0.05, 0.2), 3)})
    return Attach({"camera2": Reference(f"{SERVO}:CameraNode")}, (RosterEdge("world", "camera2", measured),))


def random_deployment(rng: random.Random) -> dict[str, Any]:
    """Nodes whose every result depends on every input and on random numbers."""
    names = ["world", *(f"n{number:02}" for number in range(1, RANDOM_NODES))]
    roster = Roster("world", {"world": Reference(f"{MIXING}:MixingWorld", {"name": "world", "policies": 2})}, ())
    for name in names[1:]:
        roster = next_roster(roster, mixing_node(rng, roster, name))
    return {"hierarchy": "random", "world": "world", **snippet(roster.nodes, roster.edges)}


def mixing_node(rng: random.Random, roster: Roster, name: str) -> Attach:
    """A node above one to three others."""
    lowers = rng.sample(sorted(roster.nodes), min(len(roster.nodes), rng.randint(1, 3)))
    parameters = {"name": name, "policies": rng.randint(1, 3), "generation": rng.randrange(1000)}
    edges = []
    for lower in lowers:
        kinds = {
            kind: Reference(f"{MIXING}:{rng.choice(('Mix', 'DrawingMix'))}", {"name": f"{lower}-{name}-{kind}"})
            for kind in ("sense", "task", "context")
            if rng.random() < 0.8
        }
        edges.append(RosterEdge(lower, name, kinds.get("sense"), kinds.get("task"), kinds.get("context")))
    return Attach({name: Reference(f"{MIXING}:{rng.choice(('Mixer', 'Drawer'))}", parameters)}, tuple(edges))


def mixing_extra(rng: random.Random, roster: Roster) -> Attach:
    """A further node; sometimes under a name that was there before."""
    free = [name for name in (f"n{number:02}" for number in range(1, 1000)) if name not in roster.nodes]
    return mixing_node(rng, roster, rng.choice(free[:4]))


def mixing_other(rng: random.Random, reference: Reference) -> Reference:
    """Another generation of a node: it hashes the belief that it takes over."""
    return Reference(reference.target, {**reference.parameters, "generation": rng.randrange(1000)})


def next_change(rng: random.Random, subject: Subject, first: Roster, roster: Roster) -> tuple[str, Change, Roster]:
    """A change that the roster bears; its kind, and the roster after it."""
    while True:
        kind = rng.choice(KINDS)
        if kind == "attach":
            change: Change = subject.extra(rng, roster)
            lost = sorted(first.nodes.keys() - roster.nodes.keys())
            if lost:
                name = rng.choice(lost)
                change = Attach({name: first.nodes[name]}, tuple(e for e in first.edges if name in e.pair))
        else:
            name = rng.choice(sorted(roster.nodes.keys() - {roster.world}))
            if kind == "detach":
                change = Detach(name, cascade=True)
            else:
                change = Replace(name, subject.other(rng, roster.nodes[name]))
        try:
            after = next_roster(roster, change)
        except ChangeError:
            continue
        if len(after.nodes) > len(first.nodes) // 2:
            return kind, change, after


def snippet(nodes: Mapping[str, Reference], edges: tuple[RosterEdge, ...]) -> dict[str, Any]:
    """Nodes and edges as a deployment file has them."""

    def plain(reference: Reference | None, what: str) -> Any:
        if reference is None:
            return None
        return {what: reference.target, "parameters": json.loads(json.dumps(reference.parameters))}

    return {
        "nodes": {name: plain(node, "class") for name, node in nodes.items()},
        "edges": {
            f"{edge.lower} -> {edge.upper}": {
                kind: plain(getattr(edge, kind), "function") for kind in ("sense", "task", "context")
            }
            for edge in edges
        },
    }
