"""The engines of a hierarchy do what the formal core does, in whatever order their messages come and whatever happens.

What happens follows from the seeds, which a failing test prints.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import currently_in_test_context, given, note, settings
from hypothesis import strategies as st
from support.disturbed import Faults, Network, formal_run
from support.hierarchies import random_hierarchy
from support.sweep import examples

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.engine.ahead import Ahead

EPOCHS = 3

seeds = st.integers(0, 2**32)
doublings = st.sampled_from([0.0, 0.2, 0.5])


def patient(many: int) -> settings:
    """So many in a sweep, and a third of them in the suite."""
    return settings(max_examples=examples(many // 3, many))


def check(hierarchy_seed: int, seed: int, faults: Faults, epochs: int = EPOCHS, nodes: int | None = None) -> Network:
    """Run, and compare every epoch with the formal core's."""
    network = Network(random_hierarchy(hierarchy_seed, nodes, OperatorSetting(seed=seed)), seed, faults)
    try:
        network.run(epochs)
    finally:
        if currently_in_test_context():
            note("\n".join(network.happened))
    assert len(network.epochs) == epochs
    expected = formal_run([epoch.hierarchy for epoch in network.epochs])
    for number, (epoch, (digest, states)) in enumerate(zip(network.epochs, expected, strict=True), 1):
        for name, state in epoch.states.items():
            assert state == states[name], (number, name)
        assert epoch.digest == digest, number
        if not faults.crashes and not faults.hangs:
            assert epoch.states.keys() == states.keys()
    return network


@patient(150)
@given(seeds, seeds, doublings)
def test_in_any_order(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling))


@patient(150)
@given(seeds, seeds, doublings)
def test_when_the_world_begins_epochs_again(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling, again=0.1))


@patient(100)
@given(seeds, seeds, doublings)
def test_when_messages_are_lost_and_sent_again(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling, loss=0.2, again=0.02))


@patient(200)
@given(seeds, seeds, doublings)
def test_when_processes_die_and_come_back(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling, again=0.02, crashes=0.06, leaves=0.3))


@patient(100)
@given(seeds, seeds, doublings)
def test_when_processes_that_were_given_up_are_still_there(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling, hangs=0.06))


@patient(150)
@given(seeds, seeds, doublings)
def test_when_nodes_come_and_go(hierarchy_seed: int, seed: int, doubling: float) -> None:
    check(hierarchy_seed, seed, Faults(doubling, changes=0.7, dropped=0.3), epochs=6)


@patient(150)
@given(seeds, seeds, doublings)
def test_when_all_of_that_happens(hierarchy_seed: int, seed: int, doubling: float) -> None:
    faults = Faults(doubling, loss=0.03, again=0.02, crashes=0.03, hangs=0.02, leaves=0.3, changes=0.5, dropped=0.2)
    check(hierarchy_seed, seed, faults, epochs=5, nodes=6)


def test_worlds_that_work_ahead_are_disturbed_and_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    used = Counter[str]()

    def counted(what: str, found: Callable[..., Any]) -> Callable[..., Any]:
        def counts(*arguments: Any) -> Any:
            given = found(*arguments)
            used[what] += bool(given)
            return given

        return counts

    for what in ("belief", "observations", "predict"):
        monkeypatch.setattr(Ahead, what, counted(what, getattr(Ahead, what)))
    faults = Faults(0.2, loss=0.03, again=0.05, crashes=0.05, leaves=0.3)
    networks = [check(seed, seed, faults, epochs=6, nodes=3) for seed in range(60)]
    happened = "\n".join(line for network in networks for line in network.happened)
    for what in ("died", "again, attempt 2"):
        assert what in happened, what
    assert used["belief"] > 20
    assert used["observations"] > 20
    assert used["predict"] > used["belief"], "some were in vain"


def test_all_of_that_does_happen() -> None:
    faults = Faults(0.2, loss=0.03, again=0.02, crashes=0.03, hangs=0.02, leaves=0.3, changes=0.5, dropped=0.2)
    networks = [check(seed, seed, faults, epochs=5, nodes=6) for seed in range(20)]
    happened = "\n".join(line for network in networks for line in network.happened)
    for what in ("died", "is back", "hung", "again, attempt 2", " comes ", " goes ", "given up", "dropped"):
        assert what in happened, what
    assert any(epoch.attempt > 1 for network in networks for epoch in network.epochs)


@pytest.mark.parametrize("seed", range(5))
def test_every_call_gives_one_event(seed: int) -> None:
    hierarchy = random_hierarchy(seed)
    network = Network(hierarchy, seed, Faults(0.3), events=True)
    network.run(1)
    policies = {subject: operator for subject, operator in network.calls if operator.startswith("policy ")}
    expected = []
    for name, node in hierarchy.bound.items():
        expected += [(name, "predict")]
        expected += [(name, "observe")] if name != hierarchy.world else []
        expected += [(name, "select_policy")] if node.above else []
        expected += [(name, policies[name])]
    for (lower, upper), edge in hierarchy.bound_edges.items():
        functions = {"sense": edge.sense, "task": edge.task, "context": edge.context}
        expected += [(f"{lower}->{upper}", kind) for kind, function in functions.items() if function is not None]
    assert sorted(network.calls) == sorted(expected)
