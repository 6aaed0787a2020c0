"""Changes of rosters: what comes out, what is refused, who is touched; by example and at random."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.rosters import POOL, random_attach, random_change, random_roster
from support.strategies import randoms

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.owner.roster_changes import ChangeError, apply, next_roster, removed, touched
from hierax.schemas.rates import FROM_THE_BEGINNING, Pair, Turns
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge

SCENE, ARM, BASE, EYE = (Reference(f"robots.{name}:Node") for name in ("scene", "arm", "base", "eye"))
SEEN = Reference("robots.arm:seen")
ROSTER = Roster(
    "world",
    {"world": SCENE, "arm": ARM, "base": BASE, "eye": EYE},
    (
        RosterEdge("arm", "eye", SEEN, SEEN),
        RosterEdge("base", "arm", SEEN, None, SEEN),
        RosterEdge("base", "eye"),
        RosterEdge("world", "base", SEEN),
    ),
    version=4,
    instances={"base": 2, "arm": 3},
)
"""world -> base -> arm -> eye, and base -> eye."""


def changed(change: Change, roster: Roster = ROSTER) -> Roster:
    return next_roster(roster, change)


def test_attach() -> None:
    lens, grip = Reference("robots.lens:Node"), Reference("robots.grip:Node")
    edges = (RosterEdge("eye", "lens", SEEN), RosterEdge("base", "grip"), RosterEdge("grip", "eye"))
    after = changed(Attach({"lens": lens, "grip": grip}, edges))
    assert after == Roster(
        "world",
        {**ROSTER.nodes, "grip": grip, "lens": lens},
        tuple(sorted((*ROSTER.edges, *edges), key=lambda edge: edge.pair)),
        5,
        {"base": 2, "arm": 3, "grip": 5, "lens": 5},
    )
    assert touched(ROSTER, after) == {"lens", "grip", "eye", "base"}
    assert removed(ROSTER, after) == set()


def test_detach() -> None:
    after = changed(Detach("arm"))
    nodes = {"world": SCENE, "base": BASE, "eye": EYE}
    assert after == Roster("world", nodes, (ROSTER.edges[2], ROSTER.edges[3]), 5, {"base": 2})
    assert touched(ROSTER, after) == {"base", "eye"}
    assert removed(ROSTER, after) == {"arm"}


def test_detach_with_all_that_hangs_on_it() -> None:
    after = changed(Detach("base", cascade=True))
    assert after == Roster("world", {"world": SCENE}, (), 5, {})
    assert touched(ROSTER, after) == {"world"}
    assert removed(ROSTER, after) == {"arm", "base", "eye"}


def test_a_cascade_leaves_what_is_joined_otherwise() -> None:
    assert changed(Detach("arm", cascade=True)) == changed(Detach("arm"))


def test_replace() -> None:
    new = replace(ARM, parameters={"gain": 2})
    after = changed(Replace("arm", new))
    assert after == replace(ROSTER, nodes={**ROSTER.nodes, "arm": new}, version=5, instances={"base": 2, "arm": 5})
    assert touched(ROSTER, after) == {"arm", "base", "eye"}


def test_replace_with_other_edges() -> None:
    edges = (RosterEdge("world", "arm", SEEN),)
    after = changed(Replace("arm", ARM, edges))
    assert after.edges == (RosterEdge("base", "eye"), *edges, ROSTER.edges[3])
    assert touched(ROSTER, after) == {"arm", "base", "eye", "world"}


def restarted(roster: Roster, instances: Mapping[str, int], version: int) -> Roster:
    """The roster with new processes for some of its nodes; its content stays."""
    return replace(roster, version=version, instances={**roster.instances, **instances})


def test_new_processes_touch_their_neighbours() -> None:
    after = restarted(ROSTER, {"world": 1, "arm": 4}, 7)
    assert after == replace(ROSTER, version=7, instances={"base": 2, "arm": 4, "world": 1})
    assert after.content_hash() == ROSTER.content_hash()
    assert touched(ROSTER, after) == {"world", "arm", "base", "eye"}
    assert touched(ROSTER, restarted(ROSTER, {"world": 1}, 7)) == {"world", "base"}


def test_new_versions_follow_the_old_ones() -> None:
    with pytest.raises(ValueError, match="roster version 4 does not follow 4"):
        apply(ROSTER, Replace("arm", ARM), 4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Attach({}), "cannot attach: no node is given"),
        (Attach({"arm": ARM}), "cannot attach 'arm': there is a node 'arm' already; replace it, or detach it first"),
        (Attach({"world": ARM}), "cannot attach 'world': 'world' is the world's name"),
        (Attach({"a b": ARM}, (RosterEdge("base", "a b"),)), "cannot attach 'a b': 'a b' is no node's name: expected"),
        (
            Attach({"lens": ARM}, (RosterEdge("aye", "lens"),)),
            "cannot attach 'lens': edge aye->lens names 'aye', and there is no such node; did you mean 'eye'?",
        ),
        (
            Attach({"lens": ARM}, (RosterEdge("eye", "lens"), RosterEdge("world", "eye"))),
            "cannot attach 'lens': edge world->eye joins two other nodes; it must join one that is attached",
        ),
        (
            Attach({"lens": ARM}, (RosterEdge("eye", "lens"), RosterEdge("eye", "lens"))),
            "cannot attach 'lens': edge eye->lens is given twice",
        ),
        (
            Attach({"lens": ARM}, (RosterEdge("lens", "eye"),)),
            "cannot attach 'lens': the world 'world' must be the only source, but nothing is below 'lens' either",
        ),
        (Attach({"lens": ARM}), "cannot attach 'lens': 'lens' cannot be reached from the world 'world': no edge joins"),
        (
            Attach({"lens": ARM}, (RosterEdge("base", "lens"), RosterEdge("lens", "base"))),
            "cannot attach 'lens': the edges form a cycle: ",
        ),
        (
            Attach({"lens": ARM}, (RosterEdge("base", "lens"), RosterEdge("lens", "world"))),
            "cannot attach 'lens': nothing may be below the world 'world', but 'lens' is",
        ),
        (Detach("amr"), "cannot detach 'amr': there is no such node; did you mean 'arm'?"),
        (Detach("world", cascade=True), "cannot detach 'world': it is the world; stop the run instead"),
        (
            Detach("base"),
            "cannot detach 'base': only it joins 'arm', 'eye' to the world; detach them first, or cascade (--cascade)",
        ),
        (Replace("aye", ARM), "cannot replace 'aye': there is no such node; did you mean 'eye'?"),
        (Replace("world", ARM), "cannot replace 'world': it is the world, whose process owns the roster"),
        (Replace("arm", ARM, ()), "cannot replace 'arm': 'arm' cannot be reached from the world 'world': no edge"),
        (
            Replace("arm", ARM, (RosterEdge("bose", "arm"),)),
            "cannot replace 'arm': edge bose->arm names 'bose', and there is no such node; did you mean 'base'?",
        ),
        (
            Replace("arm", ARM, (RosterEdge("base", "arm"), RosterEdge("world", "eye"))),
            "cannot replace 'arm': edge world->eye does not join it",
        ),
        (
            Replace("arm", ARM, (RosterEdge("eye", "arm"), RosterEdge("arm", "base"))),
            "cannot replace 'arm': the edges form a cycle: ",
        ),
    ],
)
def test_what_is_refused(change: Change, message: str) -> None:
    with pytest.raises(ChangeError) as caught:
        changed(change)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_with_rates_who_has_to_pass_other_epochs_is_touched_however_far_away() -> None:
    turns = {"arm": Turns(20), "eye": Turns(40), "base": Turns(10)}
    roster = replace(ROSTER, turns=turns, timing=FROM_THE_BEGINNING)
    attach = Attach({"lens": EYE}, (RosterEdge("eye", "lens"),), {"lens": Turns(3)})
    assert touched(roster, changed(attach, roster)) == {"lens", "eye", "arm", "base", "world"}
    rarer = replace(attach, turns={"lens": Turns(80)})
    assert touched(replace(roster, turns={}), changed(rarer, replace(roster, turns={}))) == {"lens", "eye"}


def test_arrays_among_parameters_are_compared() -> None:
    def roster(last: float) -> Roster:
        return replace(ROSTER, nodes={**ROSTER.nodes, "arm": replace(ARM, parameters={"pose": np.array([0.0, last])})})

    assert touched(roster(1.0), replace(roster(1.0), version=9)) == set()
    assert touched(roster(1.0), roster(2.0)) == {"arm"}
    assert touched(roster(np.nan), roster(np.nan)) == set()


# At random. What is expected is worked out anew here, from the definitions.


def reached(world: str, pairs: Iterable[Pair]) -> set[str]:
    """All names that a path leads to from the world."""
    found = {world}
    pairs = list(pairs)
    for _ in pairs:
        found |= {upper for lower, upper in pairs if lower in found}
    return found


def is_hierarchy(world: str, names: Iterable[str], edges: Iterable[RosterEdge]) -> bool:
    try:
        check_graph(world, names, [edge.pair for edge in edges])
    except HierarchyError:
        return False
    return True


def expected(roster: Roster, change: Change) -> tuple[dict[str, Reference], list[RosterEdge]] | None:
    """Nodes and edges after a change; None if it must be refused."""
    nodes, edges = dict(roster.nodes), list(roster.edges)
    if isinstance(change, Attach):
        foreign = [edge for edge in change.edges if not change.nodes.keys() & set(edge.pair)]
        if foreign or not change.nodes or change.nodes.keys() & nodes.keys():
            return None
        nodes.update(change.nodes)
        edges += change.edges
    elif change.name not in nodes or change.name == roster.world:
        return None
    elif isinstance(change, Detach):
        del nodes[change.name]
        edges = [edge for edge in edges if change.name not in edge.pair]
        if change.cascade:
            staying = reached(roster.world, (edge.pair for edge in edges))
            nodes = {name: node for name, node in nodes.items() if name in staying}
            edges = [edge for edge in edges if edge.lower in nodes]
    else:
        nodes[change.name] = change.reference
        if change.edges is not None:
            if any(change.name not in edge.pair for edge in change.edges):
                return None
            edges = [edge for edge in edges if change.name not in edge.pair] + list(change.edges)
    return (nodes, edges) if is_hierarchy(roster.world, nodes, edges) else None


def wiring(name: str, roster: Roster) -> Any:
    """All that a node's engine is made of."""
    edges = sorted((edge for edge in roster.edges if name in edge.pair), key=lambda edge: edge.pair)
    around = sorted({end for edge in edges for end in edge.pair})
    return (
        repr(roster.nodes[name]),  # 1, 1.0 and True are equal, but not the same
        name == roster.world,
        repr(edges),
        [(end, roster.instance(end)) for end in around],
        roster.instance(name),
    )


@given(randoms, st.integers(1, 12))
def test_any_changes_give_valid_rosters_or_are_refused(rng: random.Random, changes: int) -> None:
    roster = replace(random_roster(rng), version=3)  # above all its instances
    for _ in range(changes):
        change = random_change(rng, roster)
        version = roster.version + rng.randint(1, 3)
        right = expected(roster, change)
        if right is None:
            with pytest.raises(ChangeError) as caught:
                apply(roster, change, version)
            assert "\n" not in str(caught.value)
            continue
        after = apply(roster, change, version)
        nodes, edges = right
        assert (after.world, after.version, after.nodes) == (roster.world, version, nodes)
        assert after.edges == tuple(sorted(edges, key=lambda edge: edge.pair))
        check_graph(after.world, after.nodes, [edge.pair for edge in after.edges])
        fresh = set(change.nodes) if isinstance(change, Attach) else {change.name}
        wanted = {name: version if name in fresh else roster.instance(name) for name in nodes}
        assert {name: after.instance(name) for name in nodes} == wanted
        assert after.instances.keys() <= nodes.keys()
        roster = after


@given(randoms)
def test_the_content_depends_on_nothing_else(rng: random.Random) -> None:
    roster = random_roster(rng)
    change = random_change(rng, roster)
    if expected(roster, change) is None:
        return
    first = apply(roster, change, 9)
    names = rng.sample(sorted(roster.nodes), len(roster.nodes))
    edges = tuple(rng.sample(roster.edges, len(roster.edges)))
    other = replace(roster, nodes={name: roster.nodes[name] for name in names}, edges=edges, version=11, instances={})
    second = apply(other, change, 12)
    assert first.content_hash() == second.content_hash()
    assert restarted(first, dict.fromkeys(first.nodes, 9), 10).content_hash() == first.content_hash()


@given(randoms)
def test_those_are_touched_whose_wiring_differs(rng: random.Random) -> None:
    old = random_roster(rng)
    new = random_roster(rng)  # one that has nothing to do with it
    for _ in range(4):
        differing = {name for name in new.nodes if name not in old.nodes or wiring(name, old) != wiring(name, new)}
        assert touched(old, new) == differing
        assert removed(old, new) == set(old.nodes) - set(new.nodes)
        old = new
        change = random_attach(rng, old) if rng.random() < 0.3 else random_change(rng, old)
        if rng.random() < 0.3:
            names = rng.sample(sorted(old.nodes), rng.randint(0, len(old.nodes)))
            new = restarted(old, {name: old.instance(name) + 1 for name in names}, old.version + 1)
        elif expected(old, change) is not None:
            new = next_roster(old, change)


def test_random_changes_are_of_all_kinds_made_and_refused() -> None:
    rng = random.Random(3)
    seen = set()
    for _ in range(2000):
        roster = random_roster(rng)
        change = random_change(rng, roster)
        seen.add((type(change), expected(roster, change) is not None))
    assert seen == {(kind, made) for kind in (Attach, Detach, Replace) for made in (True, False)}
    assert len(POOL) > 8
