"""Snippets: YAML with ``nodes`` and ``edges`` as a deployment file has them, for a hierarchy that runs.

``${NAME}`` stands for a parameter of the deployment. Nothing of what a snippet names is imported, and nothing is
checked that depends on the roster which it will find: what nodes there are then, and what may be loaded,
`hierax.runtime.owner.roster_changes` decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from pathlib import Path

from pydantic import ValidationError

from hierax.runtime.deployment.deployment import Deployment, RestartPolicy
from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.models import SnippetModel, split_edge
from hierax.runtime.deployment.parameters import substitute
from hierax.runtime.deployment.paths import DeploymentError, inside
from hierax.runtime.deployment.read import read_document, restart_policy, roster_edges, roster_nodes
from hierax.runtime.deployment.validation import first_error
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.roster import Attach, Replace


def read_attach(source: str | Path, deployment: Deployment) -> Attach:
    """What attaches nodes to a run of a deployment. The source is the path of a snippet; or the name of a node of the
    deployment file, which is meant with all its edges there. Raises `DeploymentError` if there is no such file or node,
    or the snippet is wrong: file, line, field, what was expected, and the nearest valid name."""
    if _is_node(source, deployment):
        name, roster = str(source), deployment.roster
        return Attach({name: roster.nodes[name]}, tuple(edge for edge in roster.edges if name in edge.pair))
    model, document = _read(source, deployment)
    return Attach(roster_nodes(model.nodes, document), roster_edges(model.edges or {}, document))


def read_replace(source: str | Path, name: str, deployment: Deployment) -> Replace:
    """What replaces the node of a name. The source is the path of a snippet that has this node alone. Its edges are all
    that the node has from then on; without ``edges`` it keeps those that it has. Raises `DeploymentError` as
    `read_attach` does, or if the snippet has another node."""
    model, document = _read(source, deployment)
    for given in model.nodes:
        if given != name:
            raise document.error(("nodes", given), f"expected no other node than the one to be replaced, {name!r}")
    edges = None if model.edges is None else roster_edges(model.edges, document)
    return Replace(name, roster_nodes(model.nodes, document)[name], edges)


def read_restarts(source: str | Path, deployment: Deployment, *, attached: bool = False) -> Mapping[str, RestartPolicy]:
    """What a source of `read_attach` or `read_replace` says about the restarts of its nodes. What it leaves out is as
    ``restart`` at the top of the deployment file has it; but what is attached fails alone (``on_loss: detach``) where
    neither file says what is to follow. Raises `DeploymentError` as `read_attach` does."""
    otherwise = deployment.restart
    if attached and not _says(deployment, "restart"):
        otherwise = replace(otherwise, on_loss="detach")
    if _is_node(source, deployment):
        own = deployment.restarts[str(source)]
        said = _says(deployment, "nodes", str(source))
        return {str(source): own if said else replace(own, on_loss=otherwise.on_loss)}
    model, document = _read(source, deployment)
    return {name: restart_policy(node, otherwise, document, ("nodes", name)) for name, node in model.nodes.items()}


def _says(deployment: Deployment, *keys: str) -> bool:
    """Whether the deployment file says at this path what follows on a loss."""
    found = reduce(inside, keys, deployment.document.root)
    return isinstance(found, dict) and "on_loss" in found


def _is_node(source: str | Path, deployment: Deployment) -> bool:
    return str(source) in deployment.roster.nodes and not _is_file(source)


def _is_file(source: str | Path) -> bool:
    try:
        return Path(source).is_file()
    except (OSError, ValueError) as error:  # a name that no file can have
        raise DeploymentError(f"cannot be read: {error}", str(source)) from error


def _read(source: str | Path, deployment: Deployment) -> tuple[SnippetModel, Document]:
    if not _is_file(source):
        nearest = did_you_mean(str(source), deployment.roster.nodes, "its nodes are")
        what = f"there is no such file, and {deployment.path} has no node of that name{nearest}"
        raise DeploymentError(what, str(source))
    document = read_document(Path(source), "nodes and edges")
    document.outer = deployment.document
    root = substitute(document)
    try:
        model = SnippetModel.model_validate(root)
    except ValidationError as error:
        raise first_error(error, document, root, SnippetModel) from error
    if not model.nodes:
        raise document.error(("nodes",), "expected at least one node")
    for edge in model.edges or {}:
        if not model.nodes.keys() & set(split_edge(edge)):
            names = " or ".join(map(repr, sorted(model.nodes)))
            raise document.error(("edges", edge), f"joins two other nodes; expected an edge of {names}")
    return model, document
