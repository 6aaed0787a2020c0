"""What a change makes of a roster, and whom that touches: pure functions.

Every roster that comes out of here is valid as a deployment file's is, if the one that
went in was; a change that would break it is refused in one line."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hierax.runtime.core.errors import HierarchyError, HieraxError
from hierax.runtime.core.graph import check_graph, unreached
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.rates import EVERY_EPOCH, EdgeRates, Pair, Rates, Timing, Turns
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge
from hierax.schemas.values import encode_value


class ChangeError(HieraxError):
    """A change of the roster is refused: which one, and why."""


@dataclass(frozen=True)
class Undo:
    """What a node has replaced takes its place again, with its process. Nobody asks for it: it follows on a failure."""

    name: str  # of the node
    before: Roster  # the roster before it was replaced


def apply(roster: Roster, change: Change | Undo, version: int) -> Roster:
    """The roster after a change, under a version that no roster of the run has had, also none that was only prepared.

    That version is the instance number of each node that is attached or replaced, so that no two processes of a node
    have the same; all others keep theirs. Raises `ChangeError` if it cannot be done; says why, and the nearest valid
    name."""
    if isinstance(change, Attach):
        return _attach(roster, change, version)
    if isinstance(change, Detach):
        return _detach(roster, change, version)
    if isinstance(change, Undo):
        return _undo(roster, change, version)
    return _replace(roster, change, version)


def next_roster(roster: Roster, change: Change | Undo) -> Roster:
    """The roster after a change, under the next version; raises as `apply` does."""
    return apply(roster, change, roster.version + 1)


def touched(old: Roster, new: Roster) -> frozenset[str]:
    """The nodes that must be ready for a roster before it takes effect.

    A node of `new` is touched if it is new itself, or if of what its engine is made of anything is another: its class
    and parameters, its instance, its neighbours, their instances, one of its edges, or, with rates, in which epochs it
    or one above it is sent observations."""
    before, after = _joints(old), _joints(new)
    return frozenset(name for name, joint in after.items() if before.get(name) != joint)


def removed(old: Roster, new: Roster) -> frozenset[str]:
    return frozenset(old.nodes.keys() - new.nodes.keys())


def _attach(roster: Roster, change: Attach, version: int) -> Roster:
    what = f"cannot attach {_list(change.nodes)}" if change.nodes else "cannot attach"
    if not change.nodes:
        raise ChangeError(f"{what}: no node is given")
    for name in sorted(change.nodes):
        if name == roster.world:
            raise ChangeError(f"{what}: {name!r} is the world's name")
        if name in roster.nodes:
            raise ChangeError(f"{what}: there is a node {name!r} already; replace it, or detach it first")
    nodes = {**roster.nodes, **change.nodes}
    _check_ends(change.edges, nodes, what)
    for edge in change.edges:
        if edge.lower not in change.nodes and edge.upper not in change.nodes:
            raise ChangeError(f"{what}: edge {edge.name} joins two other nodes; it must join one that is attached")
    edges = (*roster.edges, *change.edges)
    _check_hierarchy(roster.world, nodes, edges, what)
    new = dict.fromkeys(sorted(change.nodes), version)
    return _with_timing(roster, _successor(roster, version, nodes, edges, new, change.turns), change.nodes.keys(), what)


def _detach(roster: Roster, change: Detach, version: int) -> Roster:
    what = f"cannot detach {change.name!r}"
    _check_known(change.name, roster, what)
    if change.name == roster.world:
        raise ChangeError(f"{what}: it is the world; stop the run instead")
    staying = roster.nodes.keys() - {change.name}
    pairs = [edge.pair for edge in roster.edges if change.name not in edge.pair]
    lost = frozenset(unreached(roster.world, staying, pairs))
    if lost and not change.cascade:
        raise ChangeError(
            f"{what}: only it joins {_list(lost)} to the world; detach {'it' if len(lost) == 1 else 'them'} first, "
            "or cascade (--cascade)"
        )
    staying -= lost
    nodes = {name: node for name, node in roster.nodes.items() if name in staying}
    edges = [edge for edge in roster.edges if edge.lower in nodes and edge.upper in nodes]
    _check_hierarchy(roster.world, nodes, edges, what)
    return _with_timing(roster, _successor(roster, version, nodes, edges, {}), (), what)


def _replace(roster: Roster, change: Replace, version: int) -> Roster:
    name = change.name
    what = f"cannot replace {name!r}"
    _check_known(name, roster, what)
    if name == roster.world:
        raise ChangeError(
            f"{what}: it is the world, whose process owns the roster and the run's history; start another run"
        )
    edges = roster.edges
    if change.edges is not None:
        _check_ends(change.edges, roster.nodes, what)
        for edge in change.edges:
            if name not in edge.pair:
                raise ChangeError(f"{what}: edge {edge.name} does not join it")
        edges = (*(edge for edge in edges if name not in edge.pair), *change.edges)
    nodes = {**roster.nodes, name: change.reference}
    _check_hierarchy(roster.world, nodes, edges, what)
    turns = {} if change.turns is None else {name: change.turns}
    after = _successor(roster, version, nodes, edges, {name: version}, turns)
    return _with_timing(roster, after, (), what)


def _undo(roster: Roster, change: Undo, version: int) -> Roster:
    name, before = change.name, change.before
    nodes = {**roster.nodes, name: before.nodes[name]}
    had = [edge for edge in before.edges if name in edge.pair and edge.lower in nodes and edge.upper in nodes]
    edges = [*(edge for edge in roster.edges if name not in edge.pair), *had]
    _check_hierarchy(roster.world, nodes, edges, f"cannot undo what has replaced {name!r}")
    after = _successor(roster, version, nodes, edges, {})
    return replace(after, instances={**after.instances, name: before.instance(name)})


def _successor(
    roster: Roster,
    version: int,
    nodes: Mapping[str, Reference],
    edges: Iterable[RosterEdge],
    instances: Mapping[str, int],
    turns: Mapping[str, Turns] = {},  # of nodes that are new, or have other ones
) -> Roster:
    if version <= roster.version:
        raise ValueError(f"roster version {version} does not follow {roster.version}")
    kept = {name: number for name, number in roster.instances.items() if name in nodes}
    ordered = tuple(sorted(edges, key=lambda edge: edge.pair))
    then = {name: each for name, each in {**roster.turns, **turns}.items() if name in nodes and each != EVERY_EPOCH}
    return Roster(roster.world, nodes, ordered, version, {**kept, **instances}, then, roster.timing)


def _with_timing(old: Roster, new: Roster, came: Collection[str], what: str) -> Roster:
    """What of a roster's rates counts from its first epoch on. Raises `ChangeError` where it cannot have any."""
    before = old.rates
    if before is None:
        if new.turns or any(edge.delay or edge.gather for edge in new.edges):
            raise ChangeError(f"{what}: no node has rates in this run; 'rates: true' in its deployment file lets them")
        return new
    timing, known = before.timing, {edge.pair: edge for edge in old.edges}
    others = {name for name in new.nodes if new.turns.get(name) != old.turns.get(name)}
    changed: dict[Pair, EdgeRates | None] = {}
    for edge in new.edges:
        pair, was = edge.pair, known.get(edge.pair)
        if was is None:
            changed[pair] = None
        elif pair in timing.changed:
            changed[pair] = timing.changed[pair]
        elif edge.upper in others or edge.delay != was.delay:
            changed[pair] = before.edge(*pair)
    fresh = {name for name in new.nodes if name in timing.fresh or name in others or name in came}
    since = {name: epoch for name, epoch in timing.since.items() if name in new.nodes and name not in fresh}
    began = {pair: each for pair, each in timing.began.items() if pair in known and pair not in changed}
    began = {pair: each for pair, each in began.items() if pair in new.pairs}
    return replace(new, timing=Timing(since, began, frozenset(fresh), changed))


def _check_known(name: str, roster: Roster, what: str) -> None:
    if name not in roster.nodes:
        raise ChangeError(f"{what}: there is no such node{did_you_mean(name, roster.nodes, 'the nodes are')}")


def _check_ends(edges: Iterable[RosterEdge], nodes: Iterable[str], what: str) -> None:
    for edge in edges:
        for end in edge.pair:
            if end not in nodes:
                nearest = did_you_mean(end, nodes, "the nodes are")
                raise ChangeError(f"{what}: edge {edge.name} names {end!r}, and there is no such node{nearest}")


def _check_hierarchy(world: str, nodes: Iterable[str], edges: Iterable[RosterEdge], what: str) -> None:
    try:
        check_graph(world, nodes, [edge.pair for edge in edges])
    except HierarchyError as error:
        raise ChangeError(f"{what}: {error}") from error


def _joints(roster: Roster) -> Mapping[str, bytes]:
    """What each node's engine is made of; encoded, as parameters may hold arrays, and as 1, 1.0 and true differ."""
    content: Any = roster.content()
    rates = roster.rates or Rates()
    passed = {name: [turns.plain() for turns in rates.passes(name)] for name in roster.nodes}
    joints: dict[str, list[Any]] = {
        name: [node, name == roster.world, roster.instance(name), passed[name]]
        for name, node in content["nodes"].items()
    }
    for edge in content["edges"]:
        instances = (roster.instance(edge["lower"]), roster.instance(edge["upper"]))
        joints[edge["lower"]].append((edge, instances, passed[edge["upper"]]))
        joints[edge["upper"]].append((edge, instances))
    return {name: encode_value(joint) for name, joint in joints.items()}


def _list(names: Iterable[str]) -> str:
    return ", ".join(repr(name) for name in sorted(names))
