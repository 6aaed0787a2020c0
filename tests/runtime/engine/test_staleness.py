"""Epochs that overlap: what inputs from above are used, and that an exact staleness is repeatable."""

from __future__ import annotations

import random
from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.hierarchies import random_hierarchy

from hierax.runtime.core.binding import Setting, epoch_time_s
from hierax.runtime.core.digest import NO_DIGEST, encode_state, epoch_digest, node_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.node import Elements
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.engine import DigestChain
from hierax.runtime.engine.loose import LooseEngine, Staleness
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.runner import NodeRunner, Pacemaker
from hierax.runtime.transport.memory import MemoryNetwork

ROSTER_HASH = bytes(range(32))


def formal_digests(hierarchy: Hierarchy, epochs: int, staleness: int) -> list[bytes]:
    """The digests of epochs in which inputs from above are `staleness` epochs old, in the formal order.

    The first epoch and the last are drained: all inputs are of the epoch itself.
    """
    initial = {
        name: ActiveNode(node.initial_belief(0, 0.0), node.node.initial_policy)
        for name, node in hierarchy.bound.items()
    }
    states = [initial]
    times = [0.0]
    digests: list[Mapping[str, bytes]] = [{}]
    chained = [NO_DIGEST]
    for epoch in range(1, epochs + 1):
        before = states[-1]
        world = hierarchy.world
        times.append(epoch_time_s(world, hierarchy.world_node, before[world].belief, epoch))
        sensed = {}
        for name in hierarchy.order:
            node = hierarchy.bound[name]
            observations: Elements = ()
            for lower in node.below:
                call = hierarchy.bound_edges[lower, name].sense
                observations += call.elements(epoch, times[epoch], sensed[lower]) if call else ()
            belief = before[name].belief
            sensed[name] = belief if name == world else node.observe(epoch, times[epoch], observations, belief)
        used = epoch if epoch == epochs else max(epoch - staleness, 1)
        states.append({})
        now: dict[str, bytes] = {}
        digests.append(now)
        for name in reversed(hierarchy.order):
            node = hierarchy.bound[name]
            tasks: Elements = ()
            context: Elements = ()
            for upper in node.above:
                edge = hierarchy.bound_edges[name, upper]
                above = states[used][upper]
                tasks += edge.task.elements(used, times[used], above.actions) if edge.task else ()
                context += edge.context.elements(used, times[used], above.belief) if edge.context else ()
            policy = node.choose(epoch, times[epoch], tasks) if node.above else before[name].policy
            actions = node.policies[policy].elements(epoch, times[epoch], sensed[name])
            belief = node.predict(epoch, times[epoch], context, actions, sensed[name])
            states[epoch][name] = ActiveNode(belief, policy, actions)  # type: ignore[index]
            encoded = encode_state(belief, policy, actions)
            now[name] = node_digest(encoded, [digests[used][upper] for upper in node.above])
        chained.append(epoch_digest(chained[-1], epoch, ROSTER_HASH, now[hierarchy.world]))
    return chained[1:]


def run(hierarchy: Hierarchy, epochs: int, staleness: Staleness, seed: int) -> tuple[list[bytes], list[LooseEngine]]:
    network = MemoryNetwork(seed)
    tasking = frozenset(pair for pair, edge in hierarchy.bound_edges.items() if edge.task)
    place = Place(roster_hash=ROSTER_HASH, tasking=tasking)
    edges = tuple(hierarchy.bound_edges.values())
    digests: list[bytes] = []
    pacemaker = Pacemaker(DigestChain(ROSTER_HASH), epochs, lambda _, digest: digests.append(digest))
    runners = {}
    for name, node in hierarchy.bound.items():
        runner = NodeRunner(None, network.open_port(name), (), None, pacemaker if name == hierarchy.world else None)
        runner.staleness = staleness
        runner.wire(Wiring(node, edges, place))
        runners[name] = runner
    runners[hierarchy.world].start()
    while (name := network.next_receiver()) is not None:
        message = runners[name].port.receive()
        if message is not None:
            runners[name].step(message)
    engines = [runner.engine for runner in runners.values()]
    return digests, [engine for engine in engines if isinstance(engine, LooseEngine)]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), order=st.integers(0, 2**32), staleness=st.integers(1, 3))
def test_an_exact_staleness_is_the_formal_core_with_inputs_so_old_in_any_order(
    seed: int, order: int, staleness: int
) -> None:
    hierarchy = random_hierarchy(seed, setting=Setting(seed=order))
    digests, _ = run(hierarchy, 7, Staleness(staleness, exact=True), order)
    assert digests == formal_digests(hierarchy, 7, staleness)


@pytest.mark.parametrize("seed", range(20))
def test_inputs_are_never_older_than_allowed_and_some_are_as_old(seed: int) -> None:
    hierarchy = random_hierarchy(seed, setting=Setting(seed=seed))
    staleness = 1 + random.Random(seed).randrange(3)
    digests, engines = run(hierarchy, 30, Staleness(staleness), seed)
    assert len(digests) == 30
    assert all(engine.epoch == 30 for engine in engines)
    joined = [engine for engine in engines if engine.wiring.above]
    assert all(engine.ages.inputs for engine in joined)
    assert max((engine.ages.largest for engine in joined), default=staleness) <= staleness


def test_a_staleness_that_is_not_exact_takes_the_newest_in_hand() -> None:
    means = []
    for seed in range(30):
        _, engines = run(random_hierarchy(seed, setting=Setting(seed=seed)), 20, Staleness(2), seed)
        means += [engine.ages.metrics()["staleness_mean"] for engine in engines if engine.ages.inputs]
    assert min(means) < 1.5 < max(means)
