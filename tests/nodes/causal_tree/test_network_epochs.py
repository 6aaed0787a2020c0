"""How many epochs a network takes: against all undirected paths, one by one."""

from __future__ import annotations

import numpy as np
import pytest
from support.exact_networks import random_network

from hierax.nodes.causal_tree import Network, Variable, epochs_needed, parse


def shaped(parents: dict[str, list[str]]) -> Network:
    """A network of these arrows."""
    return Network({name: Variable(name, ("0",), tuple(above), np.ones(1)) for name, above in parents.items()})


def by_paths(parents: dict[str, tuple[str, ...]]) -> int:
    """1 more than the most nodes on a path that are entered from one parent and left to another."""
    joined: dict[str, list[str]] = {name: list(above) for name, above in parents.items()}
    for name, above in parents.items():
        for parent in above:
            joined[parent].append(name)
    most = 0
    paths = [[name] for name in parents]
    while paths:
        path = paths.pop()
        turns = sum(a in parents[b] and c in parents[b] for a, b, c in zip(path, path[1:], path[2:], strict=False))
        most = max(most, turns)
        paths += [[*path, following] for following in joined[path[-1]] if following not in path]
    return most + 1


@pytest.mark.parametrize("seed", range(60))
def test_it_is_what_the_paths_say(seed: int) -> None:
    network = parse(random_network(seed, 2 + seed % 12, polytree=True))
    parents = {str(name): tuple(map(str, each.parents)) for name, each in network.variables.items()}
    assert epochs_needed(network) == by_paths(parents), f"seed {seed}"


@pytest.mark.parametrize("seed", range(5))
def test_trees_take_one(seed: int) -> None:
    assert epochs_needed(random_network(seed, 20)) == 1


def test_a_zigzag_takes_one_for_each_turn() -> None:
    parents: dict[str, list[str]] = {}
    for number in range(1000):  # p0 -> c0 <- p1 -> c1 <- p2 …
        parents[f"p{number}"] = []
        parents[f"c{number}"] = [f"p{number}", f"p{number + 1}"]
    parents["p1000"] = []
    assert epochs_needed(shaped(parents)) == 1001


def test_at_most_the_longest_undirected_path() -> None:
    assert epochs_needed(shaped({"alone": []})) == 1
    assert epochs_needed(shaped({"a": [], "b": [], "c": ["a", "b"]})) == 2
