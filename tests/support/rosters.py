"""Random rosters and changes of them, right ones and wrong ones; nothing that they name can be loaded."""

from __future__ import annotations

import random

from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge
from support.hierarchies import random_pairs

WORLD = "world"
POOL = ("world", *(f"n{number}" for number in range(9)))
"""All names that occur, so that some changes meet nodes that are there and some do not."""

MODULES = ("robots.arm", "robots.eye", "toys")


def random_reference(rng: random.Random) -> Reference:
    """One of a few references, so that two are sometimes equal."""
    return Reference(f"{rng.choice(MODULES)}:make", {"gain": rng.choice((1, 1.0, True, (1, 2)))})


def random_edge(rng: random.Random, lower: str, upper: str) -> RosterEdge:
    """An edge with some functions."""
    functions = (random_reference(rng) if rng.random() < 0.6 else None for _ in range(3))
    return RosterEdge(lower, upper, *functions)


def random_roster(rng: random.Random) -> Roster:
    """A valid roster of 1 to 7 nodes, in any order."""
    names = [WORLD, *rng.sample(POOL[1:], rng.randrange(7))]
    edges = [random_edge(rng, *pair) for pair in random_pairs(rng, names, rng.choice((0.0, 0.3, 0.8)))]
    rng.shuffle(edges)
    nodes = {name: random_reference(rng) for name in rng.sample(names, len(names))}
    instances = {name: rng.randrange(3) for name in names if rng.random() < 0.5}
    return Roster(WORLD, nodes, tuple(edges), rng.randrange(3), instances)


def random_change(rng: random.Random, roster: Roster) -> Change:
    """A change that a roster can bear, more often than not."""
    kind = rng.randrange(3)
    if kind == 0:
        return random_attach(rng, roster)
    name = rng.choice(sorted(roster.nodes) if rng.random() < 0.9 else POOL)
    if kind == 1:
        return Detach(name, cascade=rng.random() < 0.5)
    edges = None
    if rng.random() < 0.5:
        old = [edge.pair for edge in roster.edges if name in edge.pair]
        pairs = [pair for pair in old if rng.random() < 0.9] + _wild(rng, name)
        edges = tuple(random_edge(rng, *pair) for pair in pairs)
    return Replace(name, random_reference(rng), edges)


def random_attach(rng: random.Random, roster: Roster) -> Attach:
    """Mostly new names, each mostly with an edge from below."""
    free = sorted(set(POOL) - roster.nodes.keys())
    names = rng.sample(free, min(len(free), rng.choice((1, 1, 2, 3))))
    if rng.random() < 0.1:
        names.append(rng.choice(POOL))
    there = sorted(roster.nodes)
    pairs: list[tuple[str, str]] = []
    for name in names:
        pairs += [(lower, name) for lower in there if rng.random() < 0.4] or [(rng.choice(there), name)]
        pairs += _wild(rng, name)
        there.append(name)
    return Attach({name: random_reference(rng) for name in names}, tuple(random_edge(rng, *pair) for pair in pairs))


def _wild(rng: random.Random, name: str) -> list[tuple[str, str]]:
    """Sometimes one more edge, to or from anything, doubled, cyclic or of another node."""
    if rng.random() < 0.6:
        return []
    other = rng.choice(POOL)
    return [rng.choice(((name, other), (name, other), (other, name), (other, rng.choice(POOL))))]
