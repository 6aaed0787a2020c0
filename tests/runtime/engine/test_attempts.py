"""From epoch to epoch and attempt to attempt: with what a node goes on, and what it forgets."""

from __future__ import annotations

import pytest
from support.engines import EPOCH, Solo, encoded, message, other, wiring
from support.hierarchies import mark
from support.recording import Completed, Kept, Sent, of, plain, sent, steps

from hierax.runtime.core.errors import ContradictionError
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Saved
from hierax.runtime.engine.engine import AFTER
from hierax.runtime.engine.table import Phase, Verdict
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS


def mixing() -> Solo:
    return Solo(wiring(mixing=True))


def state(text: str, policy: str = "p0") -> ActiveNode:
    """Some state of a mixing node."""
    node = wiring().node.node
    return ActiveNode({**node.initial_belief(), "mark": mark(text)}, policy, (text,))


# --- the next epoch


@pytest.mark.parametrize("attempt", [0, 3])
def test_the_next_epoch_begins_with_any_attempt_of_it(attempt: int) -> None:
    solo = Solo()
    solo.epoch(1, attempt=2)
    done = solo.engine.state
    up = [each.header for each in sent(solo.take(message(OBSERVATIONS, 2, attempt=attempt, extensions={AFTER: 2})))]
    assert (solo.engine.epoch, solo.engine.attempt, solo.engine.phase) == (2, attempt, Phase.PREDICT)
    assert solo.engine.start is solo.engine.state is done
    assert [header.extensions for header in up if header.kind == OBSERVATIONS] == [{AFTER: 2}]
    assert [step.epoch for step in steps(solo.take(*(message(kind, 2, attempt=attempt) for kind in EPOCH[1:])))] == [2]


@pytest.mark.parametrize("says", [{}, {AFTER: 1}, {AFTER: "x"}])
def test_an_attempt_that_nobody_has_begun_is_noticed_when_another_one_counts(says: dict[str, object]) -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS, 1))
    solo.take(message(OBSERVATIONS, 1, "forged", attempt=2), *(message(kind, 1, attempt=2) for kind in EPOCH[1:]))
    with pytest.raises(ContradictionError, match=r"it has done attempt 2 of epoch 1, and attempt [01] counts"):
        solo.take(message(OBSERVATIONS, 2, extensions=says))


def test_an_attempt_that_nobody_has_begun_is_undone_when_the_one_before_counts() -> None:
    plain_solo, solo = mixing(), mixing()
    for each in (plain_solo, solo):
        each.epoch(1)
    solo.take(message(OBSERVATIONS, 1, "forged", attempt=2), *(message(kind, 1, attempt=2) for kind in EPOCH[1:]))
    assert solo.engine.encoded != plain_solo.engine.encoded
    (kept,) = of(Kept, solo.take(message(OBSERVATIONS, 2)))
    assert (kept.epoch, kept.attempt, kept.now) == (1, 0, plain_solo.engine.encoded)
    assert solo.engine.encoded_start == plain_solo.engine.encoded


def test_the_next_epoch_is_none_before_this_one_is_done() -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS))
    assert solo.take(message(OBSERVATIONS, 2), message(OBSERVATIONS, 2, attempt=1)) == []
    assert solo.engine.epoch == 1
    solo.take(message(TASKS), message(CONTEXT))
    assert (solo.engine.epoch, solo.engine.attempt) == (2, 1)


# --- the epoch again


@pytest.mark.parametrize("epoch", [1, 2])
@pytest.mark.parametrize("came", range(len(EPOCH) + 1))
@pytest.mark.parametrize("attempt", [1, 4])
def test_a_later_attempt_goes_as_if_there_had_been_no_other(epoch: int, came: int, attempt: int) -> None:
    solo, fresh = mixing(), mixing()
    for each in (solo, fresh):
        for past in range(1, epoch):
            each.epoch(past)
    solo.take(*(message(kind, epoch, text="old") for kind in EPOCH[:came]))
    outputs, expected = ([*each.epoch(epoch, text="new", attempt=attempt)] for each in (solo, fresh))
    if epoch == 1 and came:
        expected = expected[1:]  # the initial state is saved before the first attempt
    assert plain(outputs) == plain(expected)
    for name in ("state", "start"):
        assert len({encoded(getattr(each.engine, name)) for each in (solo, fresh)}) == 1
    assert (solo.engine.encoded, solo.engine.encoded_start) == (fresh.engine.encoded, fresh.engine.encoded_start)


def test_it_sets_back_belief_policy_actions_and_their_encoding() -> None:
    solo = Solo(wiring(below=("low", "low2")))
    for epoch in (1, 2):
        solo.take(other(OBSERVATIONS, epoch), *(message(kind, epoch) for kind in EPOCH))
        if epoch == 1:
            start = solo.engine.state
    after = solo.engine.state
    assert after.belief["mark"] != start.belief["mark"]
    assert after.policy != start.policy
    assert after.actions != start.actions
    assert solo.engine.encoded == encoded(after)
    solo.take(message(OBSERVATIONS, 2, attempt=1))
    assert solo.engine.state is solo.engine.start is start
    assert solo.engine.encoded == solo.engine.encoded_start == encoded(start)


def test_a_root_keeps_the_policy_of_the_epochs_start() -> None:
    saved = Saved(1, 0, state("start", "p2"), state("now", "p3"))
    for change, policy in (({"epoch": 1, "attempt": 1}, "p2"), ({"epoch": 2}, "p3")):
        (step,) = steps(Solo(wiring(above=()), saved).take(message(OBSERVATIONS, **change)))
        assert step.policy == policy


def test_of_two_below_a_later_attempt_of_one_supersedes_what_the_other_sent() -> None:
    solo = Solo(wiring(below=("low", "low2")))
    assert of(Sent, solo.take(message(OBSERVATIONS, text="old"))) == []
    assert solo.take(other(OBSERVATIONS, text="new", attempt=1)) == []
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    assert solo.take(message(OBSERVATIONS, text="old")) == []
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    outputs = solo.take(*(message(kind, text="new too", attempt=1) for kind in EPOCH))
    assert [(step.attempt, step.observations) for step in steps(outputs)] == [(1, ("new too", "new"))]


@pytest.mark.parametrize("lower", [0, 1])
def test_of_two_below_a_lower_attempt_of_one_is_dropped(lower: int) -> None:
    solo = Solo(wiring(below=("low", "low2")))
    solo.take(message(OBSERVATIONS, text="new", attempt=2))
    late = other(OBSERVATIONS, text="old", attempt=lower)
    assert solo.engine.judge(late.header) is Verdict.LATE
    assert solo.take(late) == []
    solo.take(other(OBSERVATIONS, text="new", attempt=2))
    assert solo.engine.phase is Phase.PREDICT
    assert solo.engine.attempt == 2


def test_what_came_from_above_in_another_attempt_is_forgotten() -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS), message(TASKS, text="old"), message(OBSERVATIONS, attempt=1))
    assert solo.engine.waits_for == (("top", CONTEXT), ("top", TASKS))
    assert solo.take(message(TASKS, text="old"), message(CONTEXT, text="old")) == []
    (step,) = steps(solo.take(message(TASKS, attempt=1), message(CONTEXT, attempt=1)))
    assert (step.attempt, step.tasks, step.context) == (1, ("task 1",), ("ctx 1",))


def test_an_epoch_may_be_done_again_and_again() -> None:
    solo = mixing()
    results = [plain(of(Completed, solo.epoch(attempt=attempt)))[0][1:] for attempt in (0, 1, 5, 6)]
    assert len(set(results)) == 1


def test_no_attempt_makes_an_epoch_of_what_is_before_the_first() -> None:
    solo = Solo()
    assert solo.take(message(OBSERVATIONS, 0, attempt=1)) == []
    assert (solo.engine.phase, solo.engine.epoch, solo.engine.attempt) == (Phase.DONE, 0, 0)


# --- after a crash, and as a newcomer


def saved_solo() -> Solo:
    return Solo(saved=Saved(4, 2, state("start", "p1"), state("now", "p2")))


def test_a_node_goes_on_where_it_was_saved() -> None:
    engine = saved_solo().engine
    assert (engine.epoch, engine.attempt, engine.phase) == (4, 2, Phase.DONE)
    assert encoded(engine.start) == engine.encoded_start == encoded(state("start", "p1"))
    assert encoded(engine.state) == engine.encoded == encoded(state("now", "p2"))
    assert engine.waits_for == (("low", OBSERVATIONS),)


@pytest.mark.parametrize(
    ("change", "start"),
    [
        ({"epoch": 4, "attempt": 3}, "start"),
        ({"epoch": 4, "attempt": 7}, "start"),
        ({"epoch": 5}, "now"),
        ({"epoch": 5, "attempt": 1}, "now"),
    ],
)
def test_who_has_finished_an_epoch_can_do_it_again_or_the_next_one(change: dict[str, int], start: str) -> None:
    solo = saved_solo()
    policy = {"start": "p1", "now": "p2"}[start]
    solo.take(message(OBSERVATIONS, **change, extensions={AFTER: 2} if change["epoch"] == 5 else {}))
    assert encoded(solo.engine.start) == encoded(state(start, policy))
    (kept,) = of(Kept, solo.take(message(TASKS, **change), message(CONTEXT, **change)))
    assert (kept.epoch, kept.attempt) == (change["epoch"], change.get("attempt", 0))
    assert kept.start == encoded(state(start, policy))


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({"epoch": 4, "attempt": 2}, Verdict.DOUBLE),
        ({"epoch": 4, "attempt": 1}, Verdict.LATE),
        ({"epoch": 3, "attempt": 9}, Verdict.LATE),
        ({"epoch": 1}, Verdict.LATE),
        ({"epoch": 6}, Verdict.EARLY),
        ({"epoch": 6, "attempt": 3}, Verdict.EARLY),
    ],
)
def test_and_no_other_one(change: dict[str, int], verdict: Verdict) -> None:
    solo = saved_solo()
    assert solo.engine.judge(message(OBSERVATIONS, **change).header) is verdict
    assert solo.take(*(message(kind, **change) for kind in EPOCH)) == []
    assert (solo.engine.epoch, solo.engine.attempt, solo.engine.phase) == (4, 2, Phase.DONE)


def test_a_world_goes_on_where_it_was_saved() -> None:
    world = wiring("low", (), ("mid",), mixing=True)
    start = Solo(world).engine.state
    solo = Solo(world, Saved(6, 0, start, start))
    assert [each.header[3:5] for each in sent(solo.begin(3))] == [(7, 3)]


@pytest.mark.parametrize("attempt", [0, 2])
def test_a_newcomer_begins_with_the_first_epoch_that_it_hears_of(attempt: int) -> None:
    first = message(OBSERVATIONS, 5, attempt=attempt)
    assert Solo().engine.judge(first.header) is Verdict.EARLY
    solo = Solo(joins=True)
    initial = solo.engine.state
    solo.take(message(CONTEXT, 5, attempt=attempt), first)
    assert (solo.engine.epoch, solo.engine.attempt) == (5, attempt)
    assert solo.engine.start is initial
    assert solo.engine.waits_for == (("top", TASKS),)
    assert solo.take(message(OBSERVATIONS, 7)) == []
    (step,) = steps(solo.take(message(TASKS, 5, attempt=attempt)))
    assert step.epoch == solo.engine.epoch == 5
    assert solo.take(message(OBSERVATIONS, 8)) == []
    assert solo.engine.epoch == 5


def test_a_newcomer_does_its_first_epoch_again_from_its_beginning() -> None:
    solo, fresh = (Solo(wiring(mixing=True), joins=True) for _ in range(2))
    solo.epoch(5, text="old")
    assert plain(solo.epoch(5, attempt=1)) == plain(fresh.epoch(5, attempt=1)[1:])


def test_a_newcomer_that_was_given_a_state_begins_the_epoch_after_it() -> None:
    given = state("given", "p3")
    solo = Solo(joins=True)
    solo.engine.restore(Saved(4, 0, given, given))
    (first, *_) = solo.take(message(OBSERVATIONS, 5))
    assert first == Kept(4, 0, encoded(given), encoded(given))
    assert solo.engine.start is given
