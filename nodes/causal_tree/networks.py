"""Where networks come from: lists, a seed, and files (JSON, YAML, and BIF, which pyAgrum reads); and what evidence a
user may write."""

import json
from collections.abc import Mapping, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.bif import description_from
from hierax.nodes.causal_tree.errors import EvidenceError, Name, NetworkError
from hierax.nodes.causal_tree.extended_floats import Floats
from hierax.nodes.causal_tree.network import MAX_NODES, MAX_STATES, Network, Variable, check_tables, parse
from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.tree import read_tree

# What a file may have, by its ending.
MAX_BYTES = {".json": 1 << 26, ".yaml": 1 << 22, ".yml": 1 << 22, ".bif": 1 << 26}

SUFFIXES = tuple(MAX_BYTES)


# A network; a description; the path of a file; or ``{nodes, states, seed}``: a random tree.
Source = Network | Sequence[Mapping[str, Any]] | Mapping[str, Any] | str


def network_from(source: Source) -> Network:
    """A network, from what a deployment's parameter says. Raises NetworkError: it is none, or the file cannot be
    read."""
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
    """The description of a random tree, ``n0`` its root: each node's parent is drawn among those before it,
    distributions evenly from all that there are. Raises NetworkError: it would be too large."""
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
    """Evidence of a node as a user may write it, a state's name, else its number from 0, or likelihoods, one for each
    state, as a likelihood vector. Raises EvidenceError: there is no such node or state, or the numbers are no
    likelihoods."""
    if name not in network.variables:
        raise EvidenceError("there is no such node", name)
    variable = network.variables[name]
    count = len(variable.states)
    if not isinstance(value, (list, tuple, np.ndarray)):
        hard = np.zeros(count)
        hard[_state(variable, value)] = 1.0
        return hard
    return checked_vector(value, count, name)


def checked_vector(value: Any, count: int, name: Name) -> Floats:
    """So many likelihoods. Raises EvidenceError: they are none."""
    try:
        vector = np.asarray(value)
    except ValueError:  # lists of uneven lengths
        vector = np.empty((0, 0))
    if vector.shape != (count,) or vector.dtype.kind not in "iufb":
        raise EvidenceError(f"expected {count} likelihoods, one for each state, got {value!r:.60}", name)
    wrong = ~((vector >= 0) & (vector < np.inf))
    if wrong.any():
        raise EvidenceError(f"expected finite numbers of at least 0, got {vector[wrong][0]}", name)
    return vector.astype(np.float64)


def sampled(network: Network, random: np.random.Generator) -> dict[Name, int]:
    """A state for each node, drawn from the network."""
    found: dict[Name, int] = {}
    for variable in _parents_first(network):
        row = variable.table[tuple(found[parent] for parent in variable.parents)]
        drawn = int(np.searchsorted(np.cumsum(row), random.random() * row.sum(), side="right"))
        found[variable.name] = min(drawn, int(np.flatnonzero(row)[-1]))
    return found


def _parents_first(network: Network) -> list[Variable]:
    """The variables in the order of the description as far as each one's parents come before it: else in a later turn
    of going through those that are left."""
    places = {name: place for place, name in enumerate(network.variables)}
    turns: dict[Name, int] = {}
    parents = {name: variable.parents for name, variable in network.variables.items()}
    for name in TopologicalSorter(parents).static_order():
        turns[name] = max((turns[each] + (places[each] > places[name]) for each in parents[name]), default=0)
    return sorted(network.variables.values(), key=lambda variable: turns[variable.name])


def _state(variable: Variable, value: object) -> int:
    if isinstance(value, str) and value in variable.states:
        return variable.states.index(value)
    if type(value) is int and str(value) in variable.states:  # YAML's reading of a state whose name is a number
        return variable.states.index(str(value))
    if type(value) is int and 0 <= value < len(variable.states):
        return value
    if isinstance(value, bool) and str(value).lower() in variable.states:  # YAML's reading of a state named true
        return variable.states.index(str(value).lower())
    shown = ", ".join(variable.states[:8]) + (", …" if len(variable.states) > 8 else "")
    raise EvidenceError(f"there is no state {value!r:.60}; expected one of {shown}", variable.name)


def read_network(file: str | Path) -> Network:
    """Read a network: JSON or YAML with the list of nodes that `parse` takes, or a map with that list as ``network``;
    or BIF. Raises NetworkError: the file cannot be read, or holds no network; says which file, and which node."""
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise NetworkError(f"{path}: expected a file with the ending {', '.join(SUFFIXES)}")
    try:
        text = _text(path, MAX_BYTES[suffix])
        return parse(description_from(path, text) if suffix == ".bif" else _from_text(text, path, suffix == ".json"))
    except DeploymentError as error:  # of YAML, which is told with its line
        raise NetworkError(str(error)) from error
    except NetworkError as error:
        placed = NetworkError(f"{path}: {error}")
        placed.node = error.node
        raise placed from error


def _text(path: Path, most: int) -> str:
    """What is in a file, and nothing of one that is too large, or of something else than a file."""
    data = b""
    try:
        is_other = path.exists() and not path.is_file()  # reading a FIFO waits for ever
        if not is_other:
            with path.open("rb") as file:
                data = file.read(most + 1)
    except (OSError, ValueError) as error:
        raise NetworkError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if is_other:
        raise NetworkError("is no file")
    if len(data) > most:
        raise NetworkError(f"has more than the {most} bytes that are allowed of {path.suffix.lower()}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise NetworkError(f"byte {error.object[error.start]:#04x} is not UTF-8") from error


def _from_text(text: str, path: Path, is_json: bool) -> Any:
    try:
        content = json.loads(text) if is_json else read_tree(text, str(path)).value
    except RecursionError as error:
        raise NetworkError("is nested too deeply; expected a list of nodes") from error
    except ValueError as error:
        raise NetworkError(f"is no JSON: {error}") from error
    return content["network"] if isinstance(content, dict) and "network" in content else content
