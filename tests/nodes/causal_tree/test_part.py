"""Networks as hierarchies: exact after the stated number of Updates, for any parts; slots that come and go."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.exact_networks import elimination, random_evidence, random_network
from support.parts import active, advanced, believed, largest_error, write_deployment

from hierax.nodes.causal_tree import (
    ImpossibleEvidence,
    NetworkError,
    Part,
    causal_support,
    diagnostic_support,
    epochs_needed,
    posteriors,
)
from hierax.runtime import Tick
from hierax.runtime.core.errors import OperatorError
from hierax.schemas.values import decode_value, encode_value

CLOSE = 1e-12

CHAIN = [
    {"id": "rain", "states": 2, "prior": [0.7, 0.3]},
    {"id": "wet", "states": 2, "parents": ["rain"], "cpt": [[0.9, 0.1], [0.2, 0.8]]},
    {"id": "slip", "states": 2, "parents": ["wet"], "cpt": [[1.0, 0.0], [0.6, 0.4]]},
]
COLLIDER = [
    {"id": "a", "states": 2, "prior": [0.9, 0.1]},
    {"id": "b", "states": 2, "prior": [0.8, 0.2]},
    {"id": "c", "states": 2, "parents": ["a", "b"], "cpt": [[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]]},
]
"""c is the exclusive or of a and b."""


def random_parts(network: Any, rng: np.random.Generator) -> dict[str, list[str]]:
    labels = rng.integers(0, int(rng.integers(2, 4)), len(network))
    return {
        f"p{label}": [entry["id"] for entry, own in zip(network, labels, strict=True) if own == label]
        for label in sorted(set(labels.tolist()))
    }


@pytest.mark.parametrize("in_parts", [False, True])
@pytest.mark.parametrize("polytree", [False, True])
def test_beliefs_are_exact_after_the_stated_epochs(polytree: bool, in_parts: bool, tmp_path: Path) -> None:
    done = refused = too_early = 0
    for seed in range(30):
        rng = np.random.default_rng([seed, 3])
        network = random_network(seed, int(rng.integers(3, 11)), polytree)
        sets = [random_evidence(network, rng) for _ in range(3)]
        parts = random_parts(network, rng) if in_parts else None
        try:
            hierarchy = active(write_deployment(tmp_path, network, sets, parts))
        except NetworkError:
            continue  # the parts are no hierarchy
        needed = epochs_needed(network)
        for number, evidence in enumerate(sets):
            exact = elimination(network, evidence)
            if exact is None:
                with pytest.raises(OperatorError, match="ImpossibleEvidence"):
                    advanced(hierarchy, needed)
                refused += 1
                break
            hierarchy = advanced(hierarchy, needed - 1)
            too_early += needed > 1 and largest_error(believed(hierarchy), exact) > CLOSE
            hierarchy = advanced(hierarchy, 1)
            assert largest_error(believed(hierarchy), exact) < CLOSE, f"seed {seed}, set {number}"
            done += 1
    assert done > 20
    assert refused or in_parts
    assert too_early or not polytree or in_parts  # one epoch less would not do


def test_beliefs_do_not_depend_on_the_parts(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    network = random_network(8, 12)
    evidence = {entry["id"]: rng.random(entry["states"]).tolist() for entry in network[::2]}
    wanted = posteriors(network, evidence)
    names = {entry["id"] for entry in network}
    for top in sorted(names):
        below = set(Part(network, top=top, tops=[top]).nodes)
        if below == names:
            continue
        parts = {"lower": sorted(below), "upper": sorted(names - below)}
        hierarchy = advanced(active(write_deployment(tmp_path, network, [evidence], parts)), 1)
        assert largest_error(believed(hierarchy), wanted) < CLOSE, top


def test_further_epochs_change_nothing(tmp_path: Path) -> None:
    path = write_deployment(tmp_path, CHAIN, [{"slip": 1}])
    one, more = (believed(advanced(active(path), epochs)) for epochs in (1, 4))
    assert [row.tolist() for row in one.values()] == [row.tolist() for row in more.values()]


def test_an_exclusive_or_that_turns_round(tmp_path: Path) -> None:
    """New evidence contradicts what came down in the epochs before: that is no contradiction in the evidence."""
    sets = [{"a": 0, "c": 1}, {"a": 1, "c": 1}, {"a": 1, "c": 0}, {"b": 0, "c": 1}]
    hierarchy = active(write_deployment(tmp_path, COLLIDER, sets))
    for evidence in (*sets, *sets):
        hierarchy = advanced(hierarchy, 2)
        exact = elimination(COLLIDER, {name: np.eye(2)[state] for name, state in evidence.items()})
        assert exact is not None
        assert largest_error(believed(hierarchy), exact) < CLOSE


def test_a_contradiction_is_refused_when_it_has_settled(tmp_path: Path) -> None:
    impossible = {"a": 0, "b": 0, "c": 1}
    hierarchy = active(write_deployment(tmp_path, COLLIDER, [{"a": 0}, impossible]))
    hierarchy = advanced(hierarchy, 3)  # the second set is new: what contradicts may be under way
    assert any(state.belief.get("impossible") for state in hierarchy.states.values())
    with pytest.raises(OperatorError, match=r"the evidence is impossible: it leaves no state of node '[abc]'"):
        advanced(hierarchy, 1)


# --- one part by itself


def told(part: Part, belief: Any, *, epoch_below: Any = (), above: Any = (), tick: Tick) -> Any:
    return part.predict(above, (), part.observe(epoch_below, belief, tick=tick), tick=tick)


def evidence(**seen: Any) -> dict[str, Any]:
    return {"from": "world", "age": 1, "evidence": seen}


def test_the_papers_slots_for_a_node_by_itself() -> None:
    part = Part(CHAIN, nodes=["wet"])
    tick = Tick(below=("slip", "world"), above=("rain",))
    message = np.array([[0.0, 0.5], [0.0, 1.0]])  # slip is seen: only where it is wet
    below = (evidence(), {"from": "slip", "age": 1, "diagnostic": {"slip": {"wet": message}}})
    support = ({"from": "rain", "support": {"wet": {"rain": np.array([[0.7, 0.6], [0, -1]])}}},)  # 0.7 and 0.3
    belief = told(part, part.initial_belief(), epoch_below=below, above=support, tick=tick)
    assert part.posteriors(belief)["wet"].tolist() == [0.0, 1.0]
    # φ: M·L; ϱ: what is known but by slip itself
    (up,) = diagnostic_support(belief, tick=Tick(below=("wet",), above=("rain",)))
    np.testing.assert_allclose(normal(up["diagnostic"]["wet"]["rain"]), np.array([0.1, 0.8]) / 0.9, rtol=1e-15)
    (down,) = causal_support(belief, tick=Tick(below=("slip",), above=("wet",)))
    np.testing.assert_allclose(normal(down["support"]["slip"]["wet"]), [0.69, 0.31], rtol=1e-15)
    assert causal_support(belief, tick=Tick(below=("other",), above=("wet",))) == ({"from": "wet", "support": {}},)


def normal(message: np.ndarray) -> np.ndarray:
    numbers = np.ldexp(message[0], message[1].astype(int))
    return numbers / numbers.sum()


def test_a_slot_is_kept_until_its_sender_is_gone() -> None:
    part = Part(CHAIN, nodes=["rain", "wet"])
    both = Tick(below=("slip", "world"))
    message = {"from": "slip", "age": 1, "diagnostic": {"slip": {"wet": np.array([[0.0, 0.5], [0.0, 1.0]])}}}
    belief = told(part, part.initial_belief(), epoch_below=(message,), tick=both)
    assert part.posteriors(belief)["wet"].tolist() == [0.0, 1.0]
    belief = told(part, belief, epoch_below=(evidence(),), tick=both)  # slip has said nothing in this epoch
    assert part.posteriors(belief)["wet"].tolist() == [0.0, 1.0]
    belief = told(part, belief, epoch_below=(evidence(),), tick=Tick(below=("world",)))  # slip is detached
    np.testing.assert_allclose(part.posteriors(belief)["wet"], [0.69, 0.31], rtol=1e-15)
    assert belief["below"] == {}


def test_evidence_is_retracted_by_leaving_it_out() -> None:
    part = Part(CHAIN)
    tick = Tick(below=("world",))
    belief = told(part, part.initial_belief(), epoch_below=(evidence(slip=1, rain=(1.0, 0.0)),), tick=tick)
    np.testing.assert_allclose(part.posteriors(belief)["rain"], [1.0, 0.0])
    belief = told(part, belief, epoch_below=(evidence(),), tick=tick)
    np.testing.assert_allclose(part.posteriors(belief)["rain"], [0.7, 0.3], rtol=1e-15)


def test_without_a_parent_above_its_support_is_ones() -> None:
    part = Part(CHAIN, nodes=["wet", "slip"])
    support = ({"from": "rain", "support": {"wet": {"rain": np.array([[0.5, 0.0], [1, 0]])}}},)
    attached = Tick(below=("world",), above=("rain",))
    belief = told(part, part.initial_belief(), epoch_below=(evidence(),), above=support, tick=attached)
    np.testing.assert_allclose(part.posteriors(belief)["wet"], [0.9, 0.1], rtol=1e-15)
    belief = told(part, belief, epoch_below=(evidence(),), tick=Tick(below=("world",)))
    np.testing.assert_allclose(part.posteriors(belief)["wet"], [0.55, 0.45], rtol=1e-15)


def test_impossible_evidence_names_the_node() -> None:
    tick = Tick(below=("world",))
    seen = (evidence(slip=1, wet=0),)
    part = Part(CHAIN)
    with pytest.raises(ImpossibleEvidence, match="no state of node 'wet'"):
        part.observe(seen, part.initial_belief(), tick=tick)


def test_where_contradictions_are_no_errors_posteriors_are_0_until_they_pass() -> None:
    tick = Tick(below=("world",))
    part = Part(CHAIN, settle=None)
    belief = told(part, part.initial_belief(), epoch_below=(evidence(slip=1, wet=0),), tick=tick)
    assert belief["impossible"] == "wet"
    assert not belief["posterior"].any()
    assert part.metrics(belief)["impossible"] == 1.0
    belief = told(part, belief, epoch_below=(evidence(slip=1),), tick=tick)
    assert belief["impossible"] == ""
    assert part.posteriors(belief)["wet"].tolist() == [0.0, 1.0]


def test_a_belief_travels() -> None:
    part = Part(CHAIN, nodes=["wet"])
    belief = told(part, part.initial_belief(), epoch_below=(evidence(wet=1),), tick=Tick(below=("world",)))
    again = decode_value(encode_value(belief))
    assert encode_value(again) == encode_value(belief)
    tick = Tick(below=("world",), above=("rain",))
    one, other = (encode_value(told(part, each, epoch_below=(evidence(),), tick=tick)) for each in (belief, again))
    assert one == other


def test_operators_change_nothing_that_they_were_given() -> None:
    part = Part(CHAIN, nodes=["rain", "wet"])
    tick = Tick(below=("slip", "world"))
    message = {"from": "slip", "age": 1, "diagnostic": {"slip": {"wet": np.array([[0.5, 0.5], [0.0, 1.0]])}}}
    belief = told(part, part.initial_belief(), epoch_below=(message, evidence(wet=(0.1, 0.9))), tick=tick)
    before = encode_value(belief)
    first = encode_value(told(part, belief, epoch_below=(message,), tick=tick))
    told(part, part.initial_belief(), epoch_below=(evidence(rain=0),), tick=tick)
    assert encode_value(belief) == before
    assert encode_value(told(part, belief, epoch_below=(message,), tick=tick)) == first


def test_a_part_takes_over_what_another_has_heard() -> None:
    tick = Tick(below=("slip", "world"))
    message = {"from": "slip", "age": 1, "diagnostic": {"slip": {"wet": np.array([[0.5, 0.5], [0.0, 1.0]])}}}
    one = Part(CHAIN, nodes=["rain", "wet"])
    belief = told(one, one.initial_belief(), epoch_below=(message, evidence(rain=0)), tick=tick)
    other = Part([{**CHAIN[0], "prior": [0.1, 0.9]}, *CHAIN[1:]], nodes=["wet", "rain"])
    taken = other.take_over(belief)
    assert (taken["evidence"], list(taken["below"])) == (belief["evidence"], ["slip"])
    np.testing.assert_allclose(other.posteriors(taken)["rain"], [1.0, 0.0])
    with pytest.raises(ValueError, match="belief: expected that of a part of a causal tree"):
        other.take_over({"posterior": 1})


def test_small_parts_tell_their_posteriors_as_metrics() -> None:
    part = Part(CHAIN, nodes=["rain"])
    assert part.metrics(part.initial_belief()) == {"rain=0": 0.7, "rain=1": 0.3}
    large = random_network(1, 30)
    assert Part(large).metrics(Part(large).initial_belief()) == {}


def test_a_part_is_no_larger_than_the_numbers_in_it() -> None:
    small = [{"id": f"s{number}", "states": 2, "prior": [0.25, 0.75]} for number in range(3)]
    part = Part([*small, {"id": "wide", "states": 65_536, "prior": np.full(65_536, 1 / 65_536)}], settle=None)
    tick = Tick(below=("world",))
    belief = told(part, part.initial_belief(), epoch_below=(evidence(wide=7),), tick=tick)
    found = part.posteriors(belief)
    assert (belief["posterior"].shape, found["wide"][7], found["wide"].sum()) == ((1, 65_542), 1.0, 1.0)
    assert found["s2"].tolist() == [0.25, 0.75]
    belief = told(part, belief, epoch_below=(evidence(s0=(0.0, 0.0)),), tick=tick)
    assert [row.any() for row in part.posteriors(belief).values()] == [False] * 4


def test_nodes_with_equally_many_states_have_a_row_each() -> None:
    belief = Part(CHAIN).initial_belief()
    np.testing.assert_allclose(belief["posterior"], [[0.7, 0.3], [0.69, 0.31], [0.876, 0.124]], rtol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"nodes": ["snow"]}, "nodes: there is no node 'snow'"),
        ({"nodes": []}, "nodes: expected a list of at least one"),
        ({"nodes": "rain"}, "nodes: expected a list of at least one, got 'rain'"),
        ({"nodes": ["wet", "wet"]}, "nodes: one is there twice"),
        ({"nodes": ["wet"], "top": "wet"}, "nodes: expected either nodes or top, got both"),
        ({"top": "snow"}, "tops: there is no node 'snow'"),
        ({"top": "wet", "tops": ["rain"]}, "top: 'wet' is none of the tops, 'rain'"),
        ({"settle": 0}, "settle: expected a number of epochs, at least 1, or null, got 0"),
    ],
)
def test_wrong_parameters(parameters: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        Part(CHAIN, **parameters)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (evidence(wet=(1.0,)), "evidence for wet: expected 2 likelihoods, got 1"),
        (evidence(wet=2), "evidence for wet: expected a state from 0 to 1, got 2"),
        (evidence(wet=(-1.0, 1.0)), "evidence for wet: expected finite numbers of at least 0, got (-1.0, 1.0)"),
        (evidence(wet=(math.nan, 1.0)), "evidence for wet: expected finite numbers of at least 0, got (nan, 1.0)"),
        (evidence(wet=(1.0, math.inf)), "evidence for wet: expected finite numbers of at least 0, got (1.0, inf)"),
        ({"from": "slip", "age": 1, "diagnostic": {"slip": {"wet": np.ones((2, 3))}}}, "a message about wet: expected"),
    ],
)
def test_messages_that_do_not_fit(observation: Any, message: str) -> None:
    part = Part(CHAIN, nodes=["wet"])
    with pytest.raises(ValueError, match=re.escape(message)):
        part.observe((observation,), part.initial_belief(), tick=Tick(below=("slip", "world")))


def test_tops_share_a_network_out() -> None:
    network = random_network(12, 20)
    root = next(entry["id"] for entry in network if not entry["parents"])
    tops = [root, network[3]["id"], network[8]["id"]]
    parts = [Part(network, top=top, tops=tops).nodes for top in dict.fromkeys(tops)]
    assert sorted(itertools.chain(*parts)) == sorted(entry["id"] for entry in network)
