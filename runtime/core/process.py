"""The process model: sense up, then predict down (definitions 3 to 6), as pure functions.

This is the reference. What runs is the engine (`hierax.runtime.engine`); that both
agree is tested on random hierarchies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

from hierax.runtime.core.binding import BoundNode, Call, epoch_time_s
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.hierarchy import Hierarchy


class ActiveNode(NamedTuple):
    """Q = (N, s, π, a) of definition 3, without N.

    Attributes:
        belief: s.
        policy: π, by name.
        actions: a.
    """

    belief: Value
    policy: str
    actions: Elements = ()


@dataclass(frozen=True)
class ActiveHierarchy:
    """X = (H, 𝒬) of definition 3, and how many Updates have been done."""

    hierarchy: Hierarchy
    states: Mapping[str, ActiveNode]
    epoch: int = 0

    @staticmethod
    def initial(hierarchy: Hierarchy) -> "ActiveHierarchy":
        """Every node with s⁰, π⁰ and no actions.

        Raises:
            OperatorError: an `initial_belief` raised.
        """
        states = {
            name: ActiveNode(bound.initial_belief(0, 0.0), bound.node.initial_policy)
            for name, bound in hierarchy.bound.items()
        }
        return ActiveHierarchy(hierarchy, MappingProxyType(states))

    def with_state(self, name: str, state: ActiveNode) -> "ActiveHierarchy":
        """The same with one node's state replaced."""
        return replace(self, states=MappingProxyType({**self.states, name: state}))


def sense(bound: BoundNode, state: ActiveNode, observations: Elements, epoch: int, time_s: float) -> ActiveNode:
    """Definition 4 for one node and the observations of all nodes below it: s ← τ(O, s). N₀ senses nothing."""
    if not bound.below:
        return state
    belief = bound.observe(epoch, time_s, observations, state.belief)
    if belief is None:
        bound.accept_none(bound.observe, epoch)
    return state._replace(belief=belief)


def predict(
    bound: BoundNode, state: ActiveNode, tasks: Elements, context: Elements, epoch: int, time_s: float
) -> ActiveNode:
    """Definition 5 for one node and what comes from above: π ← λ(T), a ← π(s), then s ← γ(C, a, s)."""
    policy = bound.choose(epoch, time_s, tasks) if bound.above else state.policy
    actions = bound.policies[policy].elements(epoch, time_s, state.belief)
    belief = bound.predict(epoch, time_s, context, actions, state.belief)
    if belief is None:
        bound.accept_none(bound.predict, epoch)
    return ActiveNode(belief, policy, actions)


def apply(function: Call | None, epoch: int, time_s: float, argument: Value) -> Elements:
    """What an edge function gives; None is the function to the empty set."""
    return () if function is None else function.elements(epoch, time_s, argument)


def sensing_update(active: ActiveHierarchy, name: str, epoch: int, time_s: float) -> ActiveHierarchy:
    """Definition 4 in a hierarchy: the observations are what the sense functions make of the beliefs below."""
    return active if name == active.hierarchy.world else active.with_state(name, _sensed(active, name, epoch, time_s))


def _sensed(active: ActiveHierarchy, name: str, epoch: int, time_s: float) -> ActiveNode:
    hierarchy = active.hierarchy
    observations: Elements = ()
    for lower in hierarchy.below(name):
        edge = hierarchy.bound_edges[lower, name]
        observations += apply(edge.sense, epoch, time_s, active.states[lower].belief)
    return sense(hierarchy.bound[name], active.states[name], observations, epoch, time_s)


def prediction_update(active: ActiveHierarchy, name: str, epoch: int, time_s: float) -> ActiveHierarchy:
    """Definition 5 in a hierarchy: tasks and context are what the edges make of actions and beliefs above."""
    return active.with_state(name, _predicted(active, name, epoch, time_s))


def _predicted(active: ActiveHierarchy, name: str, epoch: int, time_s: float) -> ActiveNode:
    hierarchy = active.hierarchy
    tasks: Elements = ()
    context: Elements = ()
    for upper in hierarchy.above(name):
        edge = hierarchy.bound_edges[name, upper]
        tasks += apply(edge.task, epoch, time_s, active.states[upper].actions)
        context += apply(edge.context, epoch, time_s, active.states[upper].belief)
    bound, state = hierarchy.bound[name], active.states[name]
    return predict(bound, state, tasks, context, epoch, time_s)


def update(
    active: ActiveHierarchy, sensing_order: Sequence[str] | None = None, prediction_order: Sequence[str] | None = None
) -> ActiveHierarchy:
    """Definition 6: the sensing update of all nodes, then the prediction update of all.

    Args:
        active: the active hierarchy before the epoch.
        sensing_order: names from below to above; any order that respects the edges gives
            the same result (the paper's lemma). By default ties go by name.
        prediction_order: names from above to below; by default the first one's reverse.

    Raises:
        ValueError: an order leaves out a node or does not respect the edges.
        OperatorError: an operator raised.
    """
    hierarchy = active.hierarchy
    sensing, prediction = check_orders(hierarchy, sensing_order, prediction_order)
    epoch = active.epoch + 1
    world = active.states[hierarchy.world]
    time_s = epoch_time_s(hierarchy.world, hierarchy.world_node, world.belief, epoch)
    states = dict(active.states)  # one copy for all: with one for each node this would grow with their square
    updated = ActiveHierarchy(hierarchy, MappingProxyType(states), epoch)
    for name in sensing:
        states[name] = _sensed(updated, name, epoch, time_s)
    for name in prediction:
        states[name] = _predicted(updated, name, epoch, time_s)
    return updated


def check_orders(
    hierarchy: Hierarchy, sensing_order: Sequence[str] | None, prediction_order: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Both orders of `update`, those by default in the place of None. Raises `ValueError` if one is wrong."""
    sensing = tuple(hierarchy.order if sensing_order is None else sensing_order)
    prediction = tuple(reversed(hierarchy.order) if prediction_order is None else prediction_order)
    _check_order(hierarchy, sensing)
    _check_order(hierarchy, tuple(reversed(prediction)))
    return sensing, prediction


def _check_order(hierarchy: Hierarchy, upward: Sequence[str]) -> None:
    if sorted(upward) != sorted(hierarchy.nodes):
        raise ValueError(f"an order must name every node once, got {list(upward)}")
    place = {name: index for index, name in enumerate(upward)}
    for lower, upper in hierarchy.bound_edges:
        if place[lower] > place[upper]:
            raise ValueError(f"the order puts {upper!r} before {lower!r}, which is below it")
