"""Where networks come from, and what evidence may be written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.exact_networks import random_network

from hierax.nodes.causal_tree import (
    EvidenceError,
    NetworkError,
    likelihoods,
    network_from,
    parse,
    posteriors,
    random_tree,
)
from hierax.nodes.causal_tree.networks import sampled

RAIN = [
    {"id": "wet", "states": ["no", "yes"], "parents": ["rain"], "cpt": [[0.9, 0.1], [0.2, 0.8]]},
    {"id": "rain", "states": ["no", "yes"], "parents": [], "prior": [0.0, 1.0]},
]


def test_a_random_tree_comes_of_its_seed() -> None:
    assert random_tree(20, 3, 5) == random_tree(20, 3, 5) != random_tree(20, 3, 6)
    network = network_from({"nodes": 20, "states": 3, "seed": 5})
    assert network.is_tree
    assert list(network.variables) == [f"n{number}" for number in range(20)]


def test_a_file_or_a_list(tmp_path: Path) -> None:
    path = tmp_path / "rain.yaml"
    path.write_text("- {id: rain, states: 2, prior: [0.25, 0.75]}\n")
    assert list(network_from(str(path)).variables) == ["rain"]
    assert list(network_from(RAIN).variables) == ["wet", "rain"]


@pytest.mark.parametrize("seed", range(3))
def test_samples_are_drawn_in_the_order_of_the_description_as_far_as_parents_are_there(seed: int) -> None:
    network = random_network(seed, 40)
    random = np.random.default_rng(seed)
    found: dict[Any, int] = {}
    while len(found) < len(network):
        for entry in network:
            if entry["id"] in found or not all(parent in found for parent in entry["parents"]):
                continue
            row = np.array(entry["cpt"] if entry["parents"] else entry["prior"])[
                tuple(map(found.get, entry["parents"]))
            ]
            found[entry["id"]] = int(np.searchsorted(np.cumsum(row), random.random() * row.sum(), side="right"))
    assert sampled(parse(network), np.random.default_rng(seed)) == found
    assert list(found) != [entry["id"] for entry in network]


@pytest.mark.parametrize("count", [61, 62])
def test_a_node_may_have_so_many_parents(count: int) -> None:
    parents = [{"id": f"p{n}", "states": 1, "prior": [1.0]} for n in range(count)]
    cpt: Any = [0.25, 0.75]
    for _ in range(count):
        cpt = [cpt]
    names = [each["id"] for each in parents]
    found = posteriors([*parents, {"id": "c", "states": 2, "parents": names, "cpt": cpt}], {})
    np.testing.assert_allclose(found["c"], [0.25, 0.75])


@pytest.mark.parametrize(
    "source", [{"nodes": 20}, {"nodes": 20, "states": "3", "seed": 1}, {"nodes": -1, "states": 2, "seed": 1}]
)
def test_a_random_tree_needs_three_numbers(source: Any) -> None:
    with pytest.raises(NetworkError, match="network: expected nodes, seed and states"):
        network_from(source)


@pytest.mark.parametrize(
    ("value", "vector"),
    [("yes", [0, 1]), (0, [1, 0]), (True, [0, 1]), ([0.2, 3], [0.2, 3.0]), ((1, 0), [1, 0])],
)
def test_evidence_is_a_state_or_likelihoods(value: Any, vector: list[float]) -> None:
    network = network_from([{**RAIN[1], "states": ["false", "true"] if value is True else ["no", "yes"]}])
    assert likelihoods(network, "rain", value).tolist() == vector


@pytest.mark.parametrize(("value", "vector"), [(1, [1, 0]), (2, [0, 1]), ("2", [0, 1]), (0, [1, 0])])
def test_a_number_that_is_a_state_s_name_means_that_state(value: Any, vector: list[float]) -> None:
    network = network_from([{**RAIN[1], "states": ["1", "2"]}])
    assert likelihoods(network, "rain", value).tolist() == vector


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("snow", "yes", "evidence for 'snow': there is no such node"),
        ("rain", "maybe", "evidence for 'rain': there is no state 'maybe'; expected one of no, yes"),
        ("rain", 2, "evidence for 'rain': there is no state 2"),
        ("rain", [1, 0, 0], "evidence for 'rain': expected 2 likelihoods, one for each state, got [1, 0, 0]"),
        ("rain", [1, -1], "evidence for 'rain': expected finite numbers of at least 0"),
        ("rain", ["a", "b"], "evidence for 'rain': expected 2 likelihoods"),
    ],
)
def test_other_evidence_is_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises(EvidenceError, match=re.escape(message)):
        likelihoods(network_from(RAIN), name, value)


def test_samples_are_of_the_network() -> None:
    network = network_from(RAIN)
    random = np.random.default_rng(1)
    draws = [sampled(network, random) for _ in range(2000)]
    assert {draw["rain"] for draw in draws} == {1}
    assert np.mean([draw["wet"] for draw in draws]) == pytest.approx(0.8, abs=0.03)


@pytest.mark.parametrize(
    "source",
    [
        {"nodes": 10**12, "states": 1, "seed": 0},
        {"nodes": 1, "states": 10**12, "seed": 0},
        {"nodes": 2000, "states": 1000, "seed": 0},
    ],
)
def test_a_random_tree_is_bounded(source: dict[str, int]) -> None:
    with pytest.raises(NetworkError, match="at most"):
        network_from(source)
