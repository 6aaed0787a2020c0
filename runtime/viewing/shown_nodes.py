"""The nodes of a roster as objects, for what they show."""

from __future__ import annotations

from hierax.runtime.core.node import Node
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_node
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value


class ShownNodes:
    """Builds the nodes that may be loaded; one whose class and parameters stay is kept."""

    def __init__(self, allowance: Allowance) -> None:
        self._allowance = allowance
        self._built: dict[str, tuple[bytes, Node]] = {}

    def node(self, roster: Roster, name: str) -> Node:
        """A node of a roster. Raises `NotAllowedError` or `LoadError` if it may not, or cannot, be loaded."""
        reference = roster.nodes[name]
        key = encode_value(reference.plain())
        if name not in self._built or self._built[name][0] != key:
            self._built[name] = (key, build_node(reference, f"nodes.{name}", self._allowance, name == roster.world))
        return self._built[name][1]
