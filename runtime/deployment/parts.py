"""Nodes and edges as the models have them, made into those of a roster; for deployments and snippets alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from hierax.runtime.deployment.deployment import RestartPolicy
from hierax.runtime.deployment.document import Document
from hierax.runtime.deployment.models import EdgeModel, FunctionModel, NodeModel, RestartModel, split_edge
from hierax.runtime.deployment.paths import Keys
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import FUNCTIONS, Reference, RosterEdge
from hierax.schemas.values import decode_value, encode_value


def roster_nodes(models: Mapping[str, NodeModel], document: Document) -> dict[str, Reference]:
    """Classes and parameters by name. Raises `DeploymentError` if a parameter is no value."""
    return {name: reference(node.target, node.parameters, document, ("nodes", name)) for name, node in models.items()}


def roster_edges(models: Mapping[str, EdgeModel], document: Document) -> tuple[RosterEdge, ...]:
    """Edges, by names, without functions that are not enabled. Raises `DeploymentError` if a parameter is no value."""
    edges = []
    for name, edge in models.items():
        functions = {kind: _function(getattr(edge, kind), document, ("edges", name, kind)) for kind in FUNCTIONS}
        lower, upper = split_edge(name)
        edges.append(RosterEdge(lower, upper, **functions))
    return tuple(sorted(edges, key=lambda edge: edge.pair))


def reference(target: str, parameters: Mapping[str, Any], document: Document, keys: Keys) -> Reference:
    """A reference with parameters as after travelling, lists as tuples; `DeploymentError` if one is no value."""
    try:
        travelled = decode_value(encode_value(parameters))
    except SchemaError as error:
        raise document.error((*keys, "parameters"), str(error)) from error
    return Reference(target, travelled)


def check_known(name: str, nodes: Iterable[str], document: Document, keys: Keys) -> None:
    """Whether there is a node of this name. Raises `DeploymentError` if there is none, with the nearest one."""
    if name not in nodes:
        raise document.error(keys, f"there is no node {name!r}{did_you_mean(name, nodes, 'the nodes are')}")


def restart_policy(model: RestartModel, otherwise: RestartPolicy, document: Document, keys: Keys) -> RestartPolicy:
    """What the model of a node, or of all, says about restarts, with the rest as another policy has it.

    The longest delay is then at least the first one; if it is given, and shorter, `DeploymentError` names its place in
    the document.
    """
    given = {name: getattr(model, name) for name in RestartModel.model_fields if name in model.model_fields_set}
    first_s = given.get("restart_delay_s", otherwise.restart_delay_s)
    longest_s = given.setdefault("max_restart_delay_s", max(first_s, otherwise.max_restart_delay_s))
    if longest_s < first_s:
        what = f"expected at least restart_delay, {first_s:g}, got {longest_s:g}"
        raise document.error((*keys, "max_restart_delay"), what)
    return replace(otherwise, **given)


def _function(model: FunctionModel | None, document: Document, keys: Keys) -> Reference | None:
    if model is None or not model.enabled:
        return None
    return reference(model.function, model.parameters, document, keys)
