"""The hierarchy H = (nodes, N₀, F) of definition 2."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from hierax.runtime.core.binding import BoundNode, Call, OperatorSetting, bind_edge, require_no_world, require_world
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.graph import check_graph, neighbours, topological_order
from hierax.runtime.core.node import Node, World
from hierax.schemas.rates import Pair


@dataclass(frozen=True)
class Edge:
    """The triple ⟨φ, ψ, ϱ⟩ that joins a lower and an upper node; None is the function to the empty set.

    Attributes:
        lower, upper: names of the nodes.
        sense: φ, from the lower node's belief to observations of the upper one.
        task: ψ, from the upper node's actions to task parameters of the lower one.
        context: ϱ, from the upper node's belief to context elements of the lower one.
    """

    lower: str
    upper: str
    sense: Callable[..., Elements] | None = None
    task: Callable[..., Elements] | None = None
    context: Callable[..., Elements] | None = None

    @property
    def pair(self) -> Pair:
        """The names, lower first."""
        return (self.lower, self.upper)


@dataclass(frozen=True)
class BoundEdge:
    """An edge's functions as the core calls them."""

    lower: str
    upper: str
    sense: Call | None
    task: Call | None
    context: Call | None

    @staticmethod
    def of(edge: Edge, setting: OperatorSetting) -> "BoundEdge":
        """Bind the functions that an edge has."""
        functions = {"sense": edge.sense, "task": edge.task, "context": edge.context}
        calls = {kind: bind_edge(each, *edge.pair, kind, setting) for kind, each in functions.items()}
        return BoundEdge(edge.lower, edge.upper, **calls)


@dataclass(frozen=True)
class Hierarchy:
    """Nodes and edges that form a cognitive hierarchy.

    Args:
        nodes: by name.
        world: the name of N₀; its node derives from `World`.
        edges: in any order.
        setting: the run's seed, and what drives async operators.

    Raises:
        HierarchyError: they form none; with the reason and the names. See
            `hierax.runtime.core.graph.check_graph` and `BoundNode`.
    """

    nodes: Mapping[str, Node]
    world: str
    edges: Sequence[Edge]
    setting: OperatorSetting = field(default_factory=OperatorSetting)
    bound: Mapping[str, BoundNode] = field(init=False, repr=False)
    bound_edges: Mapping[Pair, BoundEdge] = field(init=False, repr=False)
    order: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pairs = [edge.pair for edge in self.edges]
        check_graph(self.world, self.nodes, pairs)
        require_world(self.world, self.nodes[self.world])
        for name in sorted(self.nodes.keys() - {self.world}):
            require_no_world(name, self.nodes[name])
        below, above = neighbours(pairs)
        bound = {
            name: BoundNode(name, node, below.get(name, ()), above.get(name, ()), self.setting)
            for name, node in sorted(self.nodes.items())
        }
        edges = {edge.pair: BoundEdge.of(edge, self.setting) for edge in self.edges}
        object.__setattr__(self, "bound", bound)
        object.__setattr__(self, "bound_edges", edges)
        object.__setattr__(self, "order", topological_order(self.nodes, pairs))

    def below(self, name: str) -> tuple[str, ...]:
        """Names of the nodes that `name` senses, in order."""
        return self.bound[name].below

    def above(self, name: str) -> tuple[str, ...]:
        """Names of the nodes that sense `name`, in order."""
        return self.bound[name].above

    @property
    def world_node(self) -> World:
        return require_world(self.world, self.nodes[self.world])
