"""What `make growth` measures are hierarchies, and its ratios are of the same round."""

from __future__ import annotations

import growth
import pytest


@pytest.mark.parametrize("shape", growth.SHAPES)
def test_each_shape_is_a_hierarchy(shape: str) -> None:
    roster = growth.hierarchy(shape, 40).deployment().roster
    assert roster.world == "n0"
    assert len(roster.nodes) == 40
    assert len(roster.edges) == sum(1 for _ in growth.SHAPES[shape](40))


def test_a_random_graph_is_the_same_again_and_has_some_more_edges_than_a_tree() -> None:
    edges = list(growth.graph(1000))
    assert edges == list(growth.graph(1000))
    assert 1.2 * 1000 < len(edges) < 1.3 * 1000


def test_ratios_are_of_the_same_round() -> None:
    base = [growth.Turn(1.0, 10.0), growth.Turn(1.0, 20.0), growth.Turn(1.0, 40.0)]
    slower = [growth.Turn(2.0, 12.0), growth.Turn(2.0, 22.0), growth.Turn(2.0, 60.0)]
    first, second = growth.rows({growth.BASE: base, ("star", 9): slower})
    assert (first["ratio"], first["ratio_range"]) == (1.0, [1.0, 1.0])
    assert (second["ratio"], second["ratio_range"], second["epoch_us_a_node"]) == (1.2, [1.1, 1.5], 22.0)
