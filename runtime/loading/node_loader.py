"""From a version of the roster to one node's wiring, as its process needs it."""

import inspect
import logging
from collections.abc import Awaitable, Iterator, Sequence
from difflib import SequenceMatcher
from typing import Any

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.graph import neighbours
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.runtime.core.node import Node, World
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import bind_edge, bind_node, build_edge, build_node
from hierax.schemas.roster import Roster, RosterEdge, plain_edge
from hierax.schemas.values import encode_value

NEAR = 0.8  # how alike two names are, from 0 to 1, of which one is taken for the other misspelt
_log = logging.getLogger("hierax")


class NodeLoader:
    """Builds a node and its edges' functions; what a later version does not change is kept."""

    def __init__(self, name: str, setting: OperatorSetting, allowance: Allowance) -> None:
        self._name = name
        self._setting = setting
        self._allowance = allowance
        self._nodes: dict[bytes, Node] = {}
        self._edges: dict[bytes, BoundEdge] = {}
        self._bound: BoundNode | None = None

    def wiring(self, roster: Roster) -> Wiring:
        """The node's wiring under a version of the roster; `NotAllowedError` or `LoadError` if it cannot be had."""
        if self._name == roster.world:  # it answers for the others, too
            self._allowance.check_all(roster)
        self._allowance.check_part(roster, self._name)
        edges = roster.edges_of(self._name)
        bound = self._bind(roster, edges)
        place = Place.of(roster, hashed=self._name == roster.world)
        return Wiring(bound, [self._edge(edge) for edge in edges], place)

    def _bind(self, roster: Roster, edges: Sequence[RosterEdge]) -> BoundNode:
        """The node with its neighbours; where neither changes the same one, as looking at operators takes long."""
        name, node, last = self._name, self._node(roster), self._bound
        below, above = (each.get(name, ()) for each in neighbours(edge.pair for edge in edges))
        if last is None or last.node is not node or (last.below, last.above) != (below, above):
            last = self._bound = bind_node(name, node, roster.world, below, above, self._setting)
        return last

    def _node(self, roster: Roster) -> Node:
        reference = roster.nodes[self._name]
        key = encode_value(reference.plain())
        if key not in self._nodes:
            node = build_node(reference, f"nodes.{self._name}", self._allowance, self._name == roster.world)
            for what in misspelt_operators(type(node)):
                _log.warning("%s: %s", self._name, what)
            self._nodes = {key: node}
        return self._nodes[key]

    def _edge(self, edge: RosterEdge) -> BoundEdge:
        side = "lower" if self._name == edge.lower else "upper"
        key = encode_value(plain_edge(edge))
        if key not in self._edges:
            self._edges[key] = bind_edge(build_edge(edge, self._allowance, side), self._setting)
        return self._edges[key]


def misspelt_operators(given: type) -> list[str]:
    """What is wrong with the names of a node class's methods, a line for each. A public method counts that overrides
    nothing and whose name is near that of an operator which the class does not define either; a helper beside the
    operator that it is named after is none."""
    base: type = World if issubclass(given, World) else Node
    operators = [name for name, _ in _methods(base)]
    left_out = [name for name in operators if getattr(given, name) is getattr(base, name)]
    found = []
    for name, defined in _methods(given):
        near = [] if name in operators else [each for each in left_out if _alike(name, each) >= NEAR]
        if near:
            meant = max(near, key=lambda each: _alike(name, each))
            found.append(
                f"{defined.__module__}:{defined.__qualname__} defines {name!r}, which nothing calls; did you mean "
                f"{meant!r}? (else begin its name with an underscore)"
            )
    return found


def _methods(of: type) -> Iterator[tuple[str, type]]:
    """The public methods of a class, by name, and the class that defines each; what every object has left out."""
    for name in sorted(dir(of)):
        defined = next((each for each in of.__mro__ if name in vars(each)), object)
        if not name.startswith("_") and defined is not object and inspect.isroutine(inspect.getattr_static(of, name)):
            yield name, defined


def _alike(one: str, other: str) -> float:
    return SequenceMatcher(None, one.lower(), other.lower()).ratio()


def wait_for(awaitable: Awaitable[Any]) -> Any:
    """Drive an async operator, in an event loop of its own; beside one that this thread has, as in a notebook, in
    another thread."""
    import asyncio
    from concurrent.futures import ThreadPoolExecutor

    import anyio

    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return anyio.run(lambda: awaitable)
    with ThreadPoolExecutor(1) as beside:
        return beside.submit(anyio.run, lambda: awaitable).result()
