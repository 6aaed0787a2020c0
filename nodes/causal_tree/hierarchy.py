"""From a network to a hierarchy: a deployment with a process for each node, or for each part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any

from hierax.nodes.causal_tree.errors import NetworkError
from hierax.nodes.causal_tree.network import Description, Network, parse
from hierax.nodes.causal_tree.network_shape import epochs_to_exactness

MODULE = "hierax.nodes.causal_tree"
WORLD = "world"


def epochs_needed(network: Description | Network) -> int:
    """How many Updates with the same evidence make all beliefs exact: 1 for trees. For a polytree 1 more than the most
    nodes on an undirected path that it comes down to from one parent, and leaves up to another. This holds with a
    process for each node; with larger parts it may take fewer."""
    return epochs_to_exactness({name: each.parents for name, each in parse(network).variables.items()})


def as_deployment(
    description: Description, sets: Sequence[Mapping[str, Any]], parts: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Any]:
    """A network as the content of a deployment file.

    Args:
        description: of the network.
        sets: evidence sets, as `EvidenceWorld` takes them; each is shown as long as it takes to be exact.
        parts: by name of a hierarchy's node, the network's nodes that it holds; by default each by itself.

    Raises NetworkError: it is no network, a node is in no part or in two, or the parts' arrows go round in a circle.
    """
    network = parse(description)
    if parts is None:
        parts = {str(name): (str(name),) for name in network.variables}
    held = _held(network, parts)
    needed = epochs_needed(network)
    arrows = ((held[name], held[parent]) for name, each in network.variables.items() for parent in each.parents)
    pairs = sorted({(lower, upper) for lower, upper in arrows if lower != upper})
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for lower, upper in pairs:
        sorter.add(upper, lower)
    try:
        sorter.prepare()
    except CycleError as error:
        circle = ", ".join(sorted(set(error.args[1])))
        raise NetworkError(f"arrows between the parts {circle} go round in a circle") from None
    edges: dict[str, Any] = {f"{WORLD} -> {part}": {"sense": f"{MODULE}:evidence_seen"} for part in parts}
    for lower, upper in pairs:
        edges[f"{lower} -> {upper}"] = {"sense": f"{MODULE}:diagnostic_support", "context": f"{MODULE}:causal_support"}
    shown = {"network": "${network}", "sets": "${sets}", "hold": needed}
    nodes: dict[str, Any] = {WORLD: {"class": f"{MODULE}:EvidenceWorld", "parameters": shown}}
    for part, names in parts.items():
        parameters = {"network": "${network}", "nodes": list(names), "settle": needed}
        nodes[part] = {"class": f"{MODULE}:Part", "parameters": parameters}
    return {
        "hierarchy": "causal-tree" if network.is_tree else "polytree",
        "description": f"a Bayesian network of {len(network.variables)} nodes, in {len(parts)} parts",
        "world": WORLD,
        "parameters": {"network": [dict(entry) for entry in description], "sets": [dict(each) for each in sets]},
        "nodes": nodes,
        "edges": edges,
    }


def _held(network: Network, parts: Mapping[str, Sequence[str]]) -> dict[Any, str]:
    held: dict[Any, str] = {}
    for part, names in parts.items():
        if part == WORLD:
            raise NetworkError(f"a part cannot be named {WORLD!r}: that is N₀")
        for name in names:
            if name not in network.variables:
                raise NetworkError(f"part {part!r} holds {name!r}, which the network has not")
            if name in held:
                raise NetworkError(f"is in two parts, {held[name]!r} and {part!r}", name)
            held[name] = part
    missing = next((name for name in network.variables if name not in held), None)
    if missing is not None:
        raise NetworkError("is in no part", missing)
    return held
