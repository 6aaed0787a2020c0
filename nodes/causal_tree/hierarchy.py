"""From a network to a hierarchy: a deployment with a process for each node, or for each part; and its N₀, which shows
one evidence set after the other."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.errors import NetworkError
from hierax.nodes.causal_tree.network import Description, Network, epochs_needed, parse
from hierax.nodes.causal_tree.networks import Source, likelihoods, network_from, sampled
from hierax.runtime import NO_TICK, Elements, Tick, Value, World
from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.graph import topological_order

MODULE = "hierax.nodes.causal_tree"
WORLD = "world"
MAX_DRAWN = 1 << 20  # sets, times leaves of the network
Shown = dict[str, int | tuple[float, ...]]  # an evidence set: by node, the number of its state, or likelihoods


def as_deployment(
    description: Description, sets: Sequence[Mapping[str, Any]], parts: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Any]:
    """A network as the content of a deployment file, with evidence sets as `EvidenceWorld` takes them, each shown as
    long as it takes to be exact, and by name of a hierarchy's node the network's nodes that it holds, by default each
    by itself. Raises NetworkError: it is no network, a node's id is no text, a node is in no part or in two, or the
    parts' arrows go round in a circle."""
    network = parse(description)
    unnamed = next((name for name in network.variables if not isinstance(name, str)), None)
    if unnamed is not None:
        raise NetworkError("a node of a hierarchy needs a text as its id", unnamed)
    if parts is None:
        parts = {str(name): (str(name),) for name in network.variables}
    held = _held(network, parts)
    needed = epochs_needed(network)
    arrows = ((held[name], held[parent]) for name, each in network.variables.items() for parent in each.parents)
    pairs = sorted({(lower, upper) for lower, upper in arrows if lower != upper})
    try:
        topological_order(parts, pairs)
    except HierarchyError as error:
        raise NetworkError(f"arrows between the parts go round in a circle: {error}") from None
    edges: dict[str, Any] = {f"{WORLD} -> {part}": {"sense": f"{MODULE}:evidence_seen"} for part in parts}
    for lower, upper in pairs:
        edges[f"{lower} -> {upper}"] = {"sense": f"{MODULE}:diagnostic_support", "context": f"{MODULE}:causal_support"}
    shown = {"network": "${network}", "sets": "${sets}", "hold": needed}
    nodes: dict[str, Any] = {WORLD: {"class": f"{MODULE}:EvidenceWorld", "parameters": shown}}
    for part, names in parts.items():
        parameters = {"network": "${network}", "nodes": list(names), "settle": needed}
        nodes[part] = {"class": f"{MODULE}:Part", "parameters": parameters}
    return {
        "hierarchy": "causal-tree" if network.is_tree else "polytree",
        "description": f"a Bayesian network of {len(network.variables)} nodes, in {len(parts)} parts",
        "world": WORLD,
        "parameters": {"network": [dict(entry) for entry in description], "sets": [dict(each) for each in sets]},
        "nodes": nodes,
        "edges": edges,
    }


def _held(network: Network, parts: Mapping[str, Sequence[str]]) -> dict[Any, str]:
    held: dict[Any, str] = {}
    for part, names in parts.items():
        if part == WORLD:
            raise NetworkError(f"a part cannot be named {WORLD!r}: that is N₀")
        for name in names:
            if name not in network.variables:
                raise NetworkError(f"part {part!r} holds {name!r}, which the network has not")
            if name in held:
                raise NetworkError(f"is in two parts, {held[name]!r} and {part!r}", name)
            held[name] = part
    missing = next((name for name in network.variables if name not in held), None)
    if missing is not None:
        raise NetworkError("is in no part", missing)
    return held


class EvidenceWorld(World):
    """N₀: shows evidence sets in turn, and again from the first.

    Belief: ``{"set", "age", "evidence"}``: the number of the set from 0, for how many epochs it has been shown, and
    the set itself, ``{node: likelihoods}``, or the number of a state that is certain.

    Args:
        network: as `network_from` takes it.
        sets: evidence sets: ``{node: state}`` or ``{node: likelihoods}``; an empty one is no evidence.
        draw: instead, ``{sets, share, seed}``: so many sets, in each a share of the nodes without children, in the
            states that they have in a draw from the network.
        hold: for how many epochs each set is shown.

    Raises ValueError: the parameters are wrong."""

    def __init__(
        self,
        network: Source,
        sets: Sequence[Mapping[str, Any]] | None = None,
        draw: Mapping[str, Any] | None = None,
        hold: int = 1,
    ) -> None:
        whole = network_from(network)
        if (sets is None) == (draw is None):
            raise ValueError("sets: expected either sets or draw")
        if type(hold) is not int or hold < 1:
            raise ValueError(f"hold: expected a number of epochs, at least 1, got {hold!r}")
        self._hold = hold
        self._sets = _drawn(whole, draw) if draw is not None else _written(whole, sets or ())

    def initial_belief(self) -> Value:
        """The first set, shown for the first time."""
        return {"set": 0, "age": 1, "evidence": self._sets[0]}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """Show the set again, or the next one."""
        if belief["age"] < self._hold or len(self._sets) == 1:
            return {**belief, "age": belief["age"] + 1}
        following = (belief["set"] + 1) % len(self._sets)
        return {"set": following, "age": 1, "evidence": self._sets[following]}


def evidence_seen(belief: Value, tick: Tick = NO_TICK) -> Elements:
    """φ from the world to a part: the evidence set, of which the part takes what concerns it."""
    return ({"from": tick.below[0], "age": belief["age"], "evidence": belief["evidence"]},)


def _written(network: Network, sets: Sequence[Mapping[str, Any]]) -> list[Shown]:
    if isinstance(sets, (str, Mapping)) or not sets or not all(isinstance(each, Mapping) for each in sets):
        raise ValueError(f"sets: expected a list of maps from nodes to states or likelihoods, got {sets!r:.60}")
    return [{name: _shown(network, name, value) for name, value in each.items()} for each in sets]


def _shown(network: Network, name: str, value: Any) -> int | tuple[float, ...]:
    vector = likelihoods(network, name, value)
    return tuple(vector.tolist()) if isinstance(value, (list, tuple, np.ndarray)) else int(vector.argmax())


def _drawn(network: Network, draw: Mapping[str, Any]) -> list[Shown]:
    share = draw.get("share") if isinstance(draw, Mapping) and set(draw) == {"sets", "share", "seed"} else None
    if isinstance(share, bool) or not isinstance(share, (int, float)) or not 0 <= share <= 1:
        raise ValueError(f"draw: expected sets, share (from 0 to 1) and seed, got {draw!r:.80}")
    if any(type(draw[name]) is not int or draw[name] < least for name, least in (("sets", 1), ("seed", 0))):
        raise ValueError(f"draw: expected sets (at least 1) and seed as whole numbers, got {draw!r:.80}")
    random = np.random.Generator(np.random.PCG64(draw["seed"]))
    parents = {parent for variable in network.variables.values() for parent in variable.parents}
    leaves = [name for name in network.variables if name not in parents]
    if draw["sets"] * len(leaves) > MAX_DRAWN:
        raise ValueError(f"draw: sets of {len(leaves)} leaves: at most {MAX_DRAWN // len(leaves)} are allowed")
    found: list[Shown] = []
    for _ in range(draw["sets"]):
        states = sampled(network, random)
        found.append({str(leaf): states[leaf] for leaf in leaves if random.random() < share})
    return found
