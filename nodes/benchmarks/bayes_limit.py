"""Belief propagation in a tree with nothing around it: as quick as numpy can, and as exact."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Limit:
    """Level by level in float64, for a tree whose nodes have equally many states.

    Nothing is checked: no evidence, no underflow, no impossible evidence; what is 0 divides by 0.

    Args: network: each parent stands before its children.
    """

    def __init__(self, network: Sequence[Mapping[str, Any]]) -> None:
        parents = {entry["id"]: entry["parents"][0] if entry["parents"] else "" for entry in network}
        depth: dict[str, int] = {}
        for name, parent in parents.items():
            depth[name] = depth[parent] + 1 if parent else 0
        # children of one parent stand side by side, parents in their own order
        levels: list[list[str]] = [[] for _ in range(max(depth.values()) + 1)]
        for name in parents:
            levels[depth[name]].append(name)
        self._place: dict[str, int] = {}
        for names in levels:
            names.sort(key=lambda name: self._place.get(parents[name], 0))
            self._place.update({name: len(self._place) + number for number, name in enumerate(names)})
        tables = {entry["id"]: entry.get("cpt", entry.get("prior")) for entry in network}
        self._prior = np.array(tables[levels[0][0]])
        self._levels = []
        for names in levels[1:]:
            table = np.ascontiguousarray(np.array([tables[name] for name in names]).transpose(1, 2, 0))
            above = np.array([self._place[parents[name]] for name in names])
            starts = np.flatnonzero(np.diff(above, prepend=-1))
            first = self._place[names[0]]
            self._levels.append((table, slice(first, first + len(names)), above, starts, above[starts]))
        self._up = np.ones((len(self._prior), len(network)))
        self._names = sorted(self._place, key=self._place.__getitem__)

    def __call__(self, evidence: Mapping[str, int]) -> dict[str, Floats]:
        """The posteriors by node."""
        columns = [self._place[name] for name in evidence]
        return dict(zip(self._names, self.beliefs(columns, list(evidence.values())).T, strict=True))

    def beliefs(self, columns: Sequence[int], states: Sequence[int]) -> Floats:
        """The posteriors as one array, shape (states, nodes)."""
        likelihood = np.ones_like(self._up)
        likelihood[:, columns] = 0.0
        likelihood[states, columns] = 1.0
        up = self._up
        for table, here, _, starts, tops in reversed(self._levels):
            sent = (table * likelihood[:, here]).sum(axis=1)
            sent /= sent.max(axis=0)
            up[:, here] = sent
            likelihood[:, tops] *= np.multiply.reduceat(sent, starts, axis=1)
        likelihood[:, 0] *= self._prior
        for table, here, above, _, _ in self._levels:
            sent = (table * (likelihood[:, above] / up[:, here])[:, None]).sum(axis=0)
            sent /= sent.max(axis=0)
            likelihood[:, here] *= sent
        likelihood /= likelihood.sum(axis=0)
        return likelihood


def reference(network: Sequence[Mapping[str, Any]], evidence: Mapping[str, int]) -> dict[str, Floats]:
    """Posteriors of a tree, node by node in the machine's longest floating-point numbers.

    Args: network: each parent stands before its children. evidence: by node, the number of its state.
    """
    tables = {entry["id"]: np.array(entry.get("cpt", entry.get("prior")), np.longdouble) for entry in network}
    parents = {entry["id"]: entry["parents"][0] if entry["parents"] else "" for entry in network}
    own = {name: np.ones(table.shape[-1], np.longdouble) for name, table in tables.items()}
    for name, state in evidence.items():
        own[name] = np.eye(len(own[name]), dtype=np.longdouble)[state]
    sent: dict[str, dict[str, Any]] = {name: {} for name in ("", *tables)}  # by parent, what its children tell it
    product = {}
    for name in reversed(tables):
        product[name] = math.prod(sent[name].values(), start=own[name])
        message = (tables[name] * product[name]).sum(axis=-1)
        sent[parents[name]][name] = message / message.max()
    support: dict[str, Any] = {}
    found = {}
    for name, parent in parents.items():
        support[name] = tables[name]
        if parent:
            siblings = (message for child, message in sent[parent].items() if child != name)
            rest = math.prod(siblings, start=support[parent] * own[parent])
            rest = (rest[:, None] * tables[name]).sum(axis=0)
            support[name] = rest / rest.max()
        belief = support[name] * product[name]
        found[name] = (belief / belief.sum()).astype(np.float64)
    return found
