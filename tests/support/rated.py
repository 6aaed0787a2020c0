"""Hierarchies with rates, drawn from seeds, and their engines under a network that delivers in any order."""

from __future__ import annotations

import random

from hierax.runtime.core.digest import encode_state
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.rates import Rates, Turns
from hierax.runtime.engine.effects import Committed, Completed, EngineEffects
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.schemas.messages import Header, Message

MAX_EVERY = 5
MAX_DELAY = 7


def random_rates(seed: int, hierarchy: Hierarchy) -> Rates:
    """Rates of some nodes and edges; each of them other than by default about every second time."""
    rng = random.Random(seed)
    turns = {}
    for name in sorted(hierarchy.nodes.keys() - {hierarchy.world}):
        every = rng.choice((1, 1, rng.randint(2, MAX_EVERY)))
        if every > 1:
            turns[name] = Turns(every, rng.randrange(every))
    pairs = sorted(hierarchy.bound_edges)
    delays = {pair: rng.randint(1, MAX_DELAY) for pair in pairs if rng.random() < 0.5}
    return Rates(turns, delays, frozenset(pair for pair in pairs if rng.random() < 0.4))


class _Site(EngineEffects):
    def __init__(self, network: RatedNetwork, name: str) -> None:
        self.network, self.name = network, name

    def send(self, message: Message) -> None:
        self.network.under_way.append(message)

    def completed(self, completed: Completed) -> None:
        self.network.done[self.name].append((completed.step.epoch, completed.state, completed.digest))

    def committed(self, committed: Committed) -> None:
        self.network.commits.append(committed.digest)

    def refused(self, header: Header, verdict: Verdict) -> None:
        raise AssertionError((header, verdict))


class RatedNetwork:
    """The engines of a hierarchy, and messages between them that come in any order, some twice.

    Args:
        hierarchy, rates: as they are.
        seed: of the order.
        doubling: how likely a message comes twice.
    """

    def __init__(self, hierarchy: Hierarchy, rates: Rates, seed: int, doubling: float = 0.0) -> None:
        self.rng, self.doubling = random.Random(seed), doubling
        self.under_way: list[Message] = []
        self.commits: list[bytes] = []
        self.done: dict[str, list[tuple[int, bytes, bytes]]] = {name: [] for name in hierarchy.nodes}
        edges = tuple(hierarchy.bound_edges.values())
        place = Place(tasking=frozenset(pair for pair, edge in hierarchy.bound_edges.items() if edge.task))
        self.engines = {
            name: RatedEngine(Wiring(bound, edges, place), _Site(self, name), rates=rates)
            for name, bound in hierarchy.bound.items()
        }
        self.world = self.engines[hierarchy.world]

    def run(self, epochs: int) -> None:
        """Go on until so many epochs are committed, and all is said."""
        while True:
            may_begin = self.world.phase is Phase.DONE and self.world.epoch < epochs
            if may_begin and (not self.under_way or self.rng.random() < 0.5):
                self.world.begin()
                continue
            if not self.under_way:
                break
            message = self.under_way.pop(self.rng.randrange(len(self.under_way)))
            if self.rng.random() < self.doubling:
                self.under_way.append(message)
            self.engines[message.header.receiver].receive(message)

    def states(self) -> dict[str, bytes]:
        """Of all nodes, encoded."""
        return {name: encode_state(*engine.state) for name, engine in self.engines.items()}
