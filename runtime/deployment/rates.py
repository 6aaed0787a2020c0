"""What a deployment file says of rates: `every` and `offset` of nodes, `delay` and `gather` of edges."""

from hierax.runtime.core.rates import EVERY_EPOCH, Rates, Turns
from hierax.runtime.deployment.deployment import Document, Keys
from hierax.runtime.deployment.models import DeploymentModel, SnippetModel, split_edge

_OF_NODES = ("every", "offset")
_OF_EDGES = ("delay", "gather")


def rates_of(model: DeploymentModel, document: Document) -> Rates:
    """The rates of a hierarchy. Raises `DeploymentError` if something means nothing where it stands."""
    for name, node in model.nodes.items():
        if node.offset >= node.every:
            what = f"expected less than every, {node.every}, got {node.offset}"
            raise document.error(("nodes", name, "offset"), what)
    if (every := model.nodes[model.world].every) != 1:
        what = f"the world takes part in every epoch; expected 1, got {every}"
        raise document.error(("nodes", model.world, "every"), what)
    for name, edge in model.edges.items():
        if edge.gather and edge.sense is None:
            raise document.error(("edges", name, "gather"), "means something only with a function 'sense'")
    turns = {name: Turns(node.every, node.offset) for name, node in model.nodes.items()}
    pairs = {split_edge(name): edge for name, edge in model.edges.items()}
    rates = Rates(
        {name: each for name, each in turns.items() if each != EVERY_EPOCH},
        {pair: edge.delay for pair, edge in pairs.items() if edge.delay},
        frozenset(pair for pair, edge in pairs.items() if edge.gather),
    )
    if rates and model.staleness != 0:
        raise document.error(rated_keys(model)[0], "goes with a staleness of 0 only")
    if rates and model.low_latency:
        what = "goes without rates only: nodes that do not wait for one another may fill its links"
        raise document.error(("low_latency",), what)
    return rates


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
