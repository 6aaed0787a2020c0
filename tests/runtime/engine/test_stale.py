"""Epochs that overlap: what inputs are used, drained epochs, what a roster's change leaves behind.

Whole hierarchies are compared with a formal reference; one engine is looked at by itself.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.engines import EPOCH, ROSTER, Solo, message, other, wiring
from support.hierarchies import random_hierarchy
from support.recording import Recorder, sent, steps, verdicts

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import NO_DIGEST, DigestChain, formal_digest
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.engine.effects import Saved
from hierax.runtime.engine.stale import StaleEngine
from hierax.runtime.engine.table import Phase, Verdict
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.runner import NodeRunner, World
from hierax.runtime.transport.port import MemoryNetwork
from hierax.schemas.messages import CONTEXT, DRAIN, OBSERVATIONS, TASKS, Message

ROSTER_HASH = bytes(range(32))
BREAKS = 30


def formal_digests(hierarchy: Hierarchy, epochs: int) -> list[bytes]:
    """The digests of epochs with the barrier, by the formal model."""
    now, digests = ActiveHierarchy.initial(hierarchy), [NO_DIGEST]
    for _ in range(epochs):
        now = update(now)
        digests.append(formal_digest(now, digests[-1], ROSTER_HASH))
    return digests[1:]


class DrainingRunner(NodeRunner):
    """Every epoch is a drained one."""

    def drain(self, drains: bool) -> None:
        super().drain(True)


def run(
    hierarchy: Hierarchy,
    epochs: int,
    staleness: Staleness,
    seed: int,
    make: type[NodeRunner] = NodeRunner,
    disturb: Callable[[MemoryNetwork], None] = lambda network: None,
) -> tuple[list[bytes], list[StaleEngine]]:
    network = MemoryNetwork(seed)
    tasking = frozenset(pair for pair, edge in hierarchy.bound_edges.items() if edge.task)
    place = Place(roster_hash=ROSTER_HASH, tasking=tasking)
    edges = tuple(hierarchy.bound_edges.values())
    digests: list[bytes] = []
    pacemaker = Pacemaker(DigestChain(ROSTER_HASH), epochs, lambda _, digest: digests.append(digest))
    runners = {}
    for name, node in hierarchy.bound.items():
        world = World(pacemaker) if name == hierarchy.world else None
        runner = make(Wiring(node, edges, place), network.open_port(name), world=world, staleness=staleness)
        runner.port.on_mended(runner.engine.say_again)
        runners[name] = runner
    runners[hierarchy.world].finish()
    if staleness.free:
        take_turns(runners, pacemaker, random.Random(seed))
    while (name := network.next_receiver()) is not None:
        received = runners[name].port.receive()
        if received is not None:
            runners[name].step(received)
            disturb(network)
    engines = [runner.engine for runner in runners.values()]
    return digests, [engine for engine in engines if isinstance(engine, StaleEngine)]


@pytest.mark.parametrize("staleness", [Staleness(1), Staleness(3)])
@pytest.mark.parametrize("seed", range(10))
def test_links_may_break_and_what_was_lost_is_said_again(seed: int, staleness: Staleness) -> None:
    hierarchy = random_hierarchy(seed)
    epochs = 9
    rng = random.Random(seed)
    pairs = sorted(hierarchy.bound_edges)

    broken: list[tuple[str, str]] = []

    def disturb(network: MemoryNetwork) -> None:
        if rng.random() < 0.1 and len(broken) < BREAKS:  # each has much said again, which may be lost as well
            broken.append(rng.choice(pairs))
            network.break_link(*broken[-1])

    digests, engines = run(hierarchy, epochs, staleness, seed, disturb=disturb)
    assert len(digests) == epochs, "nobody waits for what was lost"
    assert all((engine.epoch, engine.ages.left_out) == (epochs, 0) for engine in engines)


def take_turns(runners: Mapping[str, NodeRunner], pacemaker: Pacemaker, rng: random.Random) -> None:
    """Of any nodes, in any order; each takes in some of what has come before."""
    names = sorted(runners)
    while not pacemaker.done:
        runner = runners[rng.choice(names)]
        while rng.random() < 0.9 and (received := runner.port.receive()) is not None:
            runner.step(received)
        runner.poll()


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32),
    order=st.integers(0, 2**32),
    staleness=st.sampled_from((Staleness(None), Staleness(1), Staleness(8))),
)
def test_drained_epochs_are_those_of_the_barrier_in_any_order(seed: int, order: int, staleness: Staleness) -> None:
    hierarchy = random_hierarchy(seed, nodes=5, setting=OperatorSetting(seed=order))
    digests, engines = run(hierarchy, 6, staleness, order, DrainingRunner)
    assert digests == formal_digests(hierarchy, 6)
    assert all(engine.ages.largest == engine.ages.left_out == 0 for engine in engines)


@pytest.mark.parametrize("seed", range(20))
def test_in_free_running_all_nodes_have_a_part_in_the_first_epoch_and_the_last(seed: int) -> None:
    hierarchy = random_hierarchy(seed, setting=OperatorSetting(seed=seed))
    digests, engines = run(hierarchy, 30, Staleness(None), seed)
    assert digests[0] == formal_digests(hierarchy, 1)[0]
    assert len(digests) == 30
    assert all((engine.epoch, engine.phase) == (30, Phase.DONE) for engine in engines)
    above = [engine for engine in engines if not engine.is_world]
    assert sum(engine.ages.left_out for engine in above) > 0
    assert max(engine.ages.largest for engine in engines) > 0


@pytest.mark.parametrize("seed", range(20))
def test_inputs_are_never_older_than_allowed_and_some_are_as_old(seed: int) -> None:
    hierarchy = random_hierarchy(seed, setting=OperatorSetting(seed=seed))
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
        _, engines = run(random_hierarchy(seed, setting=OperatorSetting(seed=seed)), 20, Staleness(2), seed)
        means += [engine.ages.metrics()["staleness_mean"] for engine in engines if engine.ages.inputs]
    assert min(means) < 1.5 < max(means)


# --- one engine by itself

FREE = Staleness(None)
NEXT_ROSTER = ROSTER + 1


class LooseSolo(Solo):
    """One loose engine, and all that it calls."""

    def __init__(
        self, staleness: Staleness, wired: Wiring | None = None, saved: Saved | None = None, joins: bool = False
    ) -> None:
        self.recorder = Recorder()
        wired = wiring(mixing=True) if wired is None else wired
        self.loose = StaleEngine(wired, self.recorder, saved=saved, joins=joins, staleness=staleness)
        self.engine = self.loose

    def turn(self, *messages: Message) -> list[Any]:
        """What it calls when these come before its turn, in free running."""
        outputs = self.take(*messages)
        assert outputs == []
        self.loose.poll()
        return self.recorder.take()

    def ages(self) -> dict[str, float]:
        return self.loose.ages.metrics()


def observed(epoch: int, drains: bool = False, **change: Any) -> Message:
    return message(OBSERVATIONS, epoch, extensions={DRAIN: True} if drains else {}, **change)


def from_above(epoch: int, **change: Any) -> tuple[Message, Message]:
    return message(TASKS, epoch, **change), message(CONTEXT, epoch, **change)


def used(outputs: list[Any]) -> list[tuple[int, tuple[Any, ...], tuple[Any, ...]]]:
    """The epochs that were done, and what came from above."""
    return [(step.epoch, step.tasks, step.context) for step in steps(outputs)]


def inputs(*epochs: int) -> list[tuple[int, tuple[Any, ...], tuple[Any, ...]]]:
    """Epoch by epoch, of which one what came from above was."""
    return [(k, (f"{TASKS} {old}",), (f"{CONTEXT} {old}",)) for k, old in enumerate(epochs, 1)]


def test_the_newest_in_hand_is_used() -> None:
    solo = LooseSolo(Staleness(2))
    outputs = solo.take(observed(1), *from_above(1))
    outputs += solo.take(observed(2), *from_above(2))
    outputs += solo.take(*from_above(3), observed(3))
    outputs += solo.take(observed(4), observed(5), *from_above(4))
    assert used(outputs) == inputs(1, 1, 3, 3, 3)
    assert solo.ages() == {"staleness_mean": 0.8, "staleness_max": 2.0, "epochs_left_out": 0.0}


@pytest.mark.parametrize("epochs", [1, 3])
def test_what_is_older_than_allowed_is_waited_for(epochs: int) -> None:
    solo = LooseSolo(Staleness(epochs))
    solo.take(observed(1), *from_above(1))
    outputs = solo.take(*(observed(k) for k in range(2, 9)))
    assert [step.epoch for step in steps(outputs)] == list(range(2, epochs + 2))
    assert solo.engine.waits_for == (("top", CONTEXT), ("top", TASKS))
    assert steps(solo.take(message(CONTEXT, 2))) == []
    assert solo.engine.waits_for == (("top", TASKS),)
    assert [step.epoch for step in steps(solo.take(message(TASKS, 2)))] == [epochs + 2]
    assert solo.ages()["staleness_max"] == epochs


def test_an_epoch_is_not_begun_twice_by_what_comes_twice() -> None:
    solo = LooseSolo(Staleness(1))
    once = [observed(1), *from_above(1), observed(2), *from_above(2)]
    assert used(solo.take(*(each for each in once for _ in range(2)))) == inputs(1, 1)


# --- drained epochs


@pytest.mark.parametrize("staleness", [Staleness(2), FREE])
def test_a_drained_epoch_waits_for_its_own_inputs_and_says_so_above(staleness: Staleness) -> None:
    solo = LooseSolo(staleness)
    take = solo.turn if staleness.free else solo.take
    take(observed(1, drains=True))
    solo.take(*from_above(1))
    outputs = take(observed(2, drains=True))
    assert [dict(each.header.extensions) for each in sent(outputs)] == [{DRAIN: True}]
    assert solo.take(message(CONTEXT, 2)) == []
    assert solo.engine.waits_for == (("top", TASKS),)
    outputs = solo.take(message(TASKS, 2))
    assert used(outputs) == inputs(1, 2)[1:]
    assert all(not each.header.extensions for each in sent(outputs)), "below it is known"
    outputs = take(observed(3))
    assert used(outputs)[0][0] == 3, "an epoch after it is none"
    assert all(not each.header.extensions for each in sent(outputs))


def world(staleness: Staleness) -> LooseSolo:
    return LooseSolo(staleness, wiring("low", (), ("mid",), mixing=True))


def to_world(epoch: int, **change: Any) -> Message:
    return message(CONTEXT, epoch, sender="mid", receiver="low", **{"instance": 8, **change})


def is_drained(outputs: list[Any]) -> list[bool]:
    return [DRAIN in each.header.extensions for each in sent(outputs)]


@pytest.mark.parametrize("staleness", [Staleness(2), FREE])
def test_the_first_epoch_under_a_roster_is_drained(staleness: Staleness) -> None:
    solo = world(staleness)
    assert is_drained(solo.begin()) == [True]
    assert solo.engine.phase is Phase.PREDICT
    solo.take(to_world(1))
    solo.loose.drains = False
    outputs = solo.begin()
    assert is_drained(outputs) == [False]
    assert [step.epoch for step in steps(outputs)] == [2]
    solo.prepare(wiring("low", (), ("mid",), roster=NEXT_ROSTER, mixing=True))
    solo.loose.rewire(NEXT_ROSTER)
    solo.loose.drains = False
    assert is_drained(solo.begin()[1:]) == [True]
    assert verdicts(solo.take(to_world(3))) == [Verdict.OLD_ROSTER]
    assert solo.engine.phase is Phase.PREDICT
    assert [step.epoch for step in steps(solo.take(to_world(3, roster=NEXT_ROSTER)))] == [3]


def test_an_attempt_under_a_new_roster_is_drained() -> None:
    solo = world(Staleness(2))
    solo.begin()
    solo.take(to_world(1))
    solo.loose.drains = False
    solo.begin()
    solo.loose.drains = False
    solo.begin()
    solo.loose.drains = False
    solo.begin()
    assert solo.engine.phase is Phase.PREDICT, "it waits for what is of epoch 2 or later"
    solo.prepare(wiring("low", (), ("mid",), roster=NEXT_ROSTER, mixing=True))
    solo.loose.rewire(NEXT_ROSTER)
    assert is_drained(solo.begin_again(1)[1:]) == [True]
    assert verdicts(solo.take(to_world(2), to_world(3))) == [Verdict.OLD_ROSTER] * 2
    assert [step.epoch for step in steps(solo.take(to_world(4, attempt=1, roster=NEXT_ROSTER)))] == [4]


# --- free running


def test_a_node_that_runs_freely_takes_its_turn_with_the_newest() -> None:
    solo = LooseSolo(FREE)
    assert solo.turn() == []
    solo.turn(observed(1, drains=True))
    solo.take(*from_above(1))
    (step,) = steps(solo.turn(observed(3), observed(5), observed(4)))
    assert (step.epoch, step.observations) == (5, (f"{OBSERVATIONS} 5",))
    assert (step.tasks, step.context) == ((f"{TASKS} 1",), (f"{CONTEXT} 1",))
    assert solo.ages() == {"staleness_mean": 2.0, "staleness_max": 4.0, "epochs_left_out": 3.0}
    assert solo.turn(observed(5), observed(2)) == [], "it has done that"
    assert used(solo.turn(*from_above(5), *from_above(2), observed(9))) == inputs(*[5] * 9)[8:]
    assert solo.ages() == {"staleness_mean": 8 / 3, "staleness_max": 4.0, "epochs_left_out": 6.0}


def test_a_node_that_is_attached_has_left_nothing_out_and_a_node_that_is_back_has() -> None:
    solo = LooseSolo(FREE, joins=True)
    solo.turn(observed(40, drains=True))
    assert [step.epoch for step in steps(solo.take(*from_above(40)))] == [40]
    assert solo.ages()["epochs_left_out"] == 0
    state = solo.engine.state
    back = LooseSolo(FREE, saved=Saved(40, 0, state, state))
    back.turn(observed(44))
    assert back.ages()["epochs_left_out"] == 3


def fan(staleness: Staleness) -> LooseSolo:
    return LooseSolo(staleness, wiring(below=("low", "low2"), mixing=True))


def observed_too(epoch: int, drains: bool = False) -> Message:
    return other(OBSERVATIONS, epoch, extensions={DRAIN: True} if drains else {})


def test_the_newest_of_each_below_is_taken() -> None:
    solo = fan(FREE)
    assert solo.turn(observed(1, drains=True)) == []
    solo.turn(observed_too(1, drains=True))
    assert steps(solo.take(*from_above(1)))
    (step,) = steps(solo.turn(observed(2)))
    assert (step.epoch, step.observations) == (2, (f"{OBSERVATIONS} 2", f"{OBSERVATIONS} 1"))
    (step,) = steps(solo.turn(observed_too(3)))
    assert (step.epoch, step.observations) == (3, (f"{OBSERVATIONS} 2", f"{OBSERVATIONS} 3"))


def test_a_drained_epoch_waits_for_all_below() -> None:
    solo = fan(FREE)
    assert solo.turn(observed(2, drains=True), observed_too(1)) == []
    outputs = solo.turn(observed_too(2, drains=True))
    assert [each.payload for each in sent(outputs)] != []
    assert solo.engine.phase is Phase.PREDICT
    assert solo.turn(message(CONTEXT, 2)) == [], "it is in the middle of it"
    (step,) = steps(solo.take(message(TASKS, 2)))
    assert step.observations == (f"{OBSERVATIONS} 2",) * 2
    (step,) = steps(solo.turn(observed(3)))
    assert (step.epoch, solo.loose.drains) == (3, False), "that low2 has drained once is over"


# --- what a change of the roster leaves behind


@pytest.mark.parametrize("staleness", [Staleness(3), FREE])
def test_what_another_instance_or_an_older_roster_says_is_never_used(staleness: Staleness) -> None:
    solo = LooseSolo(staleness)
    wrong = [
        each
        for kind in EPOCH
        for each in (message(kind, 1, instance=77), message(kind, 1, roster=ROSTER - 1))
    ]  # fmt: skip
    assert verdicts(solo.take(*wrong)) == [Verdict.OTHER_INSTANCE, Verdict.OLD_ROSTER] * 3
    assert verdicts(solo.take(message(CONTEXT, 1, digest=b""))) == [Verdict.INCOMPLETE]
    assert verdicts(solo.take(message(CONTEXT, 1, sender="stranger"))) == [Verdict.FOREIGN]
    assert not solo.loose.poll()
    assert solo.engine.epoch == 0
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)


@pytest.mark.parametrize("staleness", [Staleness(3), FREE])
def test_after_a_change_nothing_of_the_roster_before_is_used(staleness: Staleness) -> None:
    solo = LooseSolo(staleness)
    take = solo.turn if staleness.free else solo.take
    take(observed(1, drains=True))
    solo.take(*from_above(1))
    take(observed(2, drains=True))
    solo.take(*from_above(2))
    solo.prepare(wiring(roster=NEXT_ROSTER, mixing=True))
    early = from_above(3, text="new", roster=NEXT_ROSTER)
    assert solo.take(*early[:1]) == [], "it is held until the roster is taken up"
    outputs = solo.take(observed(3, drains=True, roster=NEXT_ROSTER))
    if staleness.free:
        solo.loose.poll()
    assert solo.engine.wiring.roster == NEXT_ROSTER
    assert steps(outputs) == []
    assert verdicts(solo.take(*from_above(3))) == [Verdict.OLD_ROSTER] * 2
    assert used(solo.take(*early)) == [(3, ("new",), ("new",))]
    assert verdicts(solo.take(observed(4))) == [Verdict.OLD_ROSTER]


def test_after_a_loss_a_node_goes_on_with_the_epoch_under_way() -> None:
    """It waits in epoch 3 for what the lost one had to send; the world has come to epoch 5."""
    solo = LooseSolo(Staleness(1))
    solo.take(observed(1), *from_above(1))
    solo.take(observed(2), observed(3), observed(4))
    done = solo.engine.state
    assert (solo.engine.epoch, solo.engine.phase) == (3, Phase.PREDICT)
    solo.prepare(wiring(roster=NEXT_ROSTER, mixing=True))
    solo.take(observed(5, drains=True, attempt=1, roster=NEXT_ROSTER))
    assert (solo.engine.epoch, solo.engine.attempt, solo.engine.phase) == (5, 1, Phase.PREDICT)
    assert solo.engine.start is done
    assert solo.ages()["epochs_left_out"] == 2, "epoch 3, which it did not end, and epoch 4"
    assert verdicts(solo.take(*from_above(4))) == [Verdict.OLD_ROSTER] * 2
    outputs = solo.take(*from_above(5, text="new", attempt=1, roster=NEXT_ROSTER))
    assert used(outputs) == [(5, ("new",), ("new",))]


def test_after_a_loss_in_a_drained_epoch_a_node_that_runs_freely_does_it_again() -> None:
    solo = LooseSolo(FREE)
    solo.turn(observed(1, drains=True))
    solo.take(*from_above(1))
    solo.turn(observed(2, drains=True))
    assert solo.engine.phase is Phase.PREDICT
    done = solo.engine.state
    solo.prepare(wiring(roster=NEXT_ROSTER, mixing=True))
    solo.take(observed(2, drains=True, attempt=1, roster=NEXT_ROSTER))
    assert solo.loose.poll()
    assert (solo.engine.epoch, solo.engine.attempt) == (2, 1)
    assert solo.engine.start is done
    assert used(solo.take(*from_above(2, text="new", attempt=1, roster=NEXT_ROSTER))) == [(2, ("new",), ("new",))]
    assert solo.ages()["epochs_left_out"] == 0


def test_a_node_that_has_done_the_epoch_undoes_it_after_a_loss() -> None:
    solo = LooseSolo(Staleness(2))
    solo.take(observed(1), *from_above(1))
    before = solo.engine.state
    solo.take(observed(2))
    assert solo.engine.phase is Phase.DONE
    solo.prepare(wiring(roster=NEXT_ROSTER, mixing=True))
    solo.take(observed(2, drains=True, attempt=1, roster=NEXT_ROSTER))
    assert solo.engine.start is solo.engine.state is before
    assert used(solo.take(*from_above(2, text="new", attempt=1, roster=NEXT_ROSTER))) == [(2, ("new",), ("new",))]


def test_what_the_roster_before_gave_of_the_same_epoch_is_not_used() -> None:
    solo = LooseSolo(Staleness(2))
    solo.take(observed(1, drains=True), *from_above(1))
    assert (solo.engine.epoch, solo.engine.phase) == (1, Phase.DONE)
    solo.prepare(wiring(roster=NEXT_ROSTER, mixing=True))
    outputs = solo.take(observed(1, drains=True, attempt=1, roster=NEXT_ROSTER))
    assert steps(outputs) == []
    assert solo.engine.waits_for == (("top", CONTEXT), ("top", TASKS))
    assert used(solo.take(*from_above(1, text="new", attempt=1, roster=NEXT_ROSTER))) == [(1, ("new",), ("new",))]


def test_what_a_node_gave_that_is_below_no_more_does_not_count() -> None:
    solo = fan(FREE)
    solo.turn(observed(1, drains=True), observed_too(1, drains=True))
    solo.take(*from_above(1))
    solo.prepare(wiring(below=("low", "low3"), roster=NEXT_ROSTER, mixing=True))
    solo.take(observed(2, drains=True, roster=NEXT_ROSTER))
    assert not solo.loose.poll(), "it waits for low3"
    assert solo.engine.epoch == 1
    third = message(OBSERVATIONS, 2, sender="low3", roster=NEXT_ROSTER, extensions={DRAIN: True})
    assert not steps(solo.turn(third))
    assert steps(solo.take(*from_above(2, roster=NEXT_ROSTER)))
