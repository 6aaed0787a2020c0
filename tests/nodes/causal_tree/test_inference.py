"""Posteriors in one process: random and trap networks against 60 digits, and everything that would underflow."""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import mpmath
import numpy as np
import pytest
from support.exact_networks import elimination, random_evidence, random_network

from hierax.nodes.causal_tree import EvidenceError, ImpossibleEvidence, Inference, posteriors, random_tree
from hierax.nodes.causal_tree import inference as inference_module

CLOSE = 1e-12
RAIN = [
    {"id": "wet", "states": 2, "parents": ["rain"], "cpt": [[0.9, 0.1], [0.2, 0.8]]},
    {"id": "rain", "states": ["no", "yes"], "parents": [], "prior": [0.7, 0.3]},
]


def error(found: Any, exact: Any) -> float:
    return max(
        float(abs(mpmath.mpf(float(a)) - b)) for name in exact for a, b in zip(found[name], exact[name], strict=True)
    )


def check(network: Any, evidence: Any, inference: Inference, what: object) -> bool:
    """Whether the evidence is possible; and that this is said, and the posteriors are right."""
    exact = elimination(network, evidence)
    if exact is None:
        with pytest.raises(ImpossibleEvidence) as caught:
            inference.update(evidence)
        assert caught.value.node in {entry["id"] for entry in network}, what
        return False
    found = inference.update(evidence)
    assert list(found) == [entry["id"] for entry in network], what
    assert error(found, exact) < CLOSE, what
    return True


@pytest.mark.parametrize("polytree", [False, True])
def test_random_networks_with_traps(polytree: bool) -> None:
    possible = 0
    for seed in range(90):
        rng = np.random.default_rng([seed, 7])
        network = random_network(seed, int(rng.integers(1, 14)), polytree)
        inference = Inference(network)
        for number in range(3):
            possible += check(network, random_evidence(network, rng), inference, f"seed {seed}, set {number}")
    assert 100 < possible < 270  # of both kinds enough


@pytest.mark.parametrize("polytree", [False, True])
def test_the_extended_sweep_agrees_with_the_one_in_float64(polytree: bool) -> None:
    rng = np.random.default_rng(5)
    ways = {True: 0, False: 0}
    for seed in range(30):
        network = random_network(seed, 30, polytree)
        inference = Inference(network)
        evidence = {entry["id"]: rng.random(entry["states"]) + 1e-3 for entry in network if rng.random() < 0.5}
        found = inference.update(evidence)
        ways[inference._sweep.is_extended] += 1
        log = inference.log_evidence
        inference._sweep._float64._least_log2 = -math.inf
        again = inference.update(evidence)
        assert inference._sweep.is_extended, seed
        assert inference.log_evidence == pytest.approx(log, rel=1e-12, abs=1e-12)
        assert max(float(np.abs(found[name] - again[name]).max()) for name in found) < CLOSE, seed
    assert min(ways.values()) > 3


def test_ordinary_networks_go_the_quick_way() -> None:
    network = random_tree(300, 3, seed=2)
    inference = Inference(network)
    inference.update({f"n{number}": [0, 1, 0] for number in range(150, 300, 3)})
    assert not inference._sweep.is_extended


def star(tables: Any, prior: list[float]) -> list[dict[str, Any]]:
    """A hub, and a leaf of two states for each table."""
    leaves = [{"id": f"leaf{i}", "states": 2, "parents": ["hub"], "cpt": table} for i, table in enumerate(tables)]
    return [{"id": "hub", "states": len(prior), "prior": prior}, *leaves]


def test_a_star_of_2000_leaves() -> None:
    rng = np.random.default_rng(3)
    tables = rng.dirichlet([0.2, 0.2], (2000, 3))
    prior = [1 - 2e-12, 1e-12, 1e-12]
    network = star(tables.tolist(), prior)
    states = rng.integers(0, 2, 2000)
    found = posteriors(network, {f"leaf{i}": np.eye(2)[states[i]] for i in range(2000)})
    hub = [mpmath.mpf(p) * mpmath.fprod(tables[i][s][states[i]] for i in range(2000)) for s, p in enumerate(prior)]
    whole = mpmath.fsum(hub)
    for value, right in zip(found["hub"], hub, strict=True):
        assert abs(value - right / whole) < CLOSE


def test_what_2000_leaves_all_but_rule_out_is_still_possible() -> None:
    # 2000 leaves favour state 0 by a factor of 10^1900; a further one rules it out
    tables = [[[0.9, 0.1], [0.1, 0.9], [0.1, 0.9]]] * 2000 + [[[1.0, 0.0], [0.5, 0.5], [0.25, 0.75]]]
    network = star(tables, [0.5, 0.25, 0.25])
    evidence: dict[str, list[float]] = {f"leaf{i}": [1, 0] for i in range(2000)}
    assert posteriors(network, evidence)["hub"].tolist() == [1.0, 0.0, 0.0]
    inference = Inference(network)
    found = inference.update({**evidence, "leaf2000": [0, 1]})
    np.testing.assert_allclose(found["hub"], [0.0, 0.4, 0.6], atol=CLOSE)
    wanted = 2000 * mpmath.log(mpmath.mpf(0.1)) + mpmath.log(0.25 * 0.5 + 0.25 * 0.75)
    assert inference.log_evidence == pytest.approx(float(wanted), rel=1e-13)
    with pytest.raises(ImpossibleEvidence) as caught:
        inference.update({**evidence, "leaf2000": [0, 1], "hub": [1, 0, 0]})
    assert caught.value.node == "hub"


def test_a_chain_of_3000() -> None:
    rng = np.random.default_rng(11)
    size, count = 3, 3000
    tables = rng.dirichlet([0.3] * size, (count, size))
    network = [{"id": "x0", "states": size, "prior": [1 - 1e-12, 1e-12, 0.0]}]
    network += [
        {"id": f"x{i}", "states": size, "parents": [f"x{i - 1}"], "cpt": tables[i].tolist()} for i in range(1, count)
    ]
    evidence = {f"x{i}": (10.0 ** rng.uniform(-300, 300, size)).tolist() for i in range(0, count, 3)}
    found = posteriors(network, evidence)
    forward, backward = chain(network, evidence)
    for place in range(count):
        both = [a * b for a, b in zip(forward[place], backward[place], strict=True)]
        for value, right in zip(found[f"x{place}"], both, strict=True):
            assert abs(value - right / mpmath.fsum(both)) < CLOSE, place


def chain(network: Any, evidence: Any) -> tuple[list[Any], list[Any]]:
    """Forward and backward, in 60 digits."""
    tables = [[[mpmath.mpf(p) for p in row] for row in entry["cpt"]] for entry in network[1:]]
    seen = [[mpmath.mpf(p) for p in evidence.get(entry["id"], [1.0] * 3)] for entry in network]
    forward = [[mpmath.mpf(p) * s for p, s in zip(network[0]["prior"], seen[0], strict=True)]]
    for table, own in zip(tables, seen[1:], strict=True):
        last = forward[-1]
        forward.append([own[b] * mpmath.fsum(last[a] * table[a][b] for a in range(3)) for b in range(3)])
    backward = [[mpmath.mpf(1)] * 3]
    for table, own in zip(reversed(tables), reversed(seen[1:]), strict=True):
        last = backward[-1]
        backward.append([mpmath.fsum(table[a][b] * own[b] * last[b] for b in range(3)) for a in range(3)])
    return forward, backward[::-1]


def test_deep_rules_without_doubt() -> None:
    # each node is its parent's next state; the last one's evidence is the first one's
    shift = np.roll(np.eye(4), 1, axis=1).tolist()
    network: list[dict[str, Any]] = [{"id": "x0", "states": 4, "prior": [0.25, 0.25, 0.5, 0.0]}]
    network += [{"id": f"x{i}", "states": 4, "parents": [f"x{i - 1}"], "cpt": shift} for i in range(1, 2001)]
    inference = Inference(network)
    assert inference.update({"x2000": [1, 1, 0, 0]})["x0"].tolist() == [0.5, 0.5, 0.0, 0.0]
    with pytest.raises(ImpossibleEvidence, match="leaves no state of node 'x0'"):
        inference.update({"x2000": [0, 0, 0, 1]})
    assert inference.update({})["x1"].tolist() == [0.0, 0.25, 0.25, 0.5]


@pytest.mark.parametrize("scale", [5e-324, 1e-320, 1e-300, 1.0, 1e300, 1.7e308])
def test_the_scale_of_likelihoods_means_nothing(scale: float) -> None:
    inference = Inference(RAIN)
    found = inference.update({"wet": [0, scale]})
    np.testing.assert_allclose(found["rain"], [0.07 / 0.31, 0.24 / 0.31], atol=1e-15)
    assert inference.log_evidence == pytest.approx(math.log(0.31) + math.log(scale), rel=1e-14)


def test_likelihoods_may_be_further_apart_than_float64_can_tell() -> None:
    found = posteriors(RAIN, {"wet": [1e308, 1e-308], "rain": [5e-324, 1e308]})
    assert found["rain"].tolist() == [0.0, 1.0]
    found = posteriors(RAIN, {"wet": [1e-308, 1e308], "rain": [1e308, 1e-308]})
    assert found["wet"].tolist() == [0.0, 1.0]


def test_evidence_left_out_is_retracted() -> None:
    inference = Inference(RAIN)
    before = inference.update({})
    inference.update({"wet": [0, 1], "rain": [1, 0]})
    after = inference.update({})
    assert [row.tolist() for row in before.values()] == [row.tolist() for row in after.values()]
    np.testing.assert_allclose(before["wet"], [0.69, 0.31], atol=1e-15)
    assert inference.log_evidence == pytest.approx(0.0, abs=1e-15)


def test_what_was_given_out_stays() -> None:
    inference = Inference(RAIN)
    first = inference.update({"wet": [0, 1]})
    kept = {name: row.copy() for name, row in first.items()}
    inference.update({"wet": [1, 0]})
    for name, row in kept.items():
        np.testing.assert_array_equal(first[name], row)
        assert not first[name].flags.writeable


@pytest.mark.parametrize(
    ("evidence", "node"),
    [
        ({"wet": [0, 0]}, "wet"),
        ({"rain": [0.0, 0.0]}, "rain"),
        ({"wet": [0, 0], "rain": [1, 0]}, "wet"),
    ],
)
def test_evidence_without_a_state_is_impossible(evidence: Any, node: str) -> None:
    with pytest.raises(ImpossibleEvidence) as caught:
        posteriors(RAIN, evidence)
    assert caught.value.node == node


def test_impossible_evidence_leaves_nothing_behind() -> None:
    inference = Inference(RAIN)
    with pytest.raises(ImpossibleEvidence):
        inference.update({"rain": [0, 0]})
    with pytest.raises(ValueError, match="no posteriors yet"):
        _ = inference.log_evidence
    np.testing.assert_allclose(inference.update({})["rain"], [0.7, 0.3], atol=1e-15)


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        ({"snow": [1, 0]}, "evidence for 'snow': there is no such node"),
        ({"wet": [1, 0, 0]}, "evidence for 'wet': expected 2 likelihoods, one for each state, got [1, 0, 0]"),
        ({"rain": [1], "wet": [1, 0, 0]}, "evidence for 'rain': expected 2 likelihoods"),
        ({"wet": 1}, "evidence for 'wet': expected 2 likelihoods"),
        ({"wet": ["0", "1"]}, "evidence for 'wet': expected 2 likelihoods"),
        ({"wet": [[1, 0]]}, "evidence for 'wet': expected 2 likelihoods"),
        ({"rain": [1, 0], "wet": [1, -1]}, "evidence for 'wet': expected finite numbers of at least 0, got -1"),
        (
            {"wet": [1, float("nan")], "rain": [1, 0]},
            "evidence for 'wet': expected finite numbers of at least 0, got nan",
        ),
        ({"wet": [float("inf"), 1]}, "evidence for 'wet': expected finite numbers of at least 0, got inf"),
    ],
)
def test_what_is_no_evidence_is_refused(evidence: Any, message: str) -> None:
    with pytest.raises(EvidenceError, match=re.escape(message)):
        posteriors(RAIN, evidence)


def test_log_evidence_against_60_digits() -> None:
    rng = np.random.default_rng(8)
    for seed in range(20):
        network = random_network(seed, 6, polytree=bool(seed % 2))
        inference = Inference(network)
        evidence = {entry["id"]: rng.random(entry["states"]) * 1e-200 for entry in network}
        inference.update(evidence)
        assert inference.log_evidence == pytest.approx(float(mpmath.log(enumerated(network, evidence))), rel=1e-13), (
            seed
        )


def enumerated(network: Any, evidence: Any) -> Any:
    """The probability of evidence at all nodes, by adding up all states of all nodes."""
    names = [entry["id"] for entry in network]
    whole = mpmath.mpf(0)
    for states in np.ndindex(*(int(entry["states"]) for entry in network)):
        chosen = dict(zip(names, states, strict=True))
        product = mpmath.mpf(1)
        for entry in network:
            table = np.array(entry["cpt"] if entry["parents"] else entry["prior"])
            own = chosen[entry["id"]]
            product *= mpmath.mpf(table[(*(chosen[parent] for parent in entry["parents"]), own)])
            product *= mpmath.mpf(evidence[entry["id"]][own])
        whole += product
    return whole


def test_several_networks_side_by_side() -> None:
    network = [*RAIN, {"id": "dice", "states": 6, "prior": [1 / 6] * 6}]
    inference = Inference(network)
    found = inference.update({"dice": [0, 1, 0, 1, 0, 1], "wet": [0, 1]})
    np.testing.assert_allclose(found["dice"], [0, 1 / 3, 0, 1 / 3, 0, 1 / 3], atol=1e-15)
    assert inference.log_evidence == pytest.approx(math.log(0.31 * 0.5), rel=1e-14)


def test_against_pyagrum() -> None:
    with warnings.catch_warnings():  # where they are errors, those of its import end the process
        warnings.simplefilter("ignore")
        gum = pytest.importorskip("pyagrum")
    from hierax.nodes.causal_tree.bif import description_of

    for seed in range(25):
        gum.initRandom(seed + 1)
        rng = np.random.default_rng(seed)
        network = random_network(seed, 12, polytree=bool(seed % 2))
        net = gum.BayesNet()
        for entry in network:
            if entry["states"] > 1:
                net.add(gum.RangeVariable(entry["id"], "", 0, entry["states"] - 1))
        names = set(net.names())
        for entry in network:
            for parent in entry["parents"]:
                if {parent, entry["id"]} <= names:
                    net.addArc(parent, entry["id"])
        net.generateCPTs()
        lazy = gum.LazyPropagation(net)
        evidence = {name: rng.random(net.variable(name).domainSize()).tolist() for name in names if rng.random() < 0.5}
        lazy.setEvidence(evidence)
        lazy.makeInference()
        found = posteriors(description_of(net), evidence)
        for name, row in found.items():
            assert np.abs(row - lazy.posterior(name).toarray()).max() < 1e-9, (seed, name)


def test_memory_is_linear_in_the_nodes() -> None:
    import tracemalloc

    sizes = []
    for nodes in (2000, 8000):
        network = inference_module.parse(random_tree(nodes, 4, seed=1))
        tracemalloc.start()
        inference = Inference(network)
        inference.update({"n7": [0, 0, 1, 0]})
        sizes.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert sizes[1] < 4.6 * sizes[0]
    assert sizes[1] < 8000 * 6000
