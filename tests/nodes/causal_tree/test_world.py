"""N₀ of a network: which evidence it shows when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.causal_tree import EvidenceWorld, evidence_seen, posteriors, random_tree
from hierax.runtime import Tick

NETWORK = [
    {"id": "rain", "states": ["no", "yes"], "prior": [0.7, 0.3]},
    {"id": "wet", "states": 2, "parents": ["rain"], "cpt": [[1.0, 0.0], [0.2, 0.8]]},
]


def test_sets_are_shown_in_turn_each_for_a_while() -> None:
    world = EvidenceWorld(NETWORK, [{"rain": "yes"}, {"wet": [0.2, 0.8]}, {}], hold=2)
    beliefs = [world.initial_belief()]
    for _ in range(6):
        beliefs.append(world.predict((), (), beliefs[-1]))
    assert [(each["set"], each["age"]) for each in beliefs] == [(0, 1), (0, 2), (1, 1), (1, 2), (2, 1), (2, 2), (0, 1)]
    assert [each["evidence"] for each in beliefs[::2]] == [{"rain": 1}, {"wet": (0.2, 0.8)}, {}, {"rain": 1}]


def test_likelihoods_may_be_an_array() -> None:
    world = EvidenceWorld(NETWORK, [{"wet": np.array([0.2, 0.8])}])
    assert world.initial_belief()["evidence"] == {"wet": (0.2, 0.8)}


def test_a_single_set_grows_old() -> None:
    world = EvidenceWorld(NETWORK, [{"rain": 0}])
    belief = world.initial_belief()
    for age in (2, 3):
        belief = world.predict((), (), belief)
        assert belief == {"set": 0, "age": age, "evidence": {"rain": 0}}


def test_what_parts_are_told() -> None:
    world = EvidenceWorld(NETWORK, [{"rain": "yes"}])
    told = evidence_seen(world.initial_belief(), tick=Tick(below=("world",), above=("part",)))
    assert told == ({"from": "world", "age": 1, "evidence": {"rain": 1}},)


def test_drawn_evidence_is_of_the_leaves_and_possible() -> None:
    network = random_tree(40, 3, 2)
    for entry in network:  # where 0 is above, 0 is below
        if entry["parents"]:
            entry["cpt"][0] = [1.0, 0.0, 0.0]
    world = EvidenceWorld(network, draw={"sets": 30, "share": 0.5, "seed": 4})
    again = EvidenceWorld(network, draw={"sets": 30, "share": 0.5, "seed": 4})
    parents = {parent for entry in network for parent in entry["parents"]}
    belief = world.initial_belief()
    assert belief == again.initial_belief()
    counts = []
    for _ in range(30):
        counts.append(len(belief["evidence"]))
        assert not parents & belief["evidence"].keys()
        posteriors(network, {name: [float(s == state) for s in range(3)] for name, state in belief["evidence"].items()})
        belief = world.predict((), (), belief)
    assert sum(counts) / 30 == pytest.approx(0.5 * (40 - len(parents)), rel=0.2)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "sets: expected either sets or draw"),
        ({"sets": [{}], "draw": {}}, "sets: expected either sets or draw"),
        ({"sets": []}, "sets: expected a list of maps"),
        ({"sets": [{"snow": 1}]}, "evidence for 'snow': there is no such node"),
        ({"sets": [{}], "hold": 0}, "hold: expected a number of epochs, at least 1, got 0"),
        ({"draw": {"sets": 3}}, "draw: expected sets"),
        ({"draw": {"sets": 3, "share": 1.5, "seed": 1}}, "draw: expected sets"),
    ],
)
def test_wrong_parameters(parameters: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EvidenceWorld(NETWORK, **parameters)


@pytest.mark.parametrize(
    "draw",
    [
        {"sets": 10**12, "share": 0.5, "seed": 0},
        {"sets": 1, "share": True, "seed": 0},
        {"sets": 1, "share": float("nan"), "seed": 0},
        {"sets": 1, "share": 0.5, "seed": "a"},
        {"sets": 1, "share": 0.5, "seed": -1},
    ],
)
def test_what_is_drawn_is_bounded_and_checked(draw: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="draw: "):
        EvidenceWorld(random_tree(10, 2, 0), draw=draw)
