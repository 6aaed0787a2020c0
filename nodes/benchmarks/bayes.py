"""`hierax bench bayes`: exact inference in causal trees beside other libraries, on the same networks and evidence.

Times are of one update: an evidence set in, the posteriors of all nodes out; in CPU milliseconds of one thread, as
other processes share the processors. Errors are against node-by-node propagation in extended precision."""

import math
import statistics
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hierax.nodes.causal_tree import Inference, random_tree
from hierax.nodes.causal_tree.bif import import_quietly
from hierax.runtime.core.errors import HieraxError

STATES = 4  # of each node
SHARE = 0.3  # of the leaves, that are observed
SETS = 12  # evidence sets
SECONDS = 1.0  # after so long in a round, no further update is made

Description = Sequence[Mapping[str, Any]]
Evidence = Mapping[str, int]  # by node, the number of its state
Floats = NDArray[np.float64]
Posteriors = Mapping[Any, Floats]
Update = Callable[[Evidence], Posteriors]
Rival = Callable[[Description], Update]

OURS = "hierax"
LIMIT = "numpy, level by level"


@dataclass(frozen=True)
class Cell:
    """One way on one network."""

    way: str  # whose
    nodes: int  # of the network
    update_ms: float | None  # the median of the rounds' medians; None where there is none
    error: float | None  # the largest of any posterior
    note: str = ""  # why there is no time


def bench_bayes(sizes: Sequence[int], rounds: int, seed: int, told: Callable[[str], None]) -> list[Cell]:
    """Time all ways, round by round, on random trees of these sizes; `told` is told what is going on."""
    cells = []
    for nodes in sizes:
        network = random_tree(nodes, STATES, seed)
        sets = _evidence_sets(network, np.random.Generator(np.random.PCG64([seed, nodes])))
        exact = [reference(network, evidence) for evidence in sets]
        ways: dict[str, tuple[Rival, int]] = {OURS: (_ours, nodes), LIMIT: (Limit, nodes), **RIVALS}
        timings = [
            _Timing(way, rival, network, sets, exact, f"left out: more than {most} nodes" if nodes > most else "")
            for way, (rival, most) in ways.items()
        ]
        for number in range(rounds):
            for timing in timings:
                told(f"{nodes} nodes, round {number + 1} of {rounds}: {timing.way}")
                timing.round()
        cells += [timing.cell() for timing in timings]
    return cells


@dataclass
class _Timing:
    """One way on one network, over the rounds."""

    way: str
    rival: Rival
    network: Description
    sets: Sequence[Evidence]
    exact: Sequence[Posteriors]  # of each set
    note: str  # why there is no time; empty while there may be one
    rounds_ms: list[float] = field(default_factory=list)  # the median of each
    error: float = 0.0  # the largest so far
    update: Update | None = None

    def round(self) -> None:
        """Update with the evidence sets, one after the other."""
        if self.note:
            return
        try:
            if self.update is None:
                self.update = self.rival(self.network)
                self.update(self.sets[0])
            self.rounds_ms.append(statistics.median(self._times_ms(self.update)))
        except ModuleNotFoundError as error:
            self.note = f"{error.name} is not installed"
        except HieraxError:
            raise
        except Exception as error:  # what rivals raise is theirs to know
            self.note = f"failed: {type(error).__name__}: {' '.join(str(error).split())[:60]}"

    def cell(self) -> Cell:
        """The rounds together."""
        if self.note:
            return Cell(self.way, len(self.network), None, None, self.note)
        return Cell(self.way, len(self.network), statistics.median(self.rounds_ms), self.error)

    def _times_ms(self, update: Update) -> list[float]:
        times_ms: list[float] = []
        for evidence, wanted in zip(self.sets, self.exact, strict=True):
            begun = time.process_time()
            found = update(evidence)
            times_ms.append((time.process_time() - begun) * 1e3)
            self.error = max(self.error, *(float(np.abs(found[name] - row).max()) for name, row in wanted.items()))
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
        return inference.update({name: vectors[state] for name, state in evidence.items()})

    return update


def _pyagrum(engine: str) -> Rival:
    def made(network: Description) -> Update:
        gum = import_quietly("pyagrum")
        gum.setNumberOfThreads(1)
        net = gum.BayesNet()
        for entry in network:
            net.add(gum.RangeVariable(entry["id"], "", 0, STATES - 1))
        for entry in network:
            for parent in entry["parents"]:
                net.addArc(parent, entry["id"])
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
    names = ("pgmpy.factors.discrete", "pgmpy.models", "pgmpy.inference")
    cpds, models, methods = (import_quietly(name) for name in names)
    model = models.DiscreteBayesianNetwork()
    model.add_nodes_from([entry["id"] for entry in network])
    model.add_edges_from([(parent, entry["id"]) for entry in network for parent in entry["parents"]])
    for entry in network:
        columns = np.atleast_2d(entry["cpt"] if entry["parents"] else entry["prior"]).T
        above = {"evidence": entry["parents"], "evidence_card": [STATES]} if entry["parents"] else {}
        model.add_cpds(cpds.TabularCPD(entry["id"], STATES, columns, **above))
    inference = methods.BeliefPropagation(model)

    def update(evidence: Evidence) -> Posteriors:
        found: dict[str, Any] = {name: np.eye(STATES)[state] for name, state in evidence.items()}
        asked = [entry["id"] for entry in network if entry["id"] not in evidence]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name in asked:  # of several at once it makes their joint distribution first
                found[name] = inference.query([name], evidence=dict(evidence), show_progress=False).values
        return found

    return update


class Limit:
    """Level by level in float64, for a tree whose parents stand before their children and whose nodes have equally many
    states. Nothing is checked: no evidence, no underflow, no impossible evidence; what is 0 divides by 0."""

    def __init__(self, network: Description) -> None:
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

    def __call__(self, evidence: Evidence) -> dict[str, Floats]:
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


def reference(network: Description, evidence: Evidence) -> dict[str, Floats]:
    """Posteriors of a tree whose parents stand before their children, by the numbers of the states that are seen, node
    by node in the machine's longest floating-point numbers."""
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


# By name: what makes them, and up to how many nodes an update ends within seconds.
RIVALS: Mapping[str, tuple[Rival, int]] = {
    "pyAgrum, lazy propagation": (_pyagrum("LazyPropagation"), 10**9),
    "pyAgrum, Shafer-Shenoy": (_pyagrum("ShaferShenoyInference"), 10**9),
    "pgmpy, belief propagation": (_pgmpy, 30),
}
