"""Hierarchies with rates: the engine, the formal model and the direct implementation come to the same."""

from __future__ import annotations

import random
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import rated_mutations
from support.direct import Direct
from support.hierarchies import MixingNode, MixingWorld, random_hierarchy, random_order
from support.rated import RatedNetwork, random_rates
from support.sweep import examples

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import encode_state
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import ContradictionError, OperatorError
from hierax.runtime.core.hierarchy import Edge, Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.core.unrolled import Unrolled, unrolled_update
from hierax.runtime.engine.effects import Saved
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.own_rates import OwnRates
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.engine.said import SaidMessages
from hierax.runtime.engine.wiring import Slot
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message
from hierax.schemas.rates import EdgeRates, Rates, Turns, includes

EPOCHS = 12

seeds = st.integers(0, 2**32)


def check_as_direct(network: RatedNetwork, direct: Direct, world: str) -> None:
    for name, done in network.done.items():
        assert sorted(done) == direct.turns(name, EPOCHS)
        for epoch, (state, digest) in done.items():
            assert state == encode_state(*direct.after(name, epoch)), (name, epoch)
            assert digest == direct.digest(name, epoch), (name, epoch)
    assert network.commits == commits_of(direct, world)


def commits_of(direct: Direct, world: str) -> dict[int, bytes]:
    return {epoch: direct.digest(world, epoch) for epoch in range(1, EPOCHS + 1)}


@settings(max_examples=examples(30, 600))
@given(seeds, seeds, seeds, st.booleans())
def test_any_order_of_delivery_gives_what_the_direct_implementation_gives(
    one: int, two: int, order: int, drains: bool
) -> None:
    hierarchy = random_hierarchy(one, setting=OperatorSetting(seed=order))
    rates = random_rates(two, hierarchy)
    network = RatedNetwork(hierarchy, rates, order, doubling=0.2)
    network.run(EPOCHS, drains)
    check_as_direct(network, Direct(hierarchy, rates), hierarchy.world)


@settings(max_examples=examples(60, 5000))
@given(seeds, seeds, seeds, st.sampled_from((0.005, 0.02, 0.05)), st.booleans())
def test_processes_that_die_change_nothing(one: int, two: int, order: int, killing: float, drains: bool) -> None:
    hierarchy = random_hierarchy(one, setting=OperatorSetting(seed=order))
    rates = random_rates(two, hierarchy)
    network = RatedNetwork(hierarchy, rates, order, doubling=0.2, killing=killing)
    network.run(EPOCHS, drains)
    check_as_direct(network, Direct(hierarchy, rates), hierarchy.world)


@pytest.mark.parametrize("seed", range(10))
def test_nobody_is_told_of_an_epoch_that_nobody_needs(seed: int) -> None:
    hierarchy = random_hierarchy(seed, 6)
    rates = random_rates(seed, hierarchy)
    network = RatedNetwork(hierarchy, rates, seed)
    network.run(EPOCHS)
    told = {header.line[1:]: set[int]() for header in network.sent}
    for header in network.sent:
        if header.kind == OBSERVATIONS:
            told[header.line[1:]].add(header.epoch)
    for lower, upper in hierarchy.bound_edges:
        needed = {epoch for epoch in range(1, EPOCHS + 1) if includes(rates.passes(upper), epoch)}
        assert told[lower, upper] == needed


@settings(max_examples=examples(30, 600))
@given(seeds, seeds, st.integers(0, 2**32).map(random.Random))
def test_any_order_of_the_formal_update_gives_the_same(one: int, two: int, rng: random.Random) -> None:
    hierarchy = random_hierarchy(one)
    rates = random_rates(two, hierarchy)
    direct, now = Direct(hierarchy, rates), Unrolled.initial(hierarchy, rates)
    for epoch in range(1, EPOCHS + 1):
        now = unrolled_update(now, random_order(rng, hierarchy), random_order(rng, hierarchy)[::-1])
        for name, state in now.active.states.items():
            assert encode_state(*state) == encode_state(*direct.after(name, epoch)), (name, epoch)
            assert now.digests.get(name, bytes(32)) == direct.digest(name, epoch)


@pytest.mark.parametrize("seed", range(10))
def test_without_rates_it_is_the_update_of_the_paper(seed: int) -> None:
    hierarchy = random_hierarchy(seed)
    plain, unrolled = ActiveHierarchy.initial(hierarchy), Unrolled.initial(hierarchy, Rates())
    network = RatedNetwork(hierarchy, Rates(), seed)
    for _ in range(4):
        plain, unrolled = update(plain), unrolled_update(unrolled)
    network.run(4)
    states = {name: encode_state(*state) for name, state in plain.states.items()}
    assert {name: encode_state(*state) for name, state in unrolled.active.states.items()} == states == network.states()


def test_turns_are_the_epochs_of_a_remainder() -> None:
    assert [epoch for epoch in range(1, 13) if Turns(5, 2).include(epoch)] == [2, 7, 12]
    assert [Turns(5, 2).last(epoch) for epoch in (-4, 0, 1, 2, 6, 7)] == [0, 0, 0, 2, 2, 7]
    assert [Turns(3).last(epoch) for epoch in (-3, 0, 2, 3, 5)] == [0, 0, 0, 3, 3]
    rates = Rates({"b": Turns(3)}, {("a", "b"): 4})
    assert [rates.in_force("a", "b", epoch) for epoch in range(1, 14)] == [0, 0, 0, 0, 0, 0, 3, 3, 3, 6, 6, 6, 9]


@pytest.mark.parametrize("seed", range(20))
def test_two_messages_that_differ_are_noticed_while_the_first_may_count(seed: int) -> None:
    hierarchy = random_hierarchy(seed, 3)
    rates = Rates(delays=dict.fromkeys(hierarchy.bound_edges, 3))
    network = RatedNetwork(hierarchy, rates, seed)
    network.world.begin()
    for _ in range(200):
        if not network.under_way:
            network.world.begin()
        message = network.under_way.pop(0)
        network.engines[message.header.receiver].receive(message)
        if message.header.digest:
            with pytest.raises(ContradictionError, match="say different things"):
                network.engines[message.header.receiver].receive(Message(message.header, ("something else",)))
            return
    raise AssertionError("no context was ever sent")


class Meddler(MixingNode):
    """Changes the belief that it is given."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        belief["count"] += 1
        return super().observe(observations, belief)


def _meddles(belief: Value) -> Elements:
    belief["count"] += 1
    return ()


@pytest.mark.parametrize(("every", "offset"), [(3, 0), (10, 3), (7, 5)])
def test_what_operators_change_in_place_is_found_in_the_first_turn(every: int, offset: int) -> None:
    hierarchy = Hierarchy({"w": MixingWorld("w", 1), "n": Meddler("n")}, "w", [Edge("w", "n")])
    network = RatedNetwork(hierarchy, Rates({"n": Turns(every, offset)}), 0)
    with pytest.raises(OperatorError, match=f"n: observe in epoch {offset or every}: changed the belief"):
        network.run(EPOCHS)


def test_so_is_what_an_edge_function_changes_where_its_node_has_no_turn() -> None:
    nodes = {"w": MixingWorld("w", 1), "n": MixingNode("n"), "top": MixingNode("top")}
    hierarchy = Hierarchy(nodes, "w", [Edge("w", "n"), Edge("n", "top", sense=_meddles)])
    network = RatedNetwork(hierarchy, Rates({"n": Turns(3)}, pairs=(("w", "n"), ("n", "top"))), 0)
    with pytest.raises(OperatorError, match="n->top: sense in epoch 1: changed the belief"):
        network.run(EPOCHS)


def test_what_is_written_down_and_cannot_travel_names_its_edge_and_epoch() -> None:
    said = SaidMessages()
    said.keep(Message(Header(CONTEXT, "posture", "reflex", 5), (object(),)))
    with pytest.raises(OperatorError, match=r"reflex->posture: context in epoch 5: .*a object cannot be sent"):
        said.encoded()


def _newest(engine: RatedEngine, slot: Slot) -> Message:
    kept = engine._kept[slot]
    return kept[max(kept)] if kept else IN_FORCE(engine, slot)


def _forgets(engine: RatedEngine) -> None:
    engine._gathered.clear()
    GATHER(engine)


def _senses_in_turns_alone(own: OwnRates, upper: str, epoch: int) -> bool:
    return IS_SENSED(own, upper, epoch) and own.takes_part(own._name, epoch)


def _counts_at_once(edge: EdgeRates, epoch: int) -> int:
    return COUNTS(edge._replace(delay=0), epoch)


def _counts_one_later(edge: EdgeRates, epoch: int) -> int:
    return COUNTS(edge, epoch - 1)


IN_FORCE, GATHER = RatedEngine._in_force, RatedEngine._gather
IS_SENSED, COUNTS = OwnRates.is_sensed, EdgeRates.in_force
MISTAKES = {
    "the newest in hand counts": (RatedEngine, "_in_force", _newest),
    "what was gathered in other epochs is forgotten": (RatedEngine, "_gather", _forgets),
    "who has no turn is not observed": (OwnRates, "is_sensed", _senses_in_turns_alone),
    "delays are left out": (EdgeRates, "in_force", _counts_at_once),
    "all counts one epoch later": (EdgeRates, "in_force", _counts_one_later),
    "every node takes part in every epoch": (OwnRates, "takes_part", lambda *_: True),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_is_found(mistake: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*MISTAKES[mistake])
    for seed in range(40):
        hierarchy = random_hierarchy(seed, 5)
        rates = random_rates(seed, hierarchy)
        direct, network = Direct(hierarchy, rates), RatedNetwork(hierarchy, rates, seed)
        network.run(EPOCHS)
        if network.commits != commits_of(direct, hierarchy.world):
            return
    raise AssertionError("no seed has found it")


def killed(seed: int) -> RatedNetwork:
    """A network whose processes die."""
    hierarchy = random_hierarchy(seed, 5)
    return RatedNetwork(hierarchy, random_rates(seed, hierarchy), seed, killing=0.02)


@pytest.mark.parametrize("mistake", rated_mutations.MISTAKES)
def test_a_planted_mistake_shows_when_processes_die(mistake: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*rated_mutations.MISTAKES[mistake])
    for seed in range(40):
        network = killed(seed)
        direct = Direct(network.hierarchy, network.rates)
        try:
            network.run(EPOCHS)
        except ContradictionError:
            return
        if network.commits != commits_of(direct, network.hierarchy.world):
            return
    raise AssertionError("no seed has found it")


def _otherwise_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever observes in an epoch for a second time believes what it did before."""
    observe, observed = Engine._observe, set[tuple[int, str, int]]()

    def unsteady(engine: Engine, observations: Elements) -> Value:
        key = (id(engine._effects.network), engine.name, engine.epoch)  # type: ignore[attr-defined]
        if key in observed:
            return engine.start.belief
        observed.add(key)
        return observe(engine, observations)

    monkeypatch.setattr(Engine, "_observe", unsteady)


def test_what_was_said_counts_also_where_operators_give_something_else_each_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _otherwise_each_time(monkeypatch)
    for seed in range(25):
        network = killed(seed)
        network.run(EPOCHS)
        assert len(network.commits) == EPOCHS
    monkeypatch.setattr(RatedEngine, "_observe", rated_mutations.senses_anew)
    with pytest.raises(ContradictionError, match="say different things"):
        deque((killed(seed).run(EPOCHS) for seed in range(40)), maxlen=0)


def test_a_process_that_goes_on_before_what_it_was_done_with_is_noticed() -> None:
    """Its newest checkpoint was damaged, and the one before stands in for it."""
    hierarchy = random_hierarchy(3, 4)
    rates = Rates(delays=dict.fromkeys(hierarchy.bound_edges, 2))
    network = RatedNetwork(hierarchy, rates, 3)
    network.run(6)
    name = next(name for name in network.engines if name != hierarchy.world)
    initial = RatedNetwork(hierarchy, rates, 3).engines[name].state
    network.saved[name] = Saved(0, 0, initial, initial)
    network.replace(name, 6)
    with pytest.raises(ContradictionError, match=f"{name} goes on after epoch 0, and was further"):
        network.run(9)
