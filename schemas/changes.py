"""Changes of a roster, as data that travels: from whoever asks for one to the roster's owner.

Each says what is wanted, not what the roster is after it: that depends on the roster
which it finds, and its owner decides (`hierax.runtime.owner.roster_changes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.roster import (
    Reference,
    RosterEdge,
    plain_edge,
    plain_nodes,
    read_edges,
    read_mapping,
    read_name,
    read_nodes,
)
from hierax.schemas.values import Value


@dataclass(frozen=True)
class Attach:
    """New nodes, and the edges that join them to each other and to what is there.

    Attributes:
        nodes: class and parameters by name.
        edges: each joins at least one of the nodes.
    """

    nodes: Mapping[str, Reference]
    edges: tuple[RosterEdge, ...] = ()

    def plain(self) -> Value:
        """Give it as a value."""
        return {
            "change": "attach",
            "nodes": plain_nodes(self.nodes),
            "edges": [plain_edge(each) for each in self.edges],
        }


@dataclass(frozen=True)
class Detach:
    """A node goes, and its edges with it.

    Attributes:
        name: of the node.
        cascade: what only it joins to the world goes as well; else the change is refused where there is such a node.
    """

    name: str
    cascade: bool = False

    def plain(self) -> Value:
        """Give it as a value."""
        return {"change": "detach", "name": self.name, "cascade": self.cascade}


@dataclass(frozen=True)
class Replace:
    """Another node takes a node's place and belief.

    Attributes:
        name: of the node.
        reference: the new class and parameters.
        edges: all that the node has from then on; None: those that it has.
    """

    name: str
    reference: Reference
    edges: tuple[RosterEdge, ...] | None = None

    def plain(self) -> Value:
        """Give it as a value."""
        edges = None if self.edges is None else [plain_edge(edge) for edge in self.edges]
        return {"change": "replace", "name": self.name, "reference": self.reference.plain(), "edges": edges}


Change = Attach | Detach | Replace
"""Any change of a roster that can be asked for."""


def new_nodes(change: Change) -> Mapping[str, Reference]:
    """The nodes for which a change needs processes, by name."""
    if isinstance(change, Attach):
        return change.nodes
    return {change.name: change.reference} if isinstance(change, Replace) else {}


def read_change(value: Value) -> Change:
    """A change of any kind from a value. Raises `SchemaError` if it is none; says which field and what was expected."""
    if not isinstance(value, dict):
        raise SchemaError(f"expected a map, got {shown(value)}", "change")
    kind = value.get("change")
    if kind == "attach":
        fields = read_mapping(value, {"change", "nodes", "edges"}, "change")
        return Attach(read_nodes(fields["nodes"], "change.nodes"), read_edges(fields["edges"], "change.edges"))
    if kind == "detach":
        fields = read_mapping(value, {"change", "name", "cascade"}, "change")
        if not isinstance(fields["cascade"], bool):
            raise SchemaError(f"expected true or false, got {shown(fields['cascade'])}", "change.cascade")
        return Detach(read_name(fields["name"], "change.name"), fields["cascade"])
    if kind == "replace":
        fields = read_mapping(value, {"change", "name", "reference", "edges"}, "change")
        name, edges = read_name(fields["name"], "change.name"), fields["edges"]
        reference = Reference.read(fields["reference"], "change.reference")
        return Replace(name, reference, None if edges is None else read_edges(edges, "change.edges"))
    raise SchemaError(f"expected attach, detach or replace, got {shown(kind)}", "change.change")
