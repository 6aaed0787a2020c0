"""Random hierarchies whose every result depends on everything it should, and on nothing else.

Operators and edge functions hash all their arguments, in order, so a lost, doubled,
stale or reordered input shows in every belief above or below it. All is a function of
the seed: the same seed gives the same hierarchy in every process.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b

import numpy as np

from hierax.runtime import NO_TICK, Elements, Node, Tick, Value, World
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import HierarchyError
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.schemas.values import encode_value

MIN_NODES = 2
MAX_NODES = 12
LARGE_ELEMENTS = 2100
"""Float64 elements of a large array: just over `LARGE_ARRAY_BYTES`."""

PLAIN = OperatorSetting()


def mark(*parts: Value) -> str:
    """A short hash of values, in order."""
    return blake2b(encode_value(parts), digest_size=8).hexdigest()


def number(text: str) -> int:
    """A mark as a number."""
    return int(text, 16)


def fold(level: np.ndarray, *parts: Value) -> np.ndarray:
    """A floating-point mix that depends on the order of its parts and rounds at every step."""
    for part in parts:
        step = number(mark(part)) / 2.0**64
        level = 0.7 * level[::-1] + step * (1.1 - level)
    return level


def know(origin: str, belief: Value, *parts: Value) -> Value:
    """A belief that depends on the old one and all parts."""
    return {
        "mark": mark(origin, belief, *parts),
        "count": belief["count"] + 1,
        "level": fold(belief["level"], origin, *parts),
    }


class MixingNode(Node):
    """Hashes its inputs into its belief; has some policies.

    Args:
        name: goes into every hash.
        policy_count: at least 1.
    """

    initial_policy = "p0"

    def __init__(self, name: str, policy_count: int = 1) -> None:
        self.name = name
        self.policy_count = policy_count

    def initial_belief(self) -> Value:
        return {"mark": mark(self.name), "count": 0, "level": np.linspace(0.0, 1.0, 3)}

    def observe(self, observations: Elements, belief: Value) -> Value:
        return know(f"{self.name} observe", belief, observations)

    def select_policy(self, tasks: Elements) -> str:
        if not tasks:
            return self.initial_policy
        return f"p{number(mark(self.name, tasks)) % self.policy_count}"

    def policies(self) -> Mapping[str, Callable[..., Elements]]:
        return {f"p{index}": partial(self.acts, f"p{index}") for index in range(self.policy_count)}

    def acts(self, policy: str, belief: Value) -> Elements:
        """The policy of that name: 0 to 2 actions, sometimes one twice."""
        return elements(mark(self.name, policy, belief))

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return know(f"{self.name} predict", belief, context, actions)


class DrawingNode(MixingNode):
    """As `MixingNode`, and every operator also hashes its tick and draws random numbers."""

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return know(f"{self.name} observe", belief, observations, drawn(tick))

    def select_policy(self, tasks: Elements, tick: Tick = NO_TICK) -> str:
        if not tasks:
            return self.initial_policy
        return f"p{number(mark(self.name, tasks, drawn(tick))) % self.policy_count}"

    def acts(self, policy: str, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """The policy of that name: 0 to 2 actions, sometimes one twice."""
        return elements(mark(self.name, policy, belief, drawn(tick)))

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return know(f"{self.name} predict", belief, context, actions, drawn(tick))


class MixingWorld(DrawingNode, World):
    """N₀; its clock depends on its belief. That it works ahead or does not makes no difference."""

    def __init__(self, name: str, policy_count: int) -> None:
        super().__init__(name, policy_count)
        self.works_ahead = policy_count % 2 == 0

    def time_s(self, belief: Value, epoch: int) -> float:
        return epoch + float(belief["level"][0])


@dataclass(frozen=True)
class Mix:
    """An edge function: elements that depend on all of its argument.

    Attributes:
        name: goes into the hash.
        large: give a large array besides.
    """

    name: str
    large: bool = False

    def __call__(self, argument: Value) -> Elements:
        return self.given(mark(self.name, argument))

    def given(self, text: str) -> Elements:
        """The elements for a mark."""
        if not self.large:
            return elements(text)
        return (*elements(text), np.full((LARGE_ELEMENTS // 2, 2), float(number(text))))


class DrawingMix(Mix):
    """As `Mix`, with the tick and its random numbers."""

    def __call__(self, argument: Value, tick: Tick = NO_TICK) -> Elements:
        return self.given(mark(self.name, argument, drawn(tick)))


def drawn(tick: Tick) -> Value:
    """All that a tick holds, and random numbers of it."""
    return (tick.epoch, tick.time_s, tick.below, tick.above, tick.rng.random(2), int(tick.rng.integers(1 << 32)))


def elements(text: str) -> Elements:
    """0 to 3 elements of several types that follow from a mark; some are given twice."""
    seed = number(text)
    kinds: tuple[Elements, ...] = (
        (),
        (text,),
        (seed % 1000, {"of": text, "share": seed / 2.0**64}),
        (text, text, np.arange(seed % 5, dtype=np.int32)),
    )
    return kinds[seed % len(kinds)]


def random_hierarchy(seed: int, nodes: int | None = None, setting: OperatorSetting = PLAIN) -> Hierarchy:
    """A valid hierarchy of mixing nodes.

    Args:
        seed: fixes everything.
        nodes: how many, the world included; by default 2 to 12.
        setting: of the run.
    """
    rng = random.Random(seed)
    count = rng.randint(MIN_NODES, MAX_NODES) if nodes is None else nodes
    names = [f"n{index:02}" for index in range(count)]
    rng.shuffle(names)  # so that an order by name is no order of the graph
    world = names[0]
    members: dict[str, Node] = {world: MixingWorld(world, rng.randint(2, 4))}
    for name in names[1:]:
        members[name] = rng.choice((MixingNode, DrawingNode))(name, rng.randint(2, 4))
    density = rng.choice((0.0, 0.2, 0.5, 1.0))
    edges = [random_edge(rng, lower, upper) for lower, upper in random_pairs(rng, names, density)]
    rng.shuffle(edges)
    return Hierarchy(members, world, edges, setting)


def random_pairs(rng: random.Random, names: list[str], density: float) -> list[tuple[str, str]]:
    """Edges (lower, upper) of a DAG whose only source is the first name.

    Args:
        rng: decides.
        names: in an order that the edges respect.
        density: how likely two names are joined beyond the one edge that each needs.
    """
    pairs = []
    for place in range(1, len(names)):
        needed = rng.randrange(place)
        pairs += [(names[lower], names[place]) for lower in range(place) if lower == needed or rng.random() < density]
    return pairs


def random_order(rng: random.Random, hierarchy: Hierarchy) -> list[str]:
    """One of the orders from below to above that respect the edges, any of them."""
    left = sorted(hierarchy.nodes)
    order: list[str] = []
    while left:
        ready = [name for name in left if all(lower in order for lower in hierarchy.below(name))]
        name = rng.choice(ready)
        left.remove(name)
        order.append(name)
    return order


def random_edge(rng: random.Random, lower: str, upper: str) -> Edge:
    """An edge with some functions."""
    functions: dict[str, Mix | None] = {}
    for kind in ("sense", "task", "context"):
        make = rng.choice((None, Mix, Mix, DrawingMix))
        functions[kind] = None if make is None else make(f"{lower}->{upper} {kind}", rng.random() < 0.05)
    return Edge(lower, upper, **functions)


def without(hierarchy: Hierarchy, name: str) -> Hierarchy | None:
    """The hierarchy without a node; None where that is none."""
    nodes = {other: node for other, node in hierarchy.nodes.items() if other != name}
    edges = [edge for edge in hierarchy.edges if name not in edge.pair]
    try:
        return Hierarchy(nodes, hierarchy.world, edges, hierarchy.setting)
    except HierarchyError:
        return None


def with_one_less(rng: random.Random, hierarchy: Hierarchy) -> Hierarchy | None:
    """The hierarchy without one of its nodes; None where none can go."""
    names = rng.sample(sorted(hierarchy.nodes), len(hierarchy.nodes))
    return next((smaller for name in names if (smaller := without(hierarchy, name)) is not None), None)


def with_one_more(rng: random.Random, hierarchy: Hierarchy) -> Hierarchy:
    """The hierarchy with a further node, by a name that may have been there before."""
    name = rng.choice([name for name in (f"m{index:02}" for index in range(30)) if name not in hierarchy.nodes][:3])
    place = rng.randint(1, len(hierarchy.order))
    below = rng.sample(hierarchy.order[:place], rng.randint(1, min(3, place)))
    above = rng.sample(hierarchy.order[place:], rng.randint(0, min(2, len(hierarchy.order) - place)))
    pairs = [(lower, name) for lower in below] + [(name, upper) for upper in above]
    node = rng.choice((MixingNode, DrawingNode))(name, rng.randint(2, 4))
    edges = [*hierarchy.edges, *(random_edge(rng, *pair) for pair in pairs)]
    return Hierarchy({**hierarchy.nodes, name: node}, hierarchy.world, edges, hierarchy.setting)
