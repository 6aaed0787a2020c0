"""The engines of a hierarchy, in whatever order their messages come, do what the formal core does."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.hierarchies import random_hierarchy

from hierax.runtime.core.binding import Setting
from hierax.runtime.core.digest import NO_DIGEST, encode_state, formal_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.engine.engine import DigestChain, Engine, Place
from hierax.runtime.engine.outputs import Called, Committed, Completed, Output, Refused, Send
from hierax.schemas.messages import Message, decode_message, encode_message

EPOCHS = 3
ROSTER_HASH = bytes(range(32))


class Network:
    """Engines whose messages are delivered in any order, some of them more than once."""

    def __init__(self, hierarchy: Hierarchy, seed: int, doubling: float, events: bool = False) -> None:
        edges = tuple(hierarchy.bound_edges.values())
        tasking = frozenset(pair for pair, edge in hierarchy.bound_edges.items() if edge.task)
        place = Place(roster_hash=ROSTER_HASH, tasking=tasking)
        self.world = hierarchy.world
        self.engines = {name: Engine(node, edges, place, events=events) for name, node in hierarchy.bound.items()}
        self.chain = DigestChain(ROSTER_HASH)
        self.digests: list[bytes] = []
        self.calls: list[tuple[str, str]] = []
        self.states: dict[tuple[int, str], bytes] = {}
        self._random = random.Random(seed)
        self._doubling = doubling
        self._under_way: list[Message] = []
        self._delivered: list[Message] = []

    def run(self, epochs: int) -> None:
        """Deliver until nothing is under way."""
        self._take(self.world, self.engines[self.world].begin(), epochs)
        while self._under_way:
            message = self._next()
            receiver = message.header.receiver
            self._take(receiver, self.engines[receiver].receive(message), epochs)

    def _next(self) -> Message:
        if self._delivered and self._random.random() < self._doubling:
            return self._random.choice(self._delivered)
        message = self._under_way.pop(self._random.randrange(len(self._under_way)))
        self._delivered.append(message)
        return message

    def _take(self, name: str, outputs: Iterator[Output], epochs: int) -> None:
        for output in outputs:
            if isinstance(output, Send):
                self._under_way.append(decode_message(encode_message(output.message)))
            elif isinstance(output, Completed):
                self.states[output.step.epoch, name] = output.state
            elif isinstance(output, Called):
                self.calls.append((output.subject, output.operator))
            elif isinstance(output, Refused):
                pytest.fail(f"{name} refused {output}")
            elif isinstance(output, Committed):
                self.digests.append(self.chain.commit(output))
                if output.epoch < epochs:
                    self._take(name, self.engines[name].begin(), epochs)


@settings(max_examples=150, deadline=None)
@given(
    hierarchy_seed=st.integers(0, 2**32), order_seed=st.integers(0, 2**32), doubling=st.sampled_from([0.0, 0.2, 0.5])
)
def test_engines_do_what_the_formal_core_does(hierarchy_seed: int, order_seed: int, doubling: float) -> None:
    hierarchy = random_hierarchy(hierarchy_seed, setting=Setting(seed=order_seed))
    network = Network(hierarchy, order_seed, doubling)
    network.run(EPOCHS)

    active = ActiveHierarchy.initial(hierarchy)
    digest = NO_DIGEST
    for epoch in range(1, EPOCHS + 1):
        active = update(active)
        digest = formal_digest(active, digest, ROSTER_HASH)
        for name, state in active.states.items():
            assert network.states[epoch, name] == encode_state(state.belief, state.policy, state.actions), (epoch, name)
        assert network.digests[epoch - 1] == digest
    assert len(network.digests) == EPOCHS


@pytest.mark.parametrize("seed", range(5))
def test_every_call_gives_one_event(seed: int) -> None:
    hierarchy = random_hierarchy(seed)
    network = Network(hierarchy, seed, doubling=0.3, events=True)
    network.run(1)
    expected = []
    for name, node in hierarchy.bound.items():
        expected += [(name, "predict")]
        expected += [(name, "observe")] if name != hierarchy.world else []
        expected += [(name, "select_policy")] if node.above else []
        expected += [(name, f"policy {network.engines[name].state.policy}")]
    for (lower, upper), edge in hierarchy.bound_edges.items():
        functions = {"sense": edge.sense, "task": edge.task, "context": edge.context}
        expected += [(f"{lower}->{upper}", kind) for kind, function in functions.items() if function is not None]
    assert sorted(network.calls) == sorted(expected)


def test_an_event_hashes_its_result() -> None:
    call = Called(1, 0, "a", "observe", {"x": 1.0})
    assert call.hash == Called(2, 0, "b", "predict", {"x": 1.0}).hash
    assert call.hash != call._replace(result={"x": 1.0000000000000002}).hash
