"""Networks in files: JSON, YAML, and BIF, which pyAgrum reads."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hierax.nodes.causal_tree.errors import NetworkError
from hierax.nodes.causal_tree.network import Network, parse

SUFFIXES = (".json", ".yaml", ".yml", ".bif")


class _Loader(yaml.SafeLoader):
    """Numbers and booleans as YAML 1.2 has them: 1e-12 is a number, and no and yes are the names of states."""


_TAG = "tag:yaml.org,2002:"
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (f"{_TAG}bool", f"{_TAG}float")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(f"{_TAG}bool", re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"), list("tTfF"))
_Loader.add_implicit_resolver(
    f"{_TAG}float",
    re.compile(
        r"[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?\Z|[-+]?\.(?:inf|Inf|INF)\Z|\.(?:nan|NaN|NAN)\Z"
    ),
    list("-+.0123456789"),
)


def read_network(file: str | Path) -> Network:
    """Read a network.

    Args:
        file: JSON or YAML with the list of nodes that `parse` takes, or a map with that list as ``network``; or BIF.

    Raises:
        NetworkError: the file cannot be read, or holds no network; says which file, and which node.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise NetworkError(f"{path}: expected a file with the ending {', '.join(SUFFIXES)}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise NetworkError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise NetworkError(f"{path}: byte {error.object[error.start]:#04x} is not UTF-8") from error
    description = _from_bif(path) if suffix == ".bif" else _from_text(text, path)
    try:
        return parse(description)
    except NetworkError as error:
        placed = NetworkError(f"{path}: {error}")
        placed.node = error.node
        raise placed from error


def _from_text(text: str, path: Path) -> Any:
    try:
        content = json.loads(text) if path.suffix.lower() == ".json" else yaml.load(text, Loader=_Loader)
    except ValueError as error:
        raise NetworkError(f"{path}: is no JSON: {error}") from error
    except yaml.YAMLError as error:
        raise NetworkError(f"{path}: is no YAML: {' '.join(str(error).split())}") from error
    if isinstance(content, dict) and "network" in content:
        return content["network"]
    return content


def _from_bif(path: Path) -> list[dict[str, Any]]:
    try:
        with warnings.catch_warnings():  # where they are errors, those of its import end the process
            warnings.simplefilter("ignore")
            import pyagrum
    except ModuleNotFoundError as error:
        what = "BIF needs pyAgrum, which is not installed: pip install 'hierax[bayes]'"
        raise NetworkError(f"{path}: {what}") from error
    try:
        net = pyagrum.loadBN(str(path))
    except Exception as error:  # pyAgrum has many
        told = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise NetworkError(f"{path}: is no BIF: {told.strip()}") from error
    return description_of(net)


def description_of(net: Any) -> list[dict[str, Any]]:
    """The description of a network of pyAgrum's.

    Args:
        net: a ``pyagrum.BayesNet``.
    """
    description = []
    for node in sorted(net.nodes()):
        variable, table = net.variable(node), net.cpt(node)
        name = variable.name()
        parents = [axis for axis in table.names if axis != name]
        # its arrays have the axes in the opposite order, whichever the table has
        array = np.asarray(table.toarray(), np.float64)
        axes = list(reversed(table.names))
        array = array.transpose([axes.index(axis) for axis in (*parents, name)])
        entry = {"id": name, "states": list(variable.labels()), "parents": parents}
        entry["cpt" if parents else "prior"] = array.tolist()
        description.append(entry)
    return description
