"""Hierarchies with rates, drawn from seeds, and their engines under a network that delivers in any order."""

from __future__ import annotations

import random
from collections.abc import Callable

from hierax.runtime.core.digest import encode_state
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Committed, Completed, EngineEffects, Saved
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.sim.rated import draw_rates
from hierax.schemas.checkpoint import decode_state
from hierax.schemas.messages import Header, Message
from hierax.schemas.rates import Rates

MOST_DRAINED = 40  # of so many epochs, in some runs any may be a drained one
MOST_KILLS = 40  # in one run: where more die than can come back, none comes to its end


def random_rates(seed: int, hierarchy: Hierarchy) -> Rates:
    """Rates of some nodes and edges, any of which may gather."""
    pairs = sorted(hierarchy.bound_edges)
    return draw_rates(random.Random(seed), sorted(hierarchy.nodes.keys() - {hierarchy.world}), pairs, pairs)


class KilledError(Exception):
    """A node's process dies, in the middle of what it does."""


class _Site(EngineEffects):
    """A process of a node."""

    def __init__(self, network: RatedNetwork, name: str) -> None:
        self.network, self.name = network, name

    def _may_die(self) -> None:
        """Before each of its effects."""
        if self.network.killed < MOST_KILLS and self.network.rng.random() < self.network.killing:
            raise KilledError(self.name)

    def send(self, message: Message) -> None:
        self._may_die()
        self.network.under_way.append(message)
        self.network.sent.append(message.header)

    def save(self, epoch: int, attempt: int, start: bytes, now: bytes) -> None:
        self._may_die()
        under_way = self.network.engines[self.name].under_way if self.name in self.network.engines else b""
        self.network.saved[self.name] = Saved(epoch, attempt, *_states(start, now), under_way)

    def completed(self, completed: Completed) -> None:
        return

    def predicted(self, completed: Completed) -> None:
        self.network.done[self.name][completed.step.epoch] = (completed.state, completed.digest)

    def committed(self, committed: Committed) -> None:
        self.network.commits[committed.epoch] = committed.digest

    def refused(self, header: Header, verdict: Verdict) -> None:
        assert verdict in (Verdict.OLD_ROSTER, Verdict.OTHER_INSTANCE), (header, verdict)


def _states(start: bytes, now: bytes) -> tuple[ActiveNode, ActiveNode]:
    return ActiveNode(*decode_state(start)), ActiveNode(*decode_state(now))


class RatedNetwork:
    """The engines of a hierarchy, and messages between them that come in any order, some twice; processes may die.

    Args:
        hierarchy, rates: as they are.
        seed: of the order.
        doubling: how likely a message comes twice.
        killing: how likely a process dies before it sends or saves anything. What is under way to it and from it may be
            lost then. Another one comes in its place, under the next version of the roster.
    """

    def __init__(
        self, hierarchy: Hierarchy, rates: Rates, seed: int, doubling: float = 0.0, killing: float = 0.0
    ) -> None:
        self.rng, self.doubling, self.killing = random.Random(seed), doubling, 0.0
        self.under_way: list[Message] = []
        self.sent: list[Header] = []
        self.commits: dict[int, bytes] = {}
        self.done: dict[str, dict[int, tuple[bytes, bytes]]] = {name: {} for name in hierarchy.nodes}
        self.saved: dict[str, Saved] = {}
        self.killed = 0
        self.hierarchy, self.rates = hierarchy, rates
        self._version, self._instances = 0, dict.fromkeys(hierarchy.nodes, 0)
        self.engines: dict[str, RatedEngine] = {}
        for name in hierarchy.nodes:
            self.engines[name] = RatedEngine(self._wiring(name), _Site(self, name))
        self._world = hierarchy.world
        self.drained = frozenset(epoch for epoch in range(1, MOST_DRAINED) if self.rng.random() < 0.2)
        self.killing = killing

    @property
    def world(self) -> RatedEngine:
        return self.engines[self._world]

    def _wiring(self, name: str) -> Wiring:
        edges = self.hierarchy.bound_edges
        tasking = frozenset(pair for pair, edge in edges.items() if edge.task)
        place = Place(self._version, instances=dict(self._instances), tasking=tasking, rates=self.rates)
        return Wiring(self.hierarchy.bound[name], tuple(edges.values()), place)

    def run(self, epochs: int, drains: bool = False) -> None:
        """Go on until so many epochs are committed, and all is said; `drains`: the last one is a drained one, and
        so are some before."""
        while True:
            try:
                if not self._step(epochs, drains):
                    break
            except KilledError as killed:
                self.replace(str(killed), epochs, drains)

    def _step(self, epochs: int, drains: bool) -> bool:
        may_begin = self.world.phase is Phase.DONE and self.world.epoch < epochs
        if may_begin and (not self.under_way or self.rng.random() < 0.5):
            self._begin(epochs, drains)
            return True
        if not self.under_way:
            return False
        message = self.under_way.pop(self.rng.randrange(len(self.under_way)))
        if self.rng.random() < self.doubling:
            self.under_way.append(message)
        self.engines[message.header.receiver].receive(message)
        return True

    def _begin(self, epochs: int, drains: bool) -> None:
        """First the world's record, as whoever hears of an epoch goes on with it."""
        world = self.world
        world.drains = drains and (world.epoch + 1 == epochs or world.epoch + 1 in self.drained)
        self.saved[self._world] = Saved(world.epoch, 0, world.state, world.state, world.under_way)
        world.begin()

    def replace(self, name: str, epochs: int, drains: bool = False) -> None:
        """Another process comes, as the owner has it: all are told of a version, and the world takes it up."""
        self.killed += 1
        self._version += 1
        self._instances[name] = self._version
        self.under_way = [
            message
            for message in self.under_way
            if name not in (message.header.receiver, message.header.sender) or self.rng.random() < 0.5
        ]
        killing, self.killing = self.killing, 0.0
        saved = self.saved.get(name)
        wiring = self._wiring(name)
        self.engines[name] = RatedEngine(wiring, _Site(self, name), saved=saved, joins=True)
        for other in self.rng.sample(sorted(self.engines), len(self.engines)):
            self.engines[other].prepare(self._wiring(other))
        self.killing = killing
        world = self.world
        if name != self._world:
            world.rewire(self._version)
        if world.phase is not Phase.DONE:
            self._again(lambda: world.begin_again(0), epochs, drains)
        elif world.epoch < epochs:
            self._again(lambda: self._begin(epochs, drains), epochs, drains)
        else:
            self._again(world._greet_first, epochs, drains)

    def _again(self, go: Callable[[], None], epochs: int, drains: bool) -> None:
        try:
            go()
        except KilledError as killed:
            self.replace(str(killed), epochs, drains)

    def states(self) -> dict[str, bytes]:
        """Of all nodes, encoded."""
        return {name: encode_state(*engine.state) for name, engine in self.engines.items()}
