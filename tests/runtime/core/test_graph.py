"""Which graphs are hierarchies, and how the others are refused."""

from __future__ import annotations

import random

import pytest
from support.hierarchies import random_pairs

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph, topological_order

CHAIN = [("world", "arm"), ("arm", "spatial")]


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        ("world", []),
        ("world arm", [("world", "arm")]),
        ("world arm spatial", CHAIN),
        ("world arm spatial", [*CHAIN, ("world", "spatial")]),
        ("world a b top", [("world", "a"), ("world", "b"), ("a", "top"), ("b", "top")]),
        ("world a b", [("world", "a"), ("world", "b")]),
    ],
)
def test_hierarchies(names: str, pairs: list[tuple[str, str]]) -> None:
    check_graph("world", names.split(), pairs)


@pytest.mark.parametrize(
    ("names", "pairs", "reason"),
    [
        ("arm", [], "the world 'world' is none of the nodes 'arm'"),
        ("", [], "the world 'world' is none of the nodes "),
        ("world arm", [("world", "am")], "edge world->am names 'am', which is none of the nodes 'arm', 'world'"),
        ("world arm", [("wrld", "arm")], "edge wrld->arm names 'wrld', which is none of the nodes 'arm', 'world'"),
        ("world arm", [("world", "arm"), ("arm", "arm")], "edge arm->arm joins a node to itself"),
        ("world arm", [("world", "arm"), ("world", "arm")], "edge world->arm is given twice"),
        ("world arm", [("world", "arm"), ("arm", "world")], "nothing may be below the world 'world', but 'arm' is"),
        (
            "world a b c",
            [("world", "a"), ("a", "b"), ("b", "c"), ("c", "a")],
            "the edges form a cycle: a -> b -> c -> a",
        ),
        (
            "world a b",
            [("world", "a"), ("b", "a")],
            "the world 'world' must be the only source, but nothing is below 'b' either; "
            "unreachable from the world: 'b'",
        ),
        (
            "world a b c",
            [("world", "a"), ("b", "c")],
            "the world 'world' must be the only source, but nothing is below 'b' either; "
            "unreachable from the world: 'b', 'c'",
        ),
        ("world a b c", [("world", "a")], "'b', 'c' cannot be reached from the world 'world': no edge joins it"),
        ("world a/b", [("world", "a/b")], "'a/b' is no node's name"),
        ("world a->b", [("world", "a->b")], "'a->b' is no node's name"),
    ],
)
def test_what_is_no_hierarchy_is_refused_with_reason_and_names(
    names: str, pairs: list[tuple[str, str]], reason: str
) -> None:
    with pytest.raises(HierarchyError) as raised:
        check_graph("world", names.split(), pairs)
    assert str(raised.value).startswith(reason)


def rotations(cycle: list[str]) -> set[str]:
    return {" -> ".join([*cycle[i:], *cycle[:i], cycle[i]]) for i in range(len(cycle))}


def test_the_cycle_is_printed_along_its_edges() -> None:
    pairs = [("world", "z"), ("z", "y"), ("y", "x"), ("x", "z")]
    with pytest.raises(HierarchyError) as raised:
        check_graph("world", ["world", "x", "y", "z"], pairs)
    assert str(raised.value).removeprefix("the edges form a cycle: ") in rotations(["z", "y", "x"])


def test_the_order_respects_edges_and_gives_ties_by_name() -> None:
    assert topological_order("cab", []) == ("a", "b", "c")
    assert topological_order(["top", "a", "b", "world"], [("world", "b"), ("world", "a"), ("b", "top")]) == (
        "world",
        "a",
        "b",
        "top",
    )


@pytest.mark.parametrize("seed", range(50))
def test_random_graphs(seed: int) -> None:
    rng = random.Random(seed)
    names = [f"n{index}" for index in range(rng.randint(3, 12))]
    rng.shuffle(names)
    pairs = random_pairs(rng, names, rng.random())
    check_graph(names[0], sorted(names), pairs)
    order = topological_order(names, pairs)
    assert all(order.index(lower) < order.index(upper) for lower, upper in pairs)
    shuffled = rng.sample(pairs, len(pairs))
    assert topological_order(sorted(names), shuffled) == order
    without = [pair for pair in pairs if pair[1] != names[-1]]
    with pytest.raises(HierarchyError, match=repr(names[-1])):
        check_graph(names[0], names, without)
    high, low = names[-1], rng.choice([lower for lower, upper in pairs if upper == names[-1]])
    with pytest.raises(HierarchyError, match=r"cycle|nothing may be below"):
        check_graph(names[0], names, [*pairs, (high, low)])
