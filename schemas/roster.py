"""The roster: which nodes and edges a hierarchy has, and changes of it, as data that can travel.

Its content (names, classes, parameters, edges) is what the epoch's digest covers;
version and instance numbers are not, so that a run with restarts is still the same run. A change says what is wanted,
not what the roster is after it: its owner decides that (`hierax.runtime.owner.roster_changes`)."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import blake2b
from typing import Any

from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import check_name
from hierax.schemas.limits import MAX_EPOCHS_APART
from hierax.schemas.messages import DIGEST_BYTES
from hierax.schemas.rates import Rates, Timing, Turns
from hierax.schemas.values import Value, encode_value

FUNCTIONS = ("sense", "task", "context")
"""An edge's functions."""


@dataclass(frozen=True)
class Reference:
    """Names code: a class or function by its target, ``package.module:name``, and the parameters as keyword arguments,
    of the class, or beside the operator's own ones."""

    target: str
    parameters: Mapping[str, Value] = field(default_factory=dict)

    def plain(self) -> Value:
        return {"target": self.target, "parameters": dict(self.parameters)}

    @staticmethod
    def read(value: Value, where: str) -> "Reference":
        """Read it from a value. Raises `SchemaError` if it is no reference."""
        fields = read_mapping(value, {"target", "parameters"}, where)
        target, parameters = fields["target"], fields["parameters"]
        if not isinstance(target, str) or target.count(":") != 1:
            raise SchemaError(f"expected 'package.module:name', got {shown(target)}", f"{where}.target")
        if not isinstance(parameters, dict):
            raise SchemaError("expected a map", f"{where}.parameters")
        return Reference(target, parameters)


@dataclass(frozen=True)
class ProbeSpec:
    """A probe of a node: no part of the roster, as the run does not depend on it. It may `overwrite` the files of
    another run, or not."""

    node: str
    reference: Reference
    overwrite: bool = False


@dataclass(frozen=True)
class RosterEdge:
    """An edge by names; a function that is None gives the empty set."""

    lower: str
    upper: str
    sense: Reference | None = None
    task: Reference | None = None
    context: Reference | None = None
    delay: int = 0  # after how many epochs context and tasks count below
    gather: bool = False  # whether the upper node has all observations since its last turn

    @property
    def name(self) -> str:
        """Its name, as ``lower->upper``."""
        return f"{self.lower}->{self.upper}"

    @property
    def pair(self) -> tuple[str, str]:
        """The names, lower first."""
        return (self.lower, self.upper)


@dataclass(frozen=True)
class Roster:
    """The versioned list of nodes and edges.

    Attributes:
        world: name of N₀.
        nodes: class and parameters by name.
        edges: by name of the lower, then of the upper node.
        version: totally ordered.
        instances: per node, new whenever its process is.
        turns: of nodes that do not take part in every epoch.
        timing: since when nodes and edges have their rates; None: nobody has any, and all epochs end for all at once.
    """

    world: str
    nodes: Mapping[str, Reference]
    edges: tuple[RosterEdge, ...]
    version: int = 0
    instances: Mapping[str, int] = field(default_factory=dict)
    turns: Mapping[str, Turns] = field(default_factory=dict)
    timing: Timing | None = None

    @cached_property
    def rates(self) -> Rates | None:
        """How often nodes take part, and how much later predictions count; None: nobody has rates."""
        if self.timing is None:
            return None
        delays = {edge.pair: edge.delay for edge in self.edges if edge.delay}
        gathers = frozenset(edge.pair for edge in self.edges if edge.gather)
        return Rates(self.turns, delays, gathers, self.timing, self.pairs)

    def with_rates(self, rates: Rates) -> "Roster":
        """The same nodes and edges with these rates."""
        edges = [
            replace(edge, delay=rates.delays.get(edge.pair, 0), gather=edge.pair in rates.gathers)
            for edge in self.edges
        ]
        return replace(self, edges=tuple(edges), turns=rates.turns, timing=rates.timing)

    def is_as(self, other: "Roster") -> bool:
        """Whether another one is the same, known or not since when it is in force."""
        one, two = (replace(each, timing=None).plain() for each in (self, other))
        return encode_value(one) == encode_value(two)

    def as_of(self, epoch: int) -> "Roster":
        """The same once its first epoch is known."""
        return self if self.timing is None else replace(self, timing=self.timing.as_of(epoch))

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The edges by their names, lower first."""
        return tuple(edge.pair for edge in self.edges)

    def below(self, name: str) -> tuple[str, ...]:
        """The nodes right below one, by name."""
        return tuple(sorted(edge.lower for edge in self.edges_of(name) if edge.upper == name))

    def above(self, name: str) -> tuple[str, ...]:
        """The nodes right above one, by name."""
        return tuple(sorted(edge.upper for edge in self.edges_of(name) if edge.lower == name))

    @cached_property
    def tasking(self) -> frozenset[tuple[str, str]]:
        """The edges that have a task function, by their names, lower first."""
        return frozenset(edge.pair for edge in self.edges if edge.task is not None)

    def edges_of(self, name: str) -> tuple[RosterEdge, ...]:
        """The edges that join a node to others."""
        return self._edges_by_node.get(name, ())

    @cached_property
    def _edges_by_node(self) -> Mapping[str, tuple[RosterEdge, ...]]:
        found: dict[str, list[RosterEdge]] = {}
        for edge in self.edges:
            for end in dict.fromkeys(edge.pair):
                found.setdefault(end, []).append(edge)
        return {name: tuple(edges) for name, edges in found.items()}

    def content(self) -> Value:
        """What the run's meaning depends on."""
        return {
            "world": self.world,
            "nodes": plain_nodes(self.nodes),
            "edges": [plain_edge(edge) for edge in sorted(self.edges, key=lambda edge: edge.pair)],
            **_plain_turns(self.turns),
        }

    def content_hash(self) -> bytes:
        """BLAKE2b-256 over the encoding of the content."""
        return blake2b(encode_value(self.content()), digest_size=DIGEST_BYTES).digest()

    def instance(self, name: str) -> int:
        """The instance number of a node."""
        return self.instances.get(name, 0)

    def plain(self) -> Value:
        timing = {} if self.timing is None else {"timing": self.timing.plain()}
        return {**self.content(), "version": self.version, "instances": dict(self.instances), **timing}

    @staticmethod
    def read(value: Value) -> "Roster":
        """Read it from a value. Raises `SchemaError` if it is no roster; says which field and what was expected."""
        fields = read_mapping(value, {"world", "nodes", "edges", "version", "instances"}, "roster", {"turns", "timing"})
        instances = fields["instances"]
        nodes, edges = read_nodes(fields["nodes"], "roster.nodes"), read_edges(fields["edges"], "roster.edges")
        if not isinstance(instances, dict):
            raise SchemaError("expected a map", "roster.instances")
        world, version = read_name(fields["world"], "roster.world"), _whole(fields["version"], "roster.version")
        where = "roster.instances"
        numbers = {read_name(name, where): _whole(number, f"{where}.{name}") for name, number in instances.items()}
        turns = _read_turns(fields.get("turns", {}), nodes, "roster.turns")
        timing = Timing.read(fields["timing"], "roster.timing") if "timing" in fields else None
        return Roster(world, nodes, edges, version, numbers, turns, timing)


def plain_nodes(nodes: Mapping[str, Reference]) -> Value:
    """Nodes as a value, by name in alphabetical order."""
    return {name: nodes[name].plain() for name in sorted(nodes)}


def plain_edge(edge: RosterEdge) -> Value:
    functions = {kind: getattr(edge, kind) for kind in FUNCTIONS}
    plain = {kind: None if function is None else function.plain() for kind, function in functions.items()}
    rates = {**({"delay": edge.delay} if edge.delay else {}), **({"gather": True} if edge.gather else {})}
    return {"lower": edge.lower, "upper": edge.upper, **plain, **rates}


def _plain_turns(turns: Mapping[str, Turns]) -> dict[str, Value]:
    return {"turns": {name: turns[name].plain() for name in sorted(turns)}} if turns else {}


def _read_turns(value: Value, nodes: Mapping[str, Reference], where: str) -> dict[str, Turns]:
    if not isinstance(value, dict) or not value.keys() <= nodes.keys():
        raise SchemaError("expected a map with some of the nodes", where)
    return {name: Turns.read(turns, f"{where}.{name}") for name, turns in value.items()}


def read_nodes(value: Value, where: str) -> dict[str, Reference]:
    """Nodes from a value, by name. Raises `SchemaError` if they are none."""
    if not isinstance(value, dict):
        raise SchemaError("expected a map", where)
    return {read_name(name, where): Reference.read(node, f"{where}.{name}") for name, node in value.items()}


def read_edges(value: Value, where: str) -> tuple[RosterEdge, ...]:
    """Edges from a value. Raises `SchemaError` if they are none."""
    if not isinstance(value, (list, tuple)):
        raise SchemaError("expected a list", where)
    return tuple(_read_edge(edge, f"{where}[{index}]") for index, edge in enumerate(value))


def _read_edge(value: Value, where: str) -> RosterEdge:
    fields = read_mapping(value, {"lower", "upper", *FUNCTIONS}, where, {"delay", "gather"})
    lower, upper = read_name(fields["lower"], f"{where}.lower"), read_name(fields["upper"], f"{where}.upper")
    given = {kind: Reference.read(fields[kind], f"{where}.{kind}") for kind in FUNCTIONS if fields[kind] is not None}
    delay, gather = _whole(fields.get("delay", 0), f"{where}.delay"), fields.get("gather", False)
    if delay > MAX_EPOCHS_APART:
        raise SchemaError(f"expected at most {MAX_EPOCHS_APART}, got {delay}", f"{where}.delay")
    if type(gather) is not bool:
        raise SchemaError(f"expected true or false, got {shown(gather)}", f"{where}.gather")
    return RosterEdge(lower, upper, **given, delay=delay, gather=gather)


def read_name(value: Value, where: str) -> str:
    """A node's name from a value. Raises `SchemaError` if it is none."""
    return check_name(value, "node's name", where)


def _whole(value: Value, where: str) -> int:
    if type(value) is not int or value < 0:
        raise SchemaError(f"expected a whole number from 0, got {shown(value)}", where)
    return value


def read_mapping(value: Value, keys: set[str], where: str, optional: Collection[str] = frozenset()) -> dict[str, Any]:
    """A map that has these keys, perhaps optional ones, and no others. Raises `SchemaError` if the value is none."""
    if not isinstance(value, dict) or set(value).difference(optional) != keys:
        raise SchemaError(f"expected a map with the keys {', '.join(sorted(keys))}", where)
    return value


@dataclass(frozen=True)
class Attach:
    """New nodes, class and parameters by name, and the edges that join them to each other and to what is there: each
    joins at least one of the nodes. `turns`: of those that do not take part in every epoch."""

    nodes: Mapping[str, Reference]
    edges: tuple[RosterEdge, ...] = ()
    turns: Mapping[str, Turns] = field(default_factory=dict)

    def plain(self) -> Value:
        edges = [plain_edge(each) for each in self.edges]
        return {"change": "attach", "nodes": plain_nodes(self.nodes), "edges": edges, **_plain_turns(self.turns)}


@dataclass(frozen=True)
class Detach:
    """The node of a name goes, and its edges with it; with `cascade` what only it joins to the world goes as well, else
    the change is refused where there is such a node."""

    name: str
    cascade: bool = False

    def plain(self) -> Value:
        return {"change": "detach", "name": self.name, "cascade": self.cascade}


@dataclass(frozen=True)
class Replace:
    """Another node, of the class and parameters of a reference, takes the place and the belief of the node of a name,
    and has these edges and turns from then on; None: those that it has."""

    name: str
    reference: Reference
    edges: tuple[RosterEdge, ...] | None = None
    turns: Turns | None = None

    def plain(self) -> Value:
        edges = None if self.edges is None else [plain_edge(edge) for edge in self.edges]
        plain = {"change": "replace", "name": self.name, "reference": self.reference.plain(), "edges": edges}
        return plain if self.turns is None else {**plain, "turns": self.turns.plain()}


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
    if not isinstance(kind, str):  # an array, compared with a text, is an array
        raise SchemaError(f"expected attach, detach or replace, got {shown(kind)}", "change.change")
    if kind == "attach":
        fields = read_mapping(value, {"change", "nodes", "edges"}, "change", {"turns"})
        nodes, edges = read_nodes(fields["nodes"], "change.nodes"), read_edges(fields["edges"], "change.edges")
        return Attach(nodes, edges, _read_turns(fields.get("turns", {}), nodes, "change.turns"))
    if kind == "detach":
        fields = read_mapping(value, {"change", "name", "cascade"}, "change")
        if not isinstance(fields["cascade"], bool):
            raise SchemaError(f"expected true or false, got {shown(fields['cascade'])}", "change.cascade")
        return Detach(read_name(fields["name"], "change.name"), fields["cascade"])
    if kind == "replace":
        fields = read_mapping(value, {"change", "name", "reference", "edges"}, "change", {"turns"})
        name, edges = read_name(fields["name"], "change.name"), fields["edges"]
        reference = Reference.read(fields["reference"], "change.reference")
        turns = Turns.read(fields["turns"], "change.turns") if "turns" in fields else None
        return Replace(name, reference, None if edges is None else read_edges(edges, "change.edges"), turns)
    raise SchemaError(f"expected attach, detach or replace, got {shown(kind)}", "change.change")
