"""What the paper's appendix prints about causal trees, what is off in it, and that the corrected form is exact.

`propagate` is the construction by itself, with each printed reading to be switched on alone. Every test shows on random
trees that one reading is off; the corrected one is held against enumeration.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

Vectors = dict[str, np.ndarray]
SEEDS = range(200)


class Tree:
    """A random tree with evidence at some nodes."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.names = [f"n{number}" for number in range(int(rng.integers(3, 8)))]
        self.size = int(rng.integers(2, 4))
        self.parent = {name: f"n{rng.integers(number)}" for number, name in enumerate(self.names) if number}
        self.table = {name: rng.dirichlet(np.ones(self.size), self.size) for name in self.parent}
        self.prior = rng.dirichlet(np.ones(self.size))
        self.evidence = {name: rng.random(self.size) for name in self.names if rng.random() < 0.5}

    def children(self, name: str) -> list[str]:
        return [child for child, parent in self.parent.items() if parent == name]

    def enumerated(self) -> Vectors:
        """All posteriors, by adding up all states of all nodes."""
        found = {name: np.zeros(self.size) for name in self.names}
        for states in itertools.product(range(self.size), repeat=len(self.names)):
            at = dict(zip(self.names, states, strict=True))
            weight = self.prior[at["n0"]]
            for child, parent in self.parent.items():
                weight *= self.table[child][at[parent], at[child]]
            for name, likelihoods in self.evidence.items():
                weight *= likelihoods[at[name]]
            for name, state in at.items():
                found[name][state] += weight
        return {name: row / row.sum() for name, row in found.items()}


def propagate(
    tree: Tree,
    *,
    missing_evidence: float = 1.0,
    evidence_in_belief: bool = True,
    evidence_in_context: bool = True,
    own_slot_in_context: bool = False,
    start: np.ndarray | None = None,
    root_support: Callable[[Tree], np.ndarray] | None = None,
    silent: tuple[str, ...] = (),
    padded: bool = False,
) -> Vectors:
    """One Update, up and down.

    Args:
        missing_evidence: what stands in d_E where there is no evidence.
        evidence_in_belief: whether BEL contains d_E.
        evidence_in_context: whether the context contains d_E.
        own_slot_in_context: whether the context for a child contains what that child said.
        start: the initial diagnostic vector d of the state ⟨⟨d, …, d⟩, c⟩; by default ones.
        root_support: the root's c; by default its prior.
        silent: children that report nothing in this epoch.
        padded: slots are filled by adding up vectors padded with zeros, in place of replacing those reported.
    """
    ones = np.ones(tree.size)
    d_e = {name: tree.evidence.get(name, missing_evidence * ones) for name in tree.names}
    before = np.zeros(tree.size) if padded else ones if start is None else start
    slots = dict.fromkeys(tree.parent, before)
    total: Vectors = {}
    for name in reversed(tree.names):
        total[name] = np.prod([d_e[name], *(slots[child] for child in tree.children(name))], axis=0)
        if name in tree.parent and name not in silent:
            slots[name] = tree.table[name] @ total[name]
    support = {"n0": tree.prior if root_support is None else root_support(tree)}
    beliefs = {}
    for name in tree.names:
        if name in tree.parent:
            upper = tree.parent[name]
            others = [slots[child] for child in tree.children(upper) if own_slot_in_context or child != name]
            own = d_e[upper] if evidence_in_context else ones
            support[name] = np.prod([own, support[upper], *others], axis=0) @ tree.table[name]
        rest = np.prod([ones, *(slots[child] for child in tree.children(name))], axis=0)
        beliefs[name] = support[name] * (total[name] if evidence_in_belief else rest)
    return {name: row / row.sum() if row.sum() > 0 else row for name, row in beliefs.items()}


def wrong(found: Vectors, exact: Vectors) -> bool:
    return max(float(np.abs(found[name] - exact[name]).max()) for name in exact) > 1e-3


def off(**reading: Any) -> int:
    """On how many of the random trees a reading is off."""
    return sum(wrong(propagate(tree, **reading), tree.enumerated()) for tree in map(Tree, SEEDS))


def test_the_corrected_construction_is_exact() -> None:
    worst = 0.0
    for seed in SEEDS:
        tree = Tree(seed)
        found, exact = propagate(tree), tree.enumerated()
        worst = max(worst, *(float(np.abs(found[name] - exact[name]).max()) for name in exact))
    assert worst < 5e-15


def test_padded_vectors_add_up_only_where_every_slot_reports() -> None:
    assert off(padded=True) == 0
    for seed in SEEDS:
        tree = Tree(seed)
        silent = tree.names[-1]  # a leaf that has nothing to say
        tree.evidence.pop(silent, None)
        exact = tree.enumerated()
        assert not wrong(propagate(tree, silent=(silent,)), exact), seed
        assert wrong(propagate(tree, silent=(silent,), padded=True), exact), seed


def test_missing_evidence_must_be_ones() -> None:
    assert off(missing_evidence=0.0) == sum(len(Tree(seed).evidence) < len(Tree(seed).names) for seed in SEEDS)


def test_the_belief_must_contain_the_nodes_own_evidence() -> None:
    assert off(evidence_in_belief=False) > 150


def test_the_context_must_contain_the_upper_nodes_own_evidence() -> None:
    assert off(evidence_in_context=False) > 80


def test_the_context_must_leave_out_the_childs_own_slot() -> None:
    assert off(own_slot_in_context=True) > 120


def test_an_initial_state_with_d_in_every_slot_counts_it_once_for_each_child() -> None:
    def beliefs(count: int) -> np.ndarray:
        """Of a root with so many children, before any of them has reported."""
        tree = Tree(3)
        tree.names = [f"n{number}" for number in range(count + 1)]
        tree.parent = dict.fromkeys(tree.names[1:], "n0")
        tree.table = dict.fromkeys(tree.names[1:], np.eye(tree.size))
        tree.evidence = {}
        tree.prior = np.full(tree.size, 1 / tree.size)
        d = np.linspace(0.2, 0.8, tree.size)
        found = propagate(tree, start=d, silent=tuple(tree.names[1:]))["n0"]
        np.testing.assert_allclose(found, d**count * tree.prior / (d**count * tree.prior).sum())
        return found

    assert np.abs(beliefs(1) - beliefs(3)).max() > 0.1


def test_the_roots_support_must_be_its_prior() -> None:
    """Equal beliefs at the start are not enough: d∘c can be the prior with another c, until the slots are replaced."""
    d = np.array([0.3, 0.9])
    trees = [tree for tree in map(Tree, SEEDS) if tree.size == 2 and tree.children("n0")]
    shifted = [propagate(tree, root_support=lambda tree: tree.prior / d) for tree in trees]
    for tree in trees:
        np.testing.assert_allclose(d * (tree.prior / d), tree.prior)
    assert sum(wrong(found, tree.enumerated()) for found, tree in zip(shifted, trees, strict=True)) == len(trees)


@pytest.mark.parametrize("seed", range(10))
def test_the_parts_of_hierax_say_the_same(seed: int) -> None:
    from hierax.nodes.causal_tree import posteriors

    tree = Tree(seed)
    network: list[dict[str, Any]] = [{"id": "n0", "states": tree.size, "prior": tree.prior.tolist()}]
    network += [
        {"id": name, "states": tree.size, "parents": [parent], "cpt": tree.table[name].tolist()}
        for name, parent in tree.parent.items()
    ]
    assert not wrong(posteriors(network, tree.evidence), propagate(tree))
