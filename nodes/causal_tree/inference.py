"""Posteriors of a network in one process."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.errors import EvidenceError, ImpossibleEvidence, Name
from hierax.nodes.causal_tree.extended_floats import Floats, Inputs, extended
from hierax.nodes.causal_tree.network import Description, Network, parse
from hierax.nodes.causal_tree.networks import checked_vector
from hierax.nodes.causal_tree.plan import plan_of
from hierax.nodes.causal_tree.sweep import NothingLeftError, Sweep

Evidence = Mapping[Name, Any]
"""Likelihood vectors by node: P(what was seen | state) for each state, at any scale; a 1 among zeros says which
state it is. Nodes that are left out have no evidence."""


def posteriors(network: Description | Network, evidence: Evidence) -> dict[Name, Floats]:
    """All exact posteriors of a causal tree or polytree, as `parse` takes it: by node, in the order of the description,
    P(state | evidence), shape (states,), float64, read-only. Raises NetworkError: it is no network, or has a loop.
    EvidenceError: it is no evidence. ImpossibleEvidence: its probability is 0; names the node where this shows."""
    return Inference(network).update(evidence)


class Inference:
    """The posteriors of one network, as `parse` takes it, for a stream of evidence sets. For one thread at a time.
    Raises NetworkError: it is no network, or has a loop."""

    def __init__(self, network: Description | Network) -> None:
        self.network = parse(network)
        self._names = list(self.network.variables)
        self._numbers = {name: number for number, name in enumerate(self._names)}
        self._plan, _ = plan_of(self.network, self._names)
        self._sweep = Sweep(self._plan)
        self._sizes = np.array(self._plan.sizes, np.intp)
        self._given = False
        # whose the rows of all sizes are, one size after the other; and where each one's is
        places = np.argsort(np.concatenate(list(self._plan.members.values())))
        self._one_order = places if len(self._plan.members) == 1 else None
        self._places = places.tolist()

    def update(self, evidence: Evidence) -> dict[Name, Floats]:
        """All posteriors given an evidence set; what the last one said of a node that this one leaves out is retracted.
        What it takes, returns and raises is told at `posteriors`."""
        self._given = False
        inputs = self._inputs(evidence)
        try:
            self._sweep.up(inputs)
            self._sweep.down()
        except NothingLeftError as error:
            raise ImpossibleEvidence(self._names[error.variable]) from None
        self._given = True
        if self._one_order is not None:
            table = self._sweep.posteriors(self._plan.sizes[0]).take(self._one_order, axis=0)
            table.flags.writeable = False
            return dict(zip(self._names, table, strict=True))
        rows: list[Floats] = []
        for size in self._plan.members:
            table = np.ascontiguousarray(self._sweep.posteriors(size))
            table.flags.writeable = False
            rows.extend(table)
        return dict(zip(self._names, map(rows.__getitem__, self._places), strict=True))

    @property
    def log_evidence(self) -> float:
        """ln P(evidence) of the last update: of likelihood vectors at other scales, plus the logarithms of the scales.
        Raises ValueError: there was none, or its evidence was refused."""
        if not self._given:
            raise ValueError("there are no posteriors yet: call update with evidence that is possible")
        return self._sweep.log_evidence()

    def _inputs(self, evidence: Evidence) -> Inputs:
        """Evidence as columns, checked."""
        try:
            numbers = np.fromiter(map(self._numbers.__getitem__, evidence), np.intp, len(evidence))
        except (KeyError, TypeError):
            unknown = next(name for name in evidence if name not in self._numbers)
            raise EvidenceError("there is no such node", unknown) from None
        if not len(numbers):
            return ()
        vectors = list(evidence.values())
        flat = _flat(evidence, vectors, self._sizes[numbers])
        if len(self._plan.members) == 1:
            size = self._plan.sizes[0]
            return [(size, self._plan.columns[numbers], extended(flat.reshape(-1, size).T))]
        sizes = self._sizes[numbers]
        ends = np.cumsum(sizes)
        inputs = []
        for size in np.unique(sizes).tolist():
            which = np.flatnonzero(sizes == size)
            values = flat[(ends[which] - size) + np.arange(size)[:, None]]
            inputs.append((size, self._plan.columns[numbers[which]], extended(values)))
        return inputs


def _flat(evidence: Evidence, vectors: list[Any], sizes: np.ndarray[Any, np.dtype[np.intp]]) -> Floats:
    """All likelihoods one after the other; checked."""
    try:
        lengths = np.fromiter(map(len, vectors), np.intp, len(vectors))
        flat = np.asarray(np.concatenate(vectors))
        right = flat.dtype.kind in "fiub" and flat.ndim == 1 and bool((lengths == sizes).all())
    except (TypeError, ValueError):
        right = False
    if not (right and flat.min() >= 0 and flat.max() < np.inf):  # nor NaN
        return np.concatenate([checked_vector(*each) for each in zip(vectors, sizes, evidence, strict=True)])
    return flat.astype(np.float64, copy=False)
