"""A network, or a part of one, as a node of a hierarchy.

Each arrow of the network from a node in one part to one in another is an edge's business: messages about it go up from
the child's part to the parent's (φ: diagnostic support, λ in Pearl 1988) and down (ϱ: causal support, π). A message is
an array of shape (2, states of the parent): fractions, and exponents of 2, so that nothing underflows; it counts up to
a factor, and is sent with the greatest number from 0.5 to below 1.

A belief is ``{"age", "evidence", "below", "above", "diagnostic", "causal", "posterior", "impossible"}``:

- ``evidence``: by sender, ``{node: likelihoods}``, or the number of a state that is certain;
- ``below``: the slots, by sending part: ``{child: {parent: message}}``; ``above``: causal support, likewise;
- ``diagnostic``: what goes up, ``{child: {parent: message}}``; ``causal``: what goes down, likewise, by receiving part;
- ``posterior``: one row for each of the part's nodes; where these differ in their numbers of states, one row that has
  all of them, node after node; float64;
- ``age``: for how many epochs the evidence has been the same; ``impossible``: where it contradicts itself, or empty."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.causal_tree.errors import ImpossibleEvidence
from hierax.nodes.causal_tree.extended_floats import Floats
from hierax.nodes.causal_tree.fragment import NOTHING, Arrow, Fragment, Heard, Messages, by_arrow, by_child
from hierax.nodes.causal_tree.network import Network
from hierax.nodes.causal_tree.networks import Source, network_from
from hierax.runtime import NO_TICK, Elements, Node, Step, Tick, Value
from hierax.runtime.core.graph import depths
from hierax.runtime.core.showing import GREY, Colour, Graph, Things, colour_of, in_rows

SHOWN_NODES = 8  # of larger parts the metrics have no posteriors
FEW_NODES = 4  # of a smaller part all posteriors are curves
MOST_NODES = 60  # a larger part is no picture that anybody can read
SEEN, INFERRED = colour_of(6), colour_of(2)  # colours of nodes of which there is evidence, and of the others
_ACROSS, _DOWN = 130.0, 90.0


class Part(Node):
    """Some nodes of a causal tree or polytree.

    One Update is exact in a tree; in a polytree as many as `epochs_needed` says.

    Args:
        network: as `network_from` takes it. Of nodes that other parts hold only the states are used, and of those
            only the parents of this part's.
        nodes: which ones; by default all, or those that `top` and `tops` say.
        top: with `tops`, the node from which on down the part goes, to where another one of `tops` begins.
        tops: of all parts.
        settle: from how many epochs with the same evidence on a contradiction in it is an error. Before, it may come
            from messages that are under way: in a polytree, and with a staleness. Such messages are replaced by ones,
            and the posteriors are all 0. null: it never is one.

    Raises ValueError: the parameters are wrong."""

    def __init__(
        self,
        network: Source,
        nodes: Sequence[str] | None = None,
        top: str | None = None,
        tops: Sequence[str] = (),
        settle: int | None = 1,
    ) -> None:
        whole = network_from(network)
        if settle is not None and (type(settle) is not int or settle < 1):
            raise ValueError(f"settle: expected a number of epochs, at least 1, or null, got {settle!r}")
        if nodes is not None and top is not None:
            raise ValueError("nodes: expected either nodes or top, got both")
        held: Sequence[object] = tuple(whole.variables) if nodes is None else nodes
        if top is not None:
            held = under(whole, top, tops)
        self._settle = settle
        self._merged: tuple[Mapping[str, Messages], dict[Arrow, Floats]] = ({}, {})
        self._fragment = Fragment(whole, _checked_names(whole, held))
        self._arrows = [(str(parent), name) for name in self.nodes for parent in whole.variables[name].parents]

    @property
    def nodes(self) -> tuple[str, ...]:
        """The part's nodes, in the order of the posteriors."""
        return self._fragment.names

    def initial_belief(self) -> Value:
        """No evidence; nothing heard from other parts."""
        return self._updated({"age": 1, "evidence": {}, "below": {}, "above": {}}, 0)

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ: what `evidence_seen` and `diagnostic_support` report takes its slot; the slots of who is no longer below
        become ones. Raises ImpossibleEvidence: what lies below this part, or in it, contradicts itself."""
        evidence = {name: each for name, each in belief["evidence"].items() if name in tick.below}
        below = {name: each for name, each in belief["below"].items() if name in tick.below}
        for seen in observations:
            if "evidence" in seen:
                evidence[seen["from"]] = self._fragment.own_evidence(seen["evidence"])
            else:
                below[seen["from"]] = self._fragment.slots(seen["diagnostic"])
        age = min((seen["age"] for seen in observations), default=belief["age"])
        sensed = {**belief, "age": age, "evidence": evidence, "below": below}
        found = self._fragment.diagnostic(self._heard(sensed))
        if found.certain:
            self._judge(found.impossible, age)
        return {**sensed, "diagnostic": found.messages}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """γ: what `causal_support` gives takes its slot; the posteriors follow. Raises ImpossibleEvidence: the evidence
        contradicts itself."""
        above = {name: each for name, each in belief["above"].items() if name in tick.above}
        for given in context:
            above[given["from"]] = self._fragment.supports(given["support"])
        return self._updated({**belief, "above": above}, belief["age"])

    def take_over(self, belief: Value) -> Value:
        """The evidence and messages that another part has had, as far as they concern this one's nodes. Raises
        ValueError: it is no belief of a part."""
        initial = self.initial_belief()
        if not isinstance(belief, dict) or belief.keys() != initial.keys():
            raise ValueError("belief: expected that of a part of a causal tree")
        fragment = self._fragment
        kept = {
            "age": belief["age"],
            "evidence": {name: fragment.own_evidence(each) for name, each in belief["evidence"].items()},
            "below": {name: fragment.slots(each) for name, each in belief["below"].items()},
            "above": {name: fragment.supports(each) for name, each in belief["above"].items()},
        }
        return self._updated(kept, 0)

    def posteriors(self, belief: Value) -> dict[str, Floats]:
        """The posteriors P(state | evidence) by node; all 0 where the evidence contradicts itself."""
        flat, fragment = belief["posterior"].ravel(), self._fragment
        of_nodes = zip(self.nodes, fragment.ends, fragment.sizes, strict=True)
        return {name: flat[end - size : end] for name, end, size in of_nodes}

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """The posteriors of a small part, as ``node=state``; and whether the evidence contradicts itself."""
        found = {} if self._settle == 1 else {"impossible": float(bool(belief["impossible"]))}
        if len(self.nodes) <= SHOWN_NODES:
            for name, row in self.posteriors(belief).items():
                states = self._fragment.states[name]
                found.update({f"{name}={state}": float(p) for state, p in zip(states, row, strict=True)})
        return found

    def show(self, step: Step, before: Value) -> Things:
        """The network, with what is believed of each node."""
        seen = {name for each in step.belief["evidence"].values() for name in each}
        return part_things(self._arrows, self._fragment.states, self.posteriors(step.belief), seen)

    def _updated(self, belief: dict[str, Any], age: int) -> Value:
        """The belief with all that follows from its slots."""
        found = self._fragment.all(self._heard(belief))
        self._judge(found.impossible, age)
        return {
            **belief,
            "diagnostic": belief.get("diagnostic", NOTHING),
            "causal": {
                part: by_child({arrow: found.causal[arrow] for arrow in by_arrow(slots)})
                for part, slots in belief["below"].items()
            },
            "posterior": found.posterior,
            "impossible": found.impossible or "",
        }

    def _heard(self, belief: Value) -> Heard:
        """What a belief's slots hold; of the same slots, the same object."""
        if self._merged[0] is not belief["below"]:
            self._merged = (belief["below"], _merged(belief["below"]))
        return Heard(tuple(belief["evidence"].values()), self._merged[1], _merged(belief["above"]))

    def _judge(self, node: str | None, age: int) -> None:
        """Refuse evidence that contradicts itself at a node, once that has settled."""
        if node is not None and self._settle is not None and age >= self._settle:
            raise ImpossibleEvidence(node)


def diagnostic_support(belief: Value, tick: Tick = NO_TICK) -> Elements:
    """φ from a part to one above it: one observation, η·M·L for each arrow that leads to it from elsewhere."""
    return ({"from": tick.below[0], "age": belief["age"], "diagnostic": belief["diagnostic"]},)


def causal_support(belief: Value, tick: Tick = NO_TICK) -> Elements:
    """ϱ from a part to one below it: one element, for each arrow between them all that is known of its upper end,
    but what came up along it."""
    return ({"from": tick.above[0], "support": belief["causal"].get(tick.below[0], NOTHING)},)


def under(network: Network, top: str, tops: Iterable[str]) -> tuple[str, ...]:
    """The nodes from one of `tops` on down to where another one of them begins, in the network's order. Raises
    ValueError: `top` is not one of `tops`, if there are any, or there is no such node."""
    given = set(tops)
    if given and top not in given:
        raise ValueError(f"top: {top!r} is none of the tops, {', '.join(sorted(map(repr, given)))}")
    others = given - {top}
    for name in (top, *sorted(others, key=str)):
        if name not in network.variables:
            raise ValueError(f"tops: there is no node {name!r}")
    children: dict[Any, list[Any]] = {}
    for variable in network.variables.values():
        for parent in variable.parents:
            children.setdefault(parent, []).append(variable.name)
    found = {top}
    waiting = [top]
    while waiting:
        for child in children.get(waiting.pop(), ()):
            if child not in others and child not in found:
                found.add(child)
                waiting.append(child)
    return tuple(name for name in network.variables if isinstance(name, str) and name in found)


def _checked_names(network: Network, names: Sequence[object]) -> list[str]:
    if isinstance(names, str) or not names:
        raise ValueError(f"nodes: expected a list of at least one, got {names!r}")
    checked = [name for name in names if isinstance(name, str) and name in network.variables]
    unknown = [name for name in names if not isinstance(name, str) or name not in network.variables]
    if unknown:
        raise ValueError(f"nodes: there is no node {unknown[0]!r}, or its id is no text")
    if len(set(checked)) < len(checked):
        raise ValueError("nodes: one is there twice")
    return checked


def _merged(slots: Mapping[str, Messages]) -> dict[Arrow, Floats]:
    """The messages of all senders, by arrow."""
    by_sender = (by_arrow(slots[sender]) for sender in sorted(slots))
    return {arrow: np.asarray(message) for messages in by_sender for arrow, message in messages.items()}


def part_things(
    arrows: Sequence[tuple[str, str]],
    states: Mapping[str, Sequence[str]],
    posteriors: Mapping[str, Floats],
    seen: Collection[str],
) -> Things:
    """The part's network, each node with its most probable state, in another colour where there is evidence of it; the
    posteriors, or how sure the part is on average. Arrows are from parents, which may be in other parts; posteriors are
    all 0 where the evidence contradicts itself."""
    if len(posteriors) <= FEW_NODES:
        rows = {name: zip(states[name], row, strict=True) for name, row in posteriors.items()}
        things = {f"posterior/{name}/{state}": float(p) for name, row in rows.items() for state, p in row}
    else:
        things = {"certainty/mean": float(np.mean([row.max() for row in posteriors.values()]))}
    if not 1 < len(posteriors) <= MOST_NODES:
        return things
    texts = {name: f"{name}\n{states[name][int(row.argmax())]} {row.max():.3f}" for name, row in posteriors.items()}
    guests = {parent: parent for parent, _ in arrows if parent not in texts}
    colours: dict[str, Colour] = {name: SEEN if name in seen else INFERRED for name in texts}
    colours.update(dict.fromkeys(guests, GREY))
    nodes = {**guests, **texts}
    below = depths(nodes, arrows)  # causes stand above what they cause
    places = in_rows({name: below[name] for name in nodes}, _ACROSS, _DOWN)
    return {**things, "network": Graph(nodes, arrows, places, colours)}
