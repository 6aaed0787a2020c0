"""What a file says of rates: `every` and `offset` of nodes, `delay` and `gather` of edges."""

from collections.abc import Mapping

from hierax.runtime.deployment.deployment import Document, Keys
from hierax.runtime.deployment.models import DeploymentModel, EdgeModel, NodeModel, SnippetModel
from hierax.schemas.rates import EVERY_EPOCH, FROM_THE_BEGINNING, Timing, Turns

TOGETHER = "where nodes have rates, none is left out of what was begun"

_OF_NODES = ("every", "offset")
_OF_EDGES = ("delay", "gather")


def turns_of(nodes: Mapping[str, NodeModel], document: Document) -> dict[str, Turns]:
    """In which epochs nodes take part, of those that say so. Raises `DeploymentError` if there is no such epoch."""
    for name, node in nodes.items():
        if node.offset >= node.every:
            unsaid = "" if "every" in node.model_fields_set else ", as it is not given here"
            what = f"expected less than every, {node.every}{unsaid}, got {node.offset}"
            raise document.error(("nodes", name, "offset"), what)
    said = {name: node for name, node in nodes.items() if node.model_fields_set.intersection(_OF_NODES)}
    return {name: Turns(node.every, node.offset) for name, node in said.items()}


def check_gathers(edges: Mapping[str, EdgeModel], document: Document) -> None:
    """Raises `DeploymentError` if nothing is sensed on an edge that gathers."""
    for name, edge in edges.items():
        if edge.gather and edge.sense is None:
            raise document.error(("edges", name, "gather"), "means something only with a function 'sense'")


def rates_of(model: DeploymentModel, document: Document) -> tuple[dict[str, Turns], Timing | None]:
    """What a roster has of a deployment's rates beside its edges. Raises `DeploymentError` if something means nothing
    where it stands."""
    turns = turns_of(model.nodes, document)
    if (every := model.nodes[model.world].every) != 1:
        what = f"the world takes part in every epoch; expected 1, got {every}"
        raise document.error(("nodes", model.world, "every"), what)
    check_gathers(model.edges, document)
    said = rated_keys(model)
    if said and "rates" in model.model_fields_set and not model.rates:
        what = f"expected true, or nothing, as there are rates: {'.'.join(map(str, said[0]))}"
        raise document.error(("rates",), what)
    said += [("rates",)] if model.rates else []
    if said and model.staleness != 0:
        raise document.error(said[0], "goes with a staleness of 0 only")
    if said and model.low_latency:
        what = "goes without rates only: nodes that do not wait for one another may fill its links"
        raise document.error(("low_latency",), what)
    return {name: each for name, each in turns.items() if each != EVERY_EPOCH}, FROM_THE_BEGINNING if said else None


def rated_keys(model: DeploymentModel | SnippetModel) -> list[Keys]:
    """Where a file says something of rates, in order."""
    nodes: list[Keys] = [("nodes", name, key) for name, node in model.nodes.items() for key in _said(node, _OF_NODES)]
    return nodes + [
        ("edges", name, key) for name, edge in (model.edges or {}).items() for key in _said(edge, _OF_EDGES)
    ]


def _said(model: object, keys: tuple[str, ...]) -> list[str]:
    """Those of the keys that have not the value that they have by default."""
    defaults = type(model).model_fields  # type: ignore[attr-defined]
    return [key for key in keys if getattr(model, key) != defaults[key].default]
