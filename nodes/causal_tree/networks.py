"""Where networks come from: lists, files, and a seed; and what evidence a user may write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.errors import EvidenceError, Name, NetworkError
from hierax.nodes.causal_tree.extended_floats import Floats
from hierax.nodes.causal_tree.network import MAX_NODES, MAX_STATES, Network, Variable, check_tables, parse
from hierax.nodes.causal_tree.network_files import read_network

# A network; a description; the path of a file; or ``{nodes, states, seed}``: a random tree.
Source = Network | Sequence[Mapping[str, Any]] | Mapping[str, Any] | str


def network_from(source: Source) -> Network:
    """A network, from what a deployment's parameter says.

    Args:
        source: as `Source` has it.

    Raises:
        NetworkError: it is none, or the file cannot be read.
    """
    if isinstance(source, str):
        return read_network(source)
    if not isinstance(source, Mapping):
        return parse(source)
    known = {"nodes", "states", "seed"}
    if set(source) != known or not all(type(value) is int and value >= 0 for value in source.values()):
        expected = "expected nodes, seed and states, whole numbers, for a random tree"
        raise NetworkError(f"network: {expected}, got {source!r:.80}")
    return parse(random_tree(source["nodes"], source["states"], source["seed"]))


def random_tree(nodes: int, states: int, seed: int) -> list[dict[str, Any]]:
    """The description of a random tree, ``n0`` its root: each node's parent is drawn among those before it.

    Args:
        nodes: how many.
        states: of each node.
        seed: of all draws; distributions are drawn evenly from all that there are.

    Raises:
        NetworkError: it would be too large.
    """
    if nodes > MAX_NODES or states > MAX_STATES:
        raise NetworkError(f"network: at most {MAX_NODES} nodes of {MAX_STATES} states are allowed")
    check_tables({"n0": (states,), "others": (max(nodes - 1, 0), states, states)})
    random = np.random.Generator(np.random.PCG64(seed))
    description: list[dict[str, Any]] = []
    for number in range(nodes):
        rows = random.dirichlet(np.ones(states), states if number else None).tolist()
        parents = [f"n{random.integers(number)}"] if number else []
        numbers = {"cpt" if number else "prior": rows}
        description.append({"id": f"n{number}", "states": states, "parents": parents, **numbers})
    return description


def likelihoods(network: Network, name: Name, value: object) -> Floats:
    """Evidence as a user may write it, as a likelihood vector.

    Args:
        network: that the node is of.
        name: the node.
        value: a state's name, its number from 0, or likelihoods, one for each state.

    Raises:
        EvidenceError: there is no such node or state, or the numbers are no likelihoods.
    """
    if name not in network.variables:
        raise EvidenceError("there is no such node", name)
    variable = network.variables[name]
    count = len(variable.states)
    if not isinstance(value, (list, tuple, np.ndarray)):
        hard = np.zeros(count)
        hard[_state(variable, value)] = 1.0
        return hard
    vector = np.asarray(value)
    if vector.shape != (count,) or vector.dtype.kind not in "iufb":
        raise EvidenceError(f"expected {count} likelihoods, one for each state, got {value!r:.60}", name)
    if not (vector.min() >= 0 and vector.max() < np.inf):
        raise EvidenceError(f"expected finite numbers of at least 0, got {value!r:.60}", name)
    return vector.astype(np.float64)


def sampled(network: Network, random: np.random.Generator) -> dict[Name, int]:
    """A state for each node, drawn from the network."""
    found: dict[Name, int] = {}
    waiting = list(network.variables.values())
    while waiting:
        later = []
        for variable in waiting:
            if not all(parent in found for parent in variable.parents):
                later.append(variable)
                continue
            row = variable.table[tuple(found[parent] for parent in variable.parents)]
            drawn = int(np.searchsorted(np.cumsum(row), random.random() * row.sum(), side="right"))
            found[variable.name] = min(drawn, int(np.flatnonzero(row)[-1]))
        waiting = later
    return found


def _state(variable: Variable, value: object) -> int:
    if isinstance(value, str) and value in variable.states:
        return variable.states.index(value)
    if type(value) is int and 0 <= value < len(variable.states):
        return value
    if isinstance(value, bool) and str(value).lower() in variable.states:  # YAML's reading of a state named true
        return variable.states.index(str(value).lower())
    shown = ", ".join(variable.states[:8]) + (", …" if len(variable.states) > 8 else "")
    raise EvidenceError(f"there is no state {value!r:.60}; expected one of {shown}", variable.name)
