"""Descriptions: what is read, and what is refused with the node's name."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from hierax.nodes.causal_tree import NetworkError, parse

ROOT = {"id": "rain", "states": 2, "prior": [0.7, 0.3]}
CHILD = {"id": "wet", "states": 2, "parents": ["rain"], "cpt": [[0.9, 0.1], [0.2, 0.8]]}


def changed(**fields: Any) -> list[dict[str, Any]]:
    """A right description with the child's fields changed; None takes one away."""
    child = {key: value for key, value in {**CHILD, **fields}.items() if value is not None}
    return [child, ROOT]


def test_nodes_may_stand_in_any_order() -> None:
    network = parse([CHILD, ROOT])
    assert list(network.variables) == ["wet", "rain"]
    assert network.variables["wet"].parents == ("rain",)
    np.testing.assert_array_equal(network.variables["wet"].table, [[0.9, 0.1], [0.2, 0.8]])
    assert network.is_tree


def test_states_are_a_number_or_names() -> None:
    network = parse([{**ROOT, "states": ["dry", "rainy"]}, CHILD])
    assert network.variables["rain"].states == ("dry", "rainy")
    assert network.variables["wet"].states == ("0", "1")


def test_a_node_without_parents_may_give_its_prior_as_cpt_or_a_whole_number_as_id() -> None:
    network = parse([{"id": 7, "states": 2, "parents": [], "cpt": [0.5, 0.5]}])
    np.testing.assert_array_equal(network.variables[7].table, [0.5, 0.5])


def test_the_axes_of_a_table_go_as_the_parents_do() -> None:
    table = np.full((2, 3, 4), 0.25)
    network = parse(
        [
            {"id": "c", "states": 4, "parents": ["a", "b"], "cpt": table.tolist()},
            {"id": "b", "states": 3, "prior": [0.2, 0.3, 0.5]},
            {"id": "a", "states": 2, "prior": [1, 0]},
        ]
    )
    assert network.variables["c"].table.shape == (2, 3, 4)
    assert not network.is_tree


def test_tables_are_used_as_they_stand() -> None:
    rounded = [0.3333333, 0.3333333, 0.3333333]
    assert parse([{"id": "a", "states": 3, "prior": rounded}]).variables["a"].table.tolist() == rounded


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (changed(cpt=[[0.9, 0.1], [0.2, 0.7]]), "node 'wet': cpt: row [1] should sum to 1, not 0.9"),
        (changed(cpt=[[0.9, 0.1], [1.2, -0.2]]), "node 'wet': cpt: expected numbers of at least 0, got -0.2"),
        (changed(cpt=[[0.9, 0.1], [float("nan"), 0.2]]), "node 'wet': cpt: expected finite numbers, got nan"),
        (changed(cpt=[[0.9, 0.1], [float("inf"), 0.2]]), "node 'wet': cpt: expected finite numbers, got inf"),
        (changed(cpt=[[0.9, 0.1], [float("inf"), float("-inf")]]), "node 'wet': cpt: expected finite numbers, got inf"),
        (changed(cpt=[[1e308, 1e308], [0.5, 0.5]]), "node 'wet': cpt: row [0] should sum to 1, not inf"),
        (changed(cpt=[[0.9, 0.1]]), "node 'wet': cpt: expected numbers of shape 2 × 2, got 1 × 2"),
        (changed(cpt=[[0.9, 0.1], [1.0]]), "node 'wet': cpt: expected numbers of shape 2 × 2, got lists of uneven"),
        (changed(cpt=[["0.9", "0.1"], ["0.5", "0.5"]]), "node 'wet': cpt: expected numbers, got [['0.9'"),
        (changed(cpt=None, prior=[0.5, 0.5]), "node 'wet': expected a cpt, as it has parents, got a prior"),
        (changed(prior=[0.5, 0.5]), "node 'wet': expected a cpt, got prior and cpt"),
        (changed(cpt=None), "node 'wet': expected a cpt, got neither prior nor cpt"),
        ([{"id": "a", "states": 2}], "node 'a': expected a prior, got neither prior nor cpt"),
        ([{"id": "a", "states": 2, "prior": [0.5, 0.6]}], "node 'a': prior: the numbers should sum to 1, not 1.1"),
        (changed(parents=["snow"]), "node 'wet': parents: there is no node 'snow'"),
        (changed(parents=["rain", "rain"]), "node 'wet': parents: 'rain' is there twice"),
        (changed(parents=[str(n) for n in range(63)]), "node 'wet': parents: 63 of them; at most 62 are allowed"),
        (changed(parents="rain"), "node 'wet': parents: expected a list of ids, got 'rain'"),
        (changed(states=0), "node 'wet': states: expected at least 1, got 0"),
        (changed(states=2.0), "node 'wet': states: expected their number or a list"),
        (changed(states=["a", "a"]), "node 'wet': states: 'a' is there twice"),
        (changed(states=None), "node 'wet': states: expected their number or their names, got nothing"),
        ([ROOT, ROOT], "node 'rain': there are two nodes of that id"),
        ([{"states": 2, "prior": [0.5, 0.5]}], "entry 1: expected an id, got states, prior"),
        ([{"id": None}], "entry 1: id: expected a text or a whole number, got None"),
        (["rain"], "entry 1: expected a map with id, states, parents and prior or cpt, got 'rain'"),
        ([], "expected a list of nodes, got an empty one"),
        ({"rain": ROOT}, "expected a list of nodes, got dict"),
    ],
)
def test_what_is_wrong_is_told_with_the_node(description: Any, message: str) -> None:
    with pytest.raises(NetworkError, match=re.escape(message)) as caught:
        parse(description)
    if message.startswith("node "):
        assert repr(caught.value.node) == message.split(":")[0].removeprefix("node ")


def joined(**parents: list[str]) -> list[dict[str, Any]]:
    """Nodes of one state each."""
    return [
        {"id": name, "states": 1, "parents": above, "cpt": np.ones((1,) * (len(above) + 1)).tolist()}
        for name, above in parents.items()
    ]


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (joined(a=["c"], b=["a"], c=["b"]), "there is a cycle: a -> b -> c -> a"),
        (joined(x=[], a=["a"]), "there is a cycle: a -> a"),
        (joined(x=["a"], a=["b"], b=["a"]), "there is a cycle: a -> b -> a"),
        (joined(a=[], b=["a"], c=["a"], d=["b", "c"]), "undirected loop, b - a - c - d - b"),
        (joined(r=[], a=["r"], b=["a"], c=["a", "b"]), "undirected loop, b - a - c - b"),
    ],
)
def test_ways_back_are_printed(description: Any, message: str) -> None:
    with pytest.raises(NetworkError) as caught:
        parse(description)
    way = re.search(r"(?:cycle: |loop, )([^;,]*)", str(caught.value))
    wanted = re.search(r"(?:cycle: |loop, )(.*)", message)
    assert way is not None
    assert wanted is not None
    assert same_ring(way[1], wanted[1]), str(caught.value)


def same_ring(one: str, other: str) -> bool:
    """Whether two printed rings are the same, wherever they begin; undirected ones in either direction."""
    arrow = " -> " if "->" in one else " - "
    a, b = one.split(arrow)[:-1], other.split(arrow)[:-1]
    turns = [b[place:] + b[:place] for place in range(len(b))]
    return a in turns or (arrow == " - " and a[::-1] in turns)


def test_a_long_loop_is_found_without_recursion() -> None:
    names = [f"n{number}" for number in range(5000)]
    description = joined(**{name: names[place - 1 : place] for place, name in enumerate(names)})
    parse(description)
    description[-1] = {**description[-1], "parents": [names[-2], names[0]], "cpt": [[[1.0]]]}
    with pytest.raises(NetworkError, match="undirected loop"):
        parse(description)
