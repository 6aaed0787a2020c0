"""From a network to a deployment."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import pytest
from support.parts import active, write_deployment

from hierax.nodes.causal_tree import NetworkError, as_deployment


def chain(*names: str) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = [{"id": names[0], "states": 2, "prior": [0.5, 0.5]}]
    for parent, name in itertools.pairwise(names):
        nodes.append({"id": name, "states": 2, "parents": [parent], "cpt": [[0.9, 0.1], [0.2, 0.8]]})
    return nodes


def test_each_node_a_process_by_default(tmp_path: Path) -> None:
    hierarchy = active(write_deployment(tmp_path, chain("a", "b", "c"), [{"c": 1}])).hierarchy
    assert sorted(hierarchy.nodes) == ["a", "b", "c", "world"]
    assert hierarchy.below("a") == ("b", "world")


def test_parts_are_joined_where_arrows_are(tmp_path: Path) -> None:
    parts = {"upper": ["a", "b"], "lower": ["c", "d"]}
    hierarchy = active(write_deployment(tmp_path, chain("a", "b", "c", "d"), [{}], parts)).hierarchy
    assert sorted(hierarchy.bound_edges) == [("lower", "upper"), ("world", "lower"), ("world", "upper")]


def test_polytrees_hold_their_evidence() -> None:
    network = [*chain("a", "b"), {"id": "c", "states": 1, "prior": [1]}]
    network[1] = {"id": "b", "states": 1, "parents": ["a", "c"], "cpt": [[[1]], [[1]]]}
    content = as_deployment(network, [{}])
    assert content["nodes"]["world"]["parameters"]["hold"] == 2
    assert content["nodes"]["b"]["parameters"]["settle"] == 2


def test_nodes_of_a_hierarchy_have_texts_as_ids() -> None:
    with pytest.raises(NetworkError, match="node 1: a node of a hierarchy needs a text as its id"):
        as_deployment([{"id": 1, "states": 2, "prior": [0.5, 0.5]}], [{}])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"x": ["a", "b", "c"]}, "node 'd': is in no part"),
        ({"x": ["a", "b"], "y": ["b", "c", "d"]}, "node 'b': is in two parts, 'x' and 'y'"),
        ({"x": ["a", "b", "c", "d", "e"]}, "part 'x' holds 'e', which the network has not"),
        ({"x": ["a", "c"], "y": ["b", "d"]}, "arrows between the parts go round in a circle: the edges form a cycle: "),
        ({"world": ["a", "b", "c", "d"]}, "a part cannot be named 'world'"),
    ],
)
def test_parts_that_are_no_hierarchy(parts: Any, message: str) -> None:
    with pytest.raises(NetworkError, match=re.escape(message)):
        as_deployment(chain("a", "b", "c", "d"), [{}], parts)
