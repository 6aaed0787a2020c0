"""``hierax graph`` and ``hierax validate``: what a deployment file says, and whether it can be run."""

from collections.abc import Iterable
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

from hierax.runtime.commands.checks import made
from hierax.runtime.commands.options import File, Format, OutputFormat, Overrides, option
from hierax.runtime.commands.show import RIGHT, print_json, print_table
from hierax.runtime.host.streams import printable

if TYPE_CHECKING:
    from hierax.runtime.core.hierarchy import Hierarchy
    from hierax.runtime.deployment import Deployment
    from hierax.runtime.execution.report import Json
    from hierax.schemas.roster import Reference, Roster

_FUNCTIONS = ("sense", "task", "context")
_OF_NODES, _OF_EDGES = ("every", "offset"), ("delay", "gather")  # what there is of rates, where it is not the default


class GraphFormat(str, Enum):
    """How a graph is printed."""

    text = "text"
    json = "json"
    mermaid = "mermaid"


def graph(
    file: File,
    overrides: Overrides = None,
    output_format: Annotated[
        GraphFormat, option("--format", help="Tables, JSON, or source of a Mermaid flowchart.")
    ] = GraphFormat.text,
) -> int:
    """Show the nodes and edges of a deployment file. None of its classes is loaded."""
    from hierax.runtime.deployment.read import read_deployment

    deployment = read_deployment(file, overrides or ())
    if output_format is GraphFormat.json:
        print_json(graph_json(deployment))
    elif output_format is GraphFormat.mermaid:
        print(mermaid(deployment.roster))
    else:
        _print_tables(deployment)
    return 0


def graph_json(deployment: "Deployment") -> "Json":
    """Nodes and edges as plain JSON."""
    from hierax.runtime.core.graph import depths

    roster = deployment.roster
    return {
        "hierarchy": deployment.name,
        "world": roster.world,
        "nodes": {
            name: {
                "class": roster.nodes[name].target,
                "below": list(roster.below(name)),
                "above": list(roster.above(name)),
                "depth": depth,
                **_turns(roster, name),
            }
            for name, depth in depths(roster.nodes, roster.pairs).items()
        },
        "edges": [
            {"lower": edge.lower, "upper": edge.upper}
            | {kind: getattr(getattr(edge, kind), "target", None) for kind in _FUNCTIONS}
            | {key: value for key in _OF_EDGES if (value := getattr(edge, key))}
            for edge in roster.edges
        ],
    }


def _turns(roster: "Roster", name: str) -> dict[str, int]:
    from hierax.schemas.rates import EVERY_EPOCH

    turns = roster.turns.get(name, EVERY_EPOCH)
    return {key: value for key in _OF_NODES if (value := getattr(turns, key)) != getattr(EVERY_EPOCH, key)}


def mermaid(roster: "Roster") -> str:
    """A Mermaid flowchart: what is sensed goes up in solid lines, tasks and context come down in dotted ones."""
    from hierax.runtime.core.graph import topological_order

    order = topological_order(roster.nodes, roster.pairs)
    ids = {name: f"n{index}" for index, name in enumerate(order)}
    lines = ["flowchart BT"]
    for name, number in ids.items():
        turns = "".join(f"<br>{key} {value}" for key, value in _turns(roster, name).items())
        lines.append(f'    {number}[("{name}")]' if name == roster.world else f'    {number}["{name}{turns}"]')
    for edge in roster.edges:
        lower, upper = ids[edge.lower], ids[edge.upper]
        gathers, delay = ", gather" if edge.gather else "", f", delay {edge.delay}" if edge.delay else ""
        label = f"|{_name(edge.sense)}{gathers}| " if edge.sense else ""
        lines.append(f"    {lower} -->{label or ' '}{upper}")
        for kind, reference in (("task", edge.task), ("context", edge.context)):
            if reference is not None:
                lines.append(f"    {upper} -.->|{kind}: {_name(reference)}{delay}| {lower}")
    return "\n".join(lines)


def _print_tables(deployment: "Deployment") -> None:
    content = graph_json(deployment)
    about = f"{deployment.name}: {deployment.description}" if deployment.description else deployment.name
    print(printable(about, kept=""), end="\n\n")
    nodes, edges = content["nodes"].values(), content["edges"]
    of_nodes, of_edges = _said(_OF_NODES, nodes), _said(_OF_EDGES, edges)
    rows = []
    for name, node in content["nodes"].items():
        below, above = (", ".join(node[side]) for side in ("below", "above"))
        rows.append((name, node["class"], below, above, str(node["depth"]), *_cells(of_nodes, node)))
    print_table({"node": {}, "class": {}, "below": {}, "above": {}, "depth": RIGHT, **of_nodes}, rows)
    if edges:
        rows = [(f"{edge['lower']} -> {edge['upper']}", *_cells((*_FUNCTIONS, *of_edges), edge)) for edge in edges]
        print()
        print_table({"edge": {}, **{kind: {} for kind in _FUNCTIONS}, **of_edges}, rows)


def _said(keys: Iterable[str], content: Iterable[Any]) -> dict[str, dict[str, Any]]:
    """The columns of those keys of which something is said somewhere."""
    return {key: RIGHT for key in keys if any(key in each for each in content)}


def _cells(keys: Iterable[str], content: "Json") -> tuple[str, ...]:
    values = [content.get(key) for key in keys]
    return tuple("yes" if value is True else str(value or "") for value in values)


def _name(reference: "Reference") -> str:
    return reference.target.partition(":")[2]


def validate(
    file: File,
    overrides: Overrides = None,
    dry: Annotated[bool, option("--dry")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Check a deployment file: read it, import and make what it names, and see that that forms a hierarchy."""
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.execution.dry import run_dry

    deployment = read_deployment(file, overrides or ())
    roster = deployment.roster
    with made(deployment) as hierarchy:
        _check(deployment, hierarchy)
        calls = run_dry(deployment) if dry else 0
    content, nodes, edges = roster.content_hash().hex(), len(roster.nodes), len(roster.edges)
    if output_format is Format.json:
        result = {"hierarchy": deployment.name, "file": str(deployment.path), "nodes": nodes, "edges": edges}
        print_json({**result, "content": content, **({"dry_calls": calls} if dry else {})})
    else:
        called = f", {calls} dry calls" if dry else ""
        print(f"{deployment.path}: OK, {nodes} nodes, {edges} edges{called}, content {content}")
    return 0


def _check(deployment: "Deployment", hierarchy: "Hierarchy") -> None:
    """All that can be told without calling more than the initial beliefs."""
    from hierax.runtime.loading.loader import LoadError, build_probe, check_initial_belief, load_function
    from hierax.runtime.loading.node_loader import misspelt_operators

    for name, node in hierarchy.nodes.items():
        for what in misspelt_operators(type(node)):
            raise LoadError(what, f"nodes.{name}.class")
        check_initial_belief(name, node)
    for index, probe in enumerate(deployment.probes):
        build_probe(probe.reference, f"probes[{index}]", deployment.allowance)
    if deployment.view.show is not None:
        load_function(deployment.view.show, "view.show", deployment.allowance)
