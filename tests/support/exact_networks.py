"""Random networks with traps, and their posteriors in 60 digits by another algorithm: variable elimination."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import mpmath
import numpy as np

DIGITS = 60
mpmath.mp.dps = DIGITS

Description = list[dict[str, Any]]
Factor = tuple[tuple[Any, ...], np.ndarray]
"""Names of the axes, and an array of objects."""


def elimination(network: Sequence[Mapping[str, Any]], evidence: Mapping[Any, Any]) -> dict[Any, list[Any]] | None:
    """All posteriors, each by eliminating all other nodes; None where the evidence has probability 0."""
    sizes = {entry["id"]: _size(entry["states"]) for entry in network}
    factors: list[Factor] = []
    for entry in network:
        parents = tuple(entry.get("parents") or ())
        factors.append(((*parents, entry["id"]), _exact(entry["cpt"] if parents else entry["prior"])))
    factors += [((name,), _exact(vector)) for name, vector in evidence.items()]
    found = {}
    for query in sizes:
        total = _eliminated(factors, [name for name in sizes if name != query], query, sizes[query])
        norm = mpmath.fsum(total)
        if norm == 0:
            return None
        found[query] = [value / norm for value in total]
    return found


def random_network(seed: int, nodes: int, polytree: bool = False) -> Description:
    """A random tree or polytree: 1 to 4 states, tables with zeros, rows without doubt, priors of 1e-12, any order."""
    rng = np.random.default_rng(seed)
    zeros, sharp = rng.random(2) < 0.4
    parents: list[list[int]] = [[] for _ in range(nodes)]
    for node in range(1, nodes):
        other = int(rng.integers(max(0, node - 6), node))
        if polytree and rng.random() < 0.5 and len(parents[other]) < 3:
            parents[other].append(node)
        else:
            parents[node].append(other)
    sizes = rng.integers(1, 5, nodes) if rng.random() < 0.7 else np.full(nodes, rng.integers(2, 5))
    network = []
    for node in range(nodes):
        shape = (*(sizes[parent] for parent in parents[node]), sizes[node])
        table = _rows(rng, shape, bool(zeros), bool(sharp))
        entry: dict[str, Any] = {
            "id": f"n{node}",
            "states": int(sizes[node]),
            "parents": [f"n{p}" for p in parents[node]],
        }
        entry["cpt" if parents[node] else "prior"] = table.tolist()
        network.append(entry)
    return [network[place] for place in rng.permutation(nodes)]


def random_evidence(network: Description, rng: np.random.Generator) -> dict[str, list[float]]:
    """Hard, soft and far too small or large likelihoods at any nodes; mostly what can be."""
    states, can_be = _drawn(network, rng), rng.random() < 0.8
    evidence: dict[str, list[float]] = {}
    for entry in network:
        name, size, kind = entry["id"], _size(entry["states"]), rng.integers(10)
        state = states[name] if can_be else rng.integers(size)
        if kind <= 1:
            evidence[name] = np.eye(size)[state].tolist()
        elif kind == 2:
            evidence[name] = (rng.random(size) * 10.0 ** rng.choice([-320, -300, -20, 0, 300])).tolist()
        elif kind == 3:
            evidence[name] = (10.0 ** rng.uniform(-320, 300, size)).tolist()
        elif kind == 4:
            evidence[name] = (rng.random(size) * ((rng.random(size) < 0.5) | (np.arange(size) == state))).tolist()
    return evidence


def _drawn(network: Description, rng: np.random.Generator) -> dict[str, int]:
    """A state for each node that can all be together."""
    found: dict[str, int] = {}
    while len(found) < len(network):
        for entry in network:
            parents = entry["parents"]
            if entry["id"] not in found and all(parent in found for parent in parents):
                table = np.array(entry["cpt"] if parents else entry["prior"])
                row = table[tuple(found[parent] for parent in parents)]
                found[entry["id"]] = int(rng.choice(np.flatnonzero(row)))
    return found


def _rows(rng: np.random.Generator, shape: tuple[int, ...], zeros: bool, sharp: bool) -> np.ndarray:
    table = rng.random(shape)
    if zeros:
        table *= rng.random(shape) < 0.5
        table[..., 0] += (table.sum(axis=-1) == 0) * 1.0
    if sharp:
        table *= 10.0 ** -rng.integers(0, 13, shape)
    return table / table.sum(axis=-1, keepdims=True)


def _eliminated(factors: list[Factor], names: list[Any], query: Any, size: int) -> list[Any]:
    waiting = list(names)
    while waiting:
        counts = {name: len({axis for axes, _ in factors if name in axes for axis in axes}) for name in waiting}
        name = min(waiting, key=lambda each: counts[each])
        waiting.remove(name)
        touched = [factor for factor in factors if name in factor[0]]
        axes, array = functools.reduce(_times, touched)
        summed = (tuple(axis for axis in axes if axis != name), array.sum(axis=axes.index(name)))
        factors = [factor for factor in factors if name not in factor[0]] + [summed]
    scalars = [array for axes, array in factors if not axes]
    found = functools.reduce(_times, [factor for factor in factors if factor[0] == (query,)])[1]
    scale = functools.reduce(lambda a, b: a * b, [np.asarray(value, object).item() for value in scalars], mpmath.mpf(1))
    return [found[state] * scale for state in range(size)]


def _times(one: Factor, other: Factor) -> Factor:
    axes = (*one[0], *(axis for axis in other[0] if axis not in one[0]))
    return axes, _spread(one, axes) * _spread(other, axes)


def _spread(factor: Factor, axes: tuple[Any, ...]) -> np.ndarray:
    order = sorted(range(len(factor[0])), key=lambda place: axes.index(factor[0][place]))
    array = factor[1].transpose(order)
    lengths = dict(zip((factor[0][place] for place in order), array.shape, strict=True))
    return array.reshape([lengths.get(axis, 1) for axis in axes])


def _exact(numbers: Any) -> np.ndarray:
    plain = np.asarray(numbers, float)
    return np.array([mpmath.mpf(value) for value in plain.ravel()], object).reshape(plain.shape)


def _size(states: Any) -> int:
    return states if isinstance(states, int) else len(states)
