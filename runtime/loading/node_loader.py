"""From a version of the roster to one node's wiring, as its process needs it."""

from __future__ import annotations

import logging

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.graph import Pair
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.runtime.core.node import Node
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import bind_edge, bind_node, build_edge, build_node
from hierax.runtime.loading.spelling import misspelt_operators
from hierax.schemas.roster import Roster, RosterEdge
from hierax.schemas.values import encode_value

_log = logging.getLogger("hierax")


class NodeLoader:
    """Builds a node and its edges' functions; what a later version does not change is kept.

    Args:
        name: of the node.
        setting: the run's seed, and what drives async operators.
        allowance: which code may be loaded.
    """

    def __init__(self, name: str, setting: OperatorSetting, allowance: Allowance) -> None:
        self._name = name
        self._setting = setting
        self._allowance = allowance
        self._nodes: dict[bytes, Node] = {}
        self._edges: dict[RosterEdgeKey, BoundEdge] = {}
        self._bound: BoundNode | None = None
        self._pairs: list[Pair] = []

    def wiring(self, roster: Roster) -> Wiring:
        """The node's wiring under a version of the roster.

        Raises:
            NotAllowedError: something may not be loaded; then nothing is.
            LoadError: something cannot be loaded or called.
        """
        if self._name == roster.world:  # it answers for the others, too
            self._allowance.check_all(roster)
        self._allowance.check_part(roster, self._name)
        edges = [edge for edge in roster.edges if self._name in edge.pair]
        bound = self._bind(roster, [edge.pair for edge in edges])
        place = Place.of(roster, hashed=self._name == roster.world)
        return Wiring(bound, [self._edge(edge) for edge in edges], place)

    def _bind(self, roster: Roster, pairs: list[Pair]) -> BoundNode:
        """The node with its neighbours; where neither changes the same one, as looking at operators takes long."""
        name, node, last = self._name, self._node(roster), self._bound
        if last is not None and last.node is node and sorted(pairs) == self._pairs:
            return last
        self._bound, self._pairs = bind_node(name, node, roster.world, pairs, self._setting), sorted(pairs)
        return self._bound

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
        functions = [None if part is None else part.plain() for part in (edge.sense, edge.task, edge.context)]
        key = (edge.pair, encode_value(functions))
        if key not in self._edges:
            self._edges[key] = bind_edge(build_edge(edge, self._allowance, side), self._setting, side)
        return self._edges[key]


RosterEdgeKey = tuple[tuple[str, str], bytes]
"""An edge's pair and its functions, encoded."""
