"""Reading a deployment file: text to tree, ``--set``, ``${NAME}``, models, roster."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import check_graph
from hierax.runtime.deployment.deployment import Deployment
from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.errors import DeploymentError
from hierax.runtime.deployment.faults import first_error
from hierax.runtime.deployment.files import find_file, import_paths, read_text
from hierax.runtime.deployment.models import DeploymentModel, FunctionModel, split_edge
from hierax.runtime.deployment.overrides import apply_override
from hierax.runtime.deployment.parameters import substitute
from hierax.runtime.deployment.paths import Keys
from hierax.runtime.deployment.tree import read_tree
from hierax.runtime.nearest import did_you_mean
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import ProbeSpec, Reference, Roster, RosterEdge
from hierax.schemas.values import decode_value, encode_value

_KINDS = ("sense", "task", "context")


def read_deployment(file: str | Path, overrides: Sequence[str] = ()) -> Deployment:
    """Read a deployment file.

    Nothing of what it names is imported.

    Args:
        file: the path of a file, or the name of a shipped deployment.
        overrides: as ``--set`` has them, ``PATH=VALUE``, in order.

    Raises:
        DeploymentError: the file, or an override, is wrong: file, line, field, what was
            expected, and the nearest valid name.
    """
    path = find_file(file)
    document = _read_document(path)
    for override in overrides:
        apply_override(document, override)
    root = substitute(document)
    try:
        model = DeploymentModel.model_validate(root)
    except ValidationError as error:
        raise first_error(error, document, root) from error
    roster = _roster(model, document)
    _check_structure(roster, document)
    return Deployment(
        path=path,
        name=model.hierarchy,
        description=model.description,
        epochs=model.epochs,
        roster=roster,
        probes=_probes(model, document),
        start_timeout_s=model.start_timeout_s,
        zenoh=_zenoh(model.zenoh, path, document),
        import_paths=import_paths(path),
        document=document,
    )


def _read_document(path: Path) -> Document:
    tree = read_tree(read_text(path), str(path))
    if tree.value is None:
        raise DeploymentError("is empty; expected a map with hierarchy, world, nodes and edges", str(path))
    if not isinstance(tree.value, dict):
        given = "a list" if isinstance(tree.value, list) else f"{tree.value!r:.60}"
        what = f"expected a map with hierarchy, world, nodes and edges, got {given}"
        raise DeploymentError(what, f"{path}:{tree.lines[()]}")
    return Document(str(path), tree.value, tree.lines)


def _roster(model: DeploymentModel, document: Document) -> Roster:
    nodes = {
        name: _reference(node.target, node.parameters, document, ("nodes", name)) for name, node in model.nodes.items()
    }
    _check_name(model.world, nodes, document, ("world",))
    edges = []
    for name, edge in model.edges.items():
        lower, upper = split_edge(name)
        for end in (lower, upper):
            _check_name(end, nodes, document, ("edges", name))
        functions = {kind: _function(getattr(edge, kind), document, ("edges", name, kind)) for kind in _KINDS}
        edges.append(RosterEdge(lower, upper, **functions))
    edges.sort(key=lambda edge: (edge.lower, edge.upper))
    return Roster(model.world, nodes, tuple(edges))


def _function(model: FunctionModel | None, document: Document, keys: Keys) -> Reference | None:
    if model is None or not model.enabled:
        return None
    return _reference(model.function, model.parameters, document, keys)


def _probes(model: DeploymentModel, document: Document) -> tuple[ProbeSpec, ...]:
    specs = []
    for index, probe in enumerate(model.probes):
        keys: Keys = ("probes", index)
        _check_name(probe.node, model.nodes, document, (*keys, "node"))
        specs.append(ProbeSpec(probe.node, _reference(probe.target, probe.parameters, document, keys)))
    return tuple(specs)


def _reference(target: str, parameters: Mapping[str, Any], document: Document, keys: Keys) -> Reference:
    """A reference whose parameters are as they are after travelling: lists have become tuples."""
    try:
        travelled = decode_value(encode_value(parameters))
    except SchemaError as error:
        raise document.error((*keys, "parameters"), str(error)) from error
    return Reference(target, travelled)


def _check_name(name: str, nodes: Iterable[str], document: Document, keys: Keys) -> None:
    if name not in nodes:
        raise document.error(keys, f"there is no node {name!r}{did_you_mean(name, nodes, 'the nodes are')}")


def _check_structure(roster: Roster, document: Document) -> None:
    pairs = [(edge.lower, edge.upper) for edge in roster.edges]
    try:
        check_graph(roster.world, roster.nodes, pairs)
    except HierarchyError as error:
        raise document.error(("edges",), str(error)) from error


def _zenoh(value: str | dict[str, Any] | None, path: Path, document: Document) -> dict[str, Any] | str | None:
    if not isinstance(value, str) or value.lstrip().startswith("{"):
        return value
    file = (path.parent / value).resolve()
    if not file.is_file():
        raise document.error(("zenoh",), f"there is no file {str(file)!r}; expected a file, JSON5 text or a map")
    return str(file)
