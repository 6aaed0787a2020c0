"""`hierax bench bayes`: exact inference in causal trees beside other libraries, on the same networks and evidence.

Times are of one update: an evidence set in, the posteriors of all nodes out; in CPU milliseconds of one thread, as
other processes share the processors. Errors are against node-by-node propagation in extended precision.
"""

from __future__ import annotations

import importlib
import statistics
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.benchmarks.bayes_limit import Limit, reference
from hierax.nodes.causal_tree import Inference, random_tree
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.plain import Json

STATES = 4
SHARE = 0.3
"""Of the leaves, that are observed."""

SETS = 12
SECONDS = 1.0
"""After so long in a round, no further update is made."""

Description = Sequence[Mapping[str, Any]]
Evidence = Mapping[str, int]
"""By node, the number of its state."""

Posteriors = Mapping[Any, NDArray[np.float64]]
Update = Callable[[Evidence], Posteriors]


class Rival(Protocol):
    """Takes a network, and gives what makes posteriors of evidence."""

    def __call__(self, network: Description) -> Update: ...


@dataclass(frozen=True)
class Cell:
    """One way on one network.

    Attributes:
        way: whose.
        nodes: of the network.
        update_ms: the median of the rounds' medians; None where there is none.
        error: the largest of any posterior.
        note: why there is no time.
    """

    way: str
    nodes: int
    update_ms: float | None
    error: float | None
    note: str = ""

    def plain(self) -> dict[str, Json]:
        """As plain JSON."""
        return {
            "way": self.way,
            "nodes": self.nodes,
            "update_ms": self.update_ms,
            "error": self.error,
            "note": self.note,
        }


OURS = "hierax"
LIMIT = "numpy, level by level"


def bench_bayes(sizes: Sequence[int], rounds: int, seed: int, told: Callable[[str], None]) -> list[Cell]:
    """Time all ways.

    Args:
        sizes: numbers of nodes.
        rounds: of all ways in turn.
        seed: of networks and evidence.
        told: told what is going on.
    """
    cells = []
    for nodes in sizes:
        network = random_tree(nodes, STATES, seed)
        sets = _evidence_sets(network, np.random.Generator(np.random.PCG64([seed, nodes])))
        exact = [reference(network, evidence) for evidence in sets]
        ways: dict[str, tuple[Rival, int]] = {OURS: (_ours, 10**9), LIMIT: (Limit, 10**9), **RIVALS}
        timings = [_Timing(way, rival, network, sets, most) for way, (rival, most) in ways.items()]
        for number in range(rounds):
            for timing in timings:
                told(f"{nodes} nodes, round {number + 1} of {rounds}: {timing.way}")
                timing.round(exact)
        cells += [timing.cell() for timing in timings]
    return cells


class _Timing:
    """One way on one network, over the rounds."""

    def __init__(self, way: str, rival: Rival, network: Description, sets: Sequence[Evidence], most: int) -> None:
        self.way = way
        self._sets = sets
        self._nodes = len(network)
        self._rounds_ms: list[float] = []
        self._error = 0.0
        self._note = f"left out: more than {most} nodes" if len(network) > most else ""
        self._network = network
        self._rival = rival
        self._update: Update | None = None

    def round(self, exact: Sequence[Posteriors]) -> None:
        """Update with the evidence sets, one after the other."""
        if self._note:
            return
        try:
            if self._update is None:
                self._update = self._rival(self._network)
                self._update(self._sets[0])
            times_ms = self._times_ms(self._update, exact)
        except ModuleNotFoundError as error:
            self._note = f"{error.name} is not installed"
        except HieraxError:
            raise
        except Exception as error:  # what rivals raise is theirs to know
            self._note = f"failed: {type(error).__name__}: {' '.join(str(error).split())[:60]}"
        else:
            self._rounds_ms.append(statistics.median(times_ms))

    def cell(self) -> Cell:
        """The rounds together."""
        if self._note or not self._rounds_ms:
            return Cell(self.way, self._nodes, None, None, self._note)
        return Cell(self.way, self._nodes, statistics.median(self._rounds_ms), self._error)

    def _times_ms(self, update: Update, exact: Sequence[Posteriors]) -> list[float]:
        times_ms: list[float] = []
        for evidence, wanted in zip(self._sets, exact, strict=True):
            begun = time.process_time()
            found = update(evidence)
            times_ms.append((time.process_time() - begun) * 1e3)
            self._error = max(self._error, *(float(np.abs(found[name] - row).max()) for name, row in wanted.items()))
            if sum(times_ms) > SECONDS * 1e3:
                break
        return times_ms


def _evidence_sets(network: Description, random: np.random.Generator) -> list[Evidence]:
    parents = {parent for entry in network for parent in entry["parents"]}
    leaves = [entry["id"] for entry in network if entry["id"] not in parents]
    return [{leaf: int(random.integers(STATES)) for leaf in leaves if random.random() < SHARE} for _ in range(SETS)]


def _ours(network: Description) -> Update:
    inference = Inference(network)
    vectors = np.eye(STATES)

    def update(evidence: Evidence) -> Posteriors:
        posteriors: Posteriors = inference.update({name: vectors[state] for name, state in evidence.items()})
        return posteriors

    return update


def _pyagrum(engine: str) -> Rival:
    def made(network: Description) -> Update:
        with warnings.catch_warnings():  # where they are errors, those of its import end the process
            warnings.simplefilter("ignore")
            gum = importlib.import_module("pyagrum")
        gum.setNumberOfThreads(1)
        net = gum.BayesNet()
        for entry in network:
            net.add(gum.RangeVariable(entry["id"], "", 0, STATES - 1))
        for entry in network:
            for parent in entry["parents"]:
                net.addArc(parent, entry["id"])
        for entry in network:
            net.cpt(entry["id"])[:] = entry["cpt"] if entry["parents"] else entry["prior"]
        inference = getattr(gum, engine)(net)
        names = [entry["id"] for entry in network]

        def update(evidence: Evidence) -> Posteriors:
            inference.eraseAllEvidence()
            inference.setEvidence(dict(evidence))
            inference.makeInference()
            return {name: inference.posterior(name).toarray() for name in names}

        return update

    return made


def _pgmpy(network: Description) -> Update:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cpds = importlib.import_module("pgmpy.factors.discrete")
        models = importlib.import_module("pgmpy.models")
        methods = importlib.import_module("pgmpy.inference")
    model = models.DiscreteBayesianNetwork()
    model.add_nodes_from([entry["id"] for entry in network])
    model.add_edges_from([(parent, entry["id"]) for entry in network for parent in entry["parents"]])
    for entry in network:
        if entry["parents"]:
            columns = np.array(entry["cpt"]).T
            cpd = cpds.TabularCPD(entry["id"], STATES, columns, evidence=entry["parents"], evidence_card=[STATES])
        else:
            cpd = cpds.TabularCPD(entry["id"], STATES, np.array(entry["prior"])[:, None])
        model.add_cpds(cpd)
    inference = methods.BeliefPropagation(model)
    names = [entry["id"] for entry in network]

    def update(evidence: Evidence) -> Posteriors:
        found: dict[str, Any] = {name: np.eye(STATES)[state] for name, state in evidence.items()}
        asked = [name for name in names if name not in evidence]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name in asked:  # of several at once it makes their joint distribution first
                found[name] = inference.query([name], evidence=dict(evidence), show_progress=False).values
        return found

    return update


RIVALS: Mapping[str, tuple[Rival, int]] = {
    "pyAgrum, lazy propagation": (_pyagrum("LazyPropagation"), 10**9),
    "pyAgrum, Shafer-Shenoy": (_pyagrum("ShaferShenoyInference"), 10**9),
    "pgmpy, belief propagation": (_pgmpy, 30),
}
"""By name: what makes them, and up to how many nodes an update ends within seconds."""
