"""``hierax graph``: the nodes and edges of a deployment file."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.options import File, Overrides

if TYPE_CHECKING:
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.execution.plain import Json
    from hierax.schemas.roster import Reference, Roster


class GraphFormat(str, Enum):
    """How a graph is printed."""

    text = "text"
    json = "json"
    mermaid = "mermaid"


def graph(
    file: File,
    overrides: Overrides = None,
    output_format: Annotated[
        GraphFormat, typer.Option("--format", help="Tables, JSON, or source of a Mermaid flowchart.")
    ] = GraphFormat.text,
) -> int:
    """Show the nodes and edges of a deployment file. None of its classes is loaded."""
    from hierax.runtime.commands.show import print_json
    from hierax.runtime.deployment.read import read_deployment

    deployment = read_deployment(file, overrides or ())
    if output_format is GraphFormat.json:
        print_json(graph_json(deployment))
    elif output_format is GraphFormat.mermaid:
        print(mermaid(deployment.roster))
    else:
        _print_tables(deployment)
    return 0


def graph_json(deployment: Deployment) -> Json:
    """Nodes and edges as plain JSON."""
    from hierax.runtime.core.hierarchy import neighbours_above, neighbours_below

    roster = deployment.roster
    pairs = [(edge.lower, edge.upper) for edge in roster.edges]
    return {
        "hierarchy": deployment.name,
        "world": roster.world,
        "nodes": {
            name: {
                "class": roster.nodes[name].target,
                "below": list(neighbours_below(name, pairs)),
                "above": list(neighbours_above(name, pairs)),
                "depth": depth,
            }
            for name, depth in depths(roster).items()
        },
        "edges": [
            {
                "lower": edge.lower,
                "upper": edge.upper,
                "sense": _target(edge.sense),
                "task": _target(edge.task),
                "context": _target(edge.context),
            }
            for edge in roster.edges
        ],
    }


def depths(roster: Roster) -> Mapping[str, int]:
    """How far the nodes of a roster are from the world, as `hierax.runtime.core.graph.depths` has it."""
    from hierax.runtime.core import graph

    return graph.depths(roster.nodes, [edge.pair for edge in roster.edges])


def mermaid(roster: Roster) -> str:
    """A Mermaid flowchart: what is sensed goes up in solid lines, tasks and context come down in dotted ones."""
    ids = {name: f"n{index}" for index, name in enumerate(depths(roster))}
    lines = ["flowchart BT"]
    for name, number in ids.items():
        shape = f'{number}[("{name}")]' if name == roster.world else f'{number}["{name}"]'
        lines.append(f"    {shape}")
    for edge in roster.edges:
        lower, upper = ids[edge.lower], ids[edge.upper]
        label = f"|{_name(edge.sense)}| " if edge.sense else ""
        lines.append(f"    {lower} -->{label or ' '}{upper}")
        for kind, reference in (("task", edge.task), ("context", edge.context)):
            if reference is not None:
                lines.append(f"    {upper} -.->|{kind}: {_name(reference)}| {lower}")
    return "\n".join(lines)


def _print_tables(deployment: Deployment) -> None:
    from hierax.runtime.commands.show import print_table

    content = graph_json(deployment)
    print(f"{deployment.name}: {deployment.description}".rstrip(": "), end="\n\n")
    nodes = [
        (name, node["class"], ", ".join(node["below"]), ", ".join(node["above"]), str(node["depth"]))
        for name, node in content["nodes"].items()
    ]
    print_table({"node": {}, "class": {}, "below": {}, "above": {}, "depth": {"justify": "right"}}, nodes)
    if not content["edges"]:
        return
    print()
    edges = [
        (f"{edge['lower']} -> {edge['upper']}", edge["sense"] or "", edge["task"] or "", edge["context"] or "")
        for edge in content["edges"]
    ]
    print_table({"edge": {}, "sense": {}, "task": {}, "context": {}}, edges)


def _target(reference: Reference | None) -> str | None:
    return None if reference is None else reference.target


def _name(reference: Reference) -> str:
    return reference.target.partition(":")[2]
