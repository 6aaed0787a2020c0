"""Every row of the protocol's table."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.engines import DIGEST, EPOCH, INSTANCES, ROSTER, Solo, message, wiring
from support.engines import other as second
from support.hierarchies import MixingNode
from support.recording import Acted, Completed, Lacked, Output, Refused, Sent, of, sent, steps, verdicts

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.errors import ContradictionError, OperatorError
from hierax.runtime.engine import table
from hierax.runtime.engine.effects import Committed
from hierax.runtime.engine.engine import AFTER, Engine
from hierax.runtime.engine.table import (
    ACTIONS,
    ATTEMPTS_AHEAD,
    EPOCHS_AHEAD,
    HELD_BYTES,
    HELD_MESSAGES,
    HELD_SLOTS,
    ROSTERS_AHEAD,
    ROWS,
    Action,
    Phase,
    Verdict,
)
from hierax.schemas.messages import CONTEXT, HELLO, OBSERVATIONS, TASKS, Message

REFUSED: list[tuple[Verdict, str, dict[str, Any]]] = [
    (Verdict.OLD_ROSTER, OBSERVATIONS, {"roster": ROSTER - 1}),
    (Verdict.FOREIGN, OBSERVATIONS, {"receiver": "top"}),
    (Verdict.FOREIGN, OBSERVATIONS, {"sender": "stranger"}),
    (Verdict.FOREIGN, OBSERVATIONS, {"sender": "top"}),
    (Verdict.FOREIGN, TASKS, {"sender": "low"}),
    (Verdict.FOREIGN, HELLO, {"sender": "low"}),
    (Verdict.OTHER_INSTANCE, OBSERVATIONS, {"instance": 6}),
    (Verdict.OTHER_INSTANCE, OBSERVATIONS, {"instance": 8}),
    (Verdict.OTHER_INSTANCE, CONTEXT, {"instance": 10}),
    (Verdict.INCOMPLETE, CONTEXT, {"digest": b""}),
]


def results(outputs: list[Output]) -> list[tuple[bytes, bytes]]:
    """State and digest of each epoch that was completed."""
    return [(completed.state, completed.digest) for completed in of(Completed, outputs)]


@pytest.mark.parametrize(("verdict", "kind", "change"), REFUSED)
def test_what_is_refused_is_reported_and_changes_nothing(verdict: Verdict, kind: str, change: dict[str, Any]) -> None:
    solo = Solo()
    wrong = message(kind, **change)
    assert solo.take(wrong) == [Refused(wrong.header, verdict)]
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    assert results(solo.epoch()) == results(Solo().epoch())


@pytest.mark.parametrize(("verdict", "kind", "change"), REFUSED)
def test_neither_a_later_epoch_nor_attempt_makes_it_right(verdict: Verdict, kind: str, change: dict[str, Any]) -> None:
    solo = Solo()
    solo.epoch()
    before = solo.engine.state
    for later in (message(kind, 2, **change), message(kind, 1, **{**change, "attempt": 1})):
        assert solo.take(later) == [Refused(later.header, verdict)]
        assert (solo.engine.phase, solo.engine.epoch, solo.engine.attempt) == (Phase.DONE, 1, 0)
    assert solo.engine.state is before


def test_a_message_of_a_roster_to_come_is_held_and_not_taken() -> None:
    solo = Solo()
    assert solo.take(message(OBSERVATIONS, roster=ROSTER + 1)) == [Lacked(ROSTER + 1)]
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    assert [step.epoch for step in steps(solo.epoch())] == [1]
    # it is judged again whenever the epoch changes, and still is not for this roster
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    assert solo.engine.judge(message(OBSERVATIONS, 2, roster=ROSTER + 1).header) is Verdict.NEW_ROSTER


@pytest.mark.parametrize("late", [{"epoch": 1}, {"epoch": 0}, {"epoch": 0, "attempt": 9}])
@pytest.mark.parametrize("kind", EPOCH)
def test_what_is_late_is_dropped(kind: str, late: dict[str, int]) -> None:
    solo = Solo()
    solo.epoch()
    solo.take(message(OBSERVATIONS, 2))
    assert solo.engine.judge(message(kind, **late).header) is Verdict.LATE
    assert solo.take(message(kind, **late)) == []
    assert solo.engine.waits_for == (("top", CONTEXT), ("top", TASKS))


@pytest.mark.parametrize("kind", EPOCH)
def test_an_earlier_attempt_is_late(kind: str) -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS, attempt=2))
    for attempt in (0, 1):
        late = message(kind, text="late", attempt=attempt)
        assert solo.engine.judge(late.header) is Verdict.LATE
        assert solo.take(late) == []
    (step,) = steps(solo.take(message(TASKS, attempt=2), message(CONTEXT, attempt=2)))
    assert (step.observations, step.tasks, step.context) == (("obs 1",), ("task 1",), ("ctx 1",))
    assert step.attempt == 2


@pytest.mark.parametrize("kind", [TASKS, CONTEXT])
def test_a_later_attempt_from_above_is_early(kind: str) -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS))
    early = message(kind, text="early", attempt=1)
    assert solo.engine.judge(early.header) is Verdict.EARLY
    assert solo.take(early) == []
    assert (solo.engine.phase, solo.engine.attempt) == (Phase.PREDICT, 0)
    (other,) = {TASKS, CONTEXT} - {kind}
    (step,) = steps(solo.take(message(OBSERVATIONS, attempt=1), message(other, attempt=1)))
    assert "early" in (*step.tasks, *step.context)


@pytest.mark.parametrize("order", [(TASKS, CONTEXT), (CONTEXT, TASKS)])
@pytest.mark.parametrize("above", ["top", "aaa"])
def test_what_is_early_is_held_until_its_half_or_epoch(order: tuple[str, str], above: str) -> None:
    solo = Solo(wiring(above=(above,), instances={**INSTANCES, "aaa": 9}))
    half = {kind: {"sender": above, "instance": 9} for kind in order}
    early = [message(kind, 2, **half.get(kind, {})) for kind in (OBSERVATIONS, *order)]
    assert solo.take(*early, *(message(kind, **half[kind]) for kind in order)) == []
    assert [(step.epoch, step.observations, step.tasks, step.context) for step in steps(_observe(solo))] == [
        (epoch, (f"obs {epoch}",), (f"task {epoch}",), (f"ctx {epoch}",)) for epoch in (1, 2)
    ]


def _observe(solo: Solo) -> list[Output]:
    return solo.take(message(OBSERVATIONS))


def test_so_many_are_held_and_no_more_of_each_sender_and_kind() -> None:
    solo = Solo()
    assert solo.take(*(message(OBSERVATIONS, 2 + n) for n in range(HELD_MESSAGES))) == []
    assert verdicts(solo.take(message(OBSERVATIONS, 2 + HELD_MESSAGES))) == [Verdict.EARLY]
    assert solo.take(message(CONTEXT, 2)) == []
    assert [step.epoch for step in steps(solo.epoch())] == [1]
    assert solo.engine.epoch == 2
    assert solo.engine.waits_for == (("top", TASKS),)


@pytest.mark.parametrize("kind", EPOCH)
def test_a_double_is_dropped(kind: str) -> None:
    solo = Solo()
    outputs: list[Output] = []
    for each in EPOCH:
        outputs += solo.take(message(each))
        if each == kind:
            assert solo.engine.judge(message(each).header) is Verdict.DOUBLE
            assert solo.take(message(each)) == []
    (step,) = steps(outputs)
    assert (step.observations, step.tasks, step.context) == (("obs 1",), ("task 1",), ("ctx 1",))


@pytest.mark.parametrize("kind", EPOCH)
@pytest.mark.parametrize("later", [0, 1])
def test_a_double_that_says_something_else_is_an_error_that_names_both_ends(kind: str, later: int) -> None:
    solo = Solo()
    solo.epoch()
    if later:
        solo.take(message(OBSERVATIONS, 2))
    sender = "low" if kind == OBSERVATIONS else "top"
    wanted = rf"mid: two {kind} messages from {sender} of epoch 1, attempt 0 say different things: .* name of {sender} "
    for forged in (message(kind, text="again"), message(kind, time_s=0.25)):
        with pytest.raises(ContradictionError, match=wanted):
            solo.take(forged)
    assert solo.take(message(kind)) == []


def test_a_double_of_one_of_two_that_are_waited_for_is_dropped() -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS), message(TASKS))
    assert solo.engine.judge(message(TASKS).header) is Verdict.DOUBLE
    assert solo.engine.judge(message(OBSERVATIONS).header) is Verdict.DOUBLE
    assert solo.take(message(TASKS)) == []
    with pytest.raises(ContradictionError):
        solo.take(message(TASKS, text="again"))


def test_a_forged_message_that_was_held_or_taken_first_is_found_out_by_the_real_one() -> None:
    solo = Solo()
    solo.take(message(OBSERVATIONS, 2, text="forged"))
    assert [step.epoch for step in steps(solo.epoch())] == [1]
    assert solo.engine.epoch == 2
    with pytest.raises(ContradictionError):
        solo.take(message(OBSERVATIONS, 2))


@pytest.mark.parametrize(
    "far",
    [
        {"epoch": 2 + EPOCHS_AHEAD},
        {"attempt": 1 + ATTEMPTS_AHEAD},
        {"epoch": 2, "attempt": 1 + ATTEMPTS_AHEAD},
        {"roster": ROSTER + 1 + ROSTERS_AHEAD},
        {"roster": ROSTER + 1, "attempt": 10**9},
    ],
)
def test_what_is_further_ahead_than_can_be_is_refused(far: dict[str, int]) -> None:
    solo = Solo()
    solo.epoch()
    wrong = message(OBSERVATIONS, **{"epoch": 1, **far})
    assert solo.take(wrong) == [Refused(wrong.header, Verdict.AHEAD)]
    assert [step.epoch for step in steps(solo.epoch(2))] == [2]


def test_what_is_held_is_bounded_by_bytes_and_the_nearest_stay() -> None:
    solo = Solo()
    big = np.zeros(HELD_BYTES // 3, np.uint8)
    for epoch in (9, 8, 7):
        far = message(OBSERVATIONS, epoch)
        refused = verdicts(solo.take(far._replace(payload=(big,))))
        assert refused == ([] if epoch > 7 else [Verdict.EARLY])
    assert [step.epoch for step in steps(solo.epoch())] == [1]


def test_of_strangers_so_many_are_held_and_no_more() -> None:
    solo = Solo()
    for number in range(HELD_SLOTS + 1):
        stranger = message(OBSERVATIONS, sender=f"n{number}", roster=ROSTER + 1)
        full = Refused(stranger.header, Verdict.NEW_ROSTER) in solo.take(stranger)
        assert full == (number >= HELD_SLOTS)
    assert [step.epoch for step in steps(solo.epoch())] == [1]


@pytest.mark.parametrize(
    ("kind", "change", "verdict"),
    [
        (CONTEXT, {"receiver": "top", "roster": ROSTER - 1}, Verdict.OLD_ROSTER),
        (CONTEXT, {"sender": "stranger", "roster": ROSTER + 1}, Verdict.NEW_ROSTER),
        (CONTEXT, {"roster": ROSTER - 1, "instance": 0}, Verdict.OLD_ROSTER),
        (CONTEXT, {"roster": ROSTER + 1, "instance": 0}, Verdict.NEW_ROSTER),
        (CONTEXT, {"receiver": "top", "instance": 0}, Verdict.FOREIGN),
        (CONTEXT, {"instance": 0, "digest": b""}, Verdict.OTHER_INSTANCE),
        (CONTEXT, {"digest": b"", "epoch": 0}, Verdict.INCOMPLETE),
        (CONTEXT, {"epoch": 0, "attempt": 9}, Verdict.LATE),
        (CONTEXT, {"epoch": 2}, Verdict.EARLY),
        (CONTEXT, {"attempt": 1}, Verdict.EARLY),
        (OBSERVATIONS, {"roster": ROSTER - 1, "epoch": 2}, Verdict.OLD_ROSTER),
        (OBSERVATIONS, {"roster": ROSTER + 1, "epoch": 2}, Verdict.NEW_ROSTER),
        (OBSERVATIONS, {"instance": 0, "epoch": 2}, Verdict.OTHER_INSTANCE),
        (OBSERVATIONS, {"instance": 0, "attempt": 1}, Verdict.OTHER_INSTANCE),
        (OBSERVATIONS, {"epoch": 2}, Verdict.NEXT),
        (OBSERVATIONS, {"epoch": 2, "attempt": 3}, Verdict.NEXT),
        (OBSERVATIONS, {"epoch": 3}, Verdict.EARLY),
        (OBSERVATIONS, {"attempt": 1}, Verdict.AGAIN),
        (OBSERVATIONS, {"epoch": 0, "attempt": 1}, Verdict.LATE),
        (OBSERVATIONS, {}, Verdict.DOUBLE),
    ],
)
def test_the_first_row_that_fits_decides(kind: str, change: dict[str, Any], verdict: Verdict) -> None:
    solo = Solo()
    solo.epoch()
    assert solo.engine.judge(message(kind, **change).header) is verdict


def test_judging_changes_nothing() -> None:
    solo = Solo()
    for change in ({}, {"attempt": 1}, {"epoch": 2}, {"roster": ROSTER + 1}, {"roster": ROSTER - 1}):
        solo.engine.judge(message(OBSERVATIONS, **change).header)
    assert solo.recorder.take() == []
    assert (solo.engine.epoch, solo.engine.attempt, solo.engine.phase) == (0, 0, Phase.DONE)


def test_every_verdict_has_its_action() -> None:
    assert set(ACTIONS) == set(Verdict)
    taken = {verdict for verdict, action in ACTIONS.items() if action is Action.TAKE}
    assert taken == {Verdict.NEXT, Verdict.AGAIN, Verdict.CURRENT}


def test_what_is_sent_says_who_when_and_of_which_roster() -> None:
    solo = Solo()
    epochs = ((1, 0), (2, 0), (2, 3))
    headers = [
        each.header
        for epoch, attempt in epochs
        for each in sent(solo.epoch(epoch, attempt=attempt, time_s=epoch / 4 + attempt))
    ]
    expected = []
    for epoch, attempt in epochs:
        place = (epoch, attempt, ROSTER, INSTANCES["mid"], epoch / 4 + attempt)
        expected += [(OBSERVATIONS, "mid", "top", *place), (CONTEXT, "mid", "low", *place)]
    assert [header[:8] for header in headers] == expected
    assert [bool(header.digest) for header in headers] == [False, True] * len(epochs)


def test_a_message_for_a_world_that_is_done_waits_for_the_epoch() -> None:
    solo = Solo(wiring("low", (), ("mid",)))
    early = message(CONTEXT, sender="mid", receiver="low", instance=INSTANCES["mid"])
    assert solo.engine.judge(early.header) is Verdict.EARLY
    assert solo.take(early) == []
    assert [type(output) for output in solo.begin()] == [Sent, Acted, Committed, Completed]
    assert solo.engine.judge(early.header) is Verdict.DOUBLE


def test_a_nodes_digest_covers_its_parents_in_name_order() -> None:
    def digest(change: Callable[[bytes], bytes]) -> bytes:
        solo = Solo()
        solo.take(message(OBSERVATIONS), message(TASKS), message(CONTEXT, digest=change(DIGEST)))
        return solo.engine.digest

    assert digest(lambda given: given) == digest(bytes)
    assert digest(lambda given: given) != digest(lambda given: given[::-1])

    def of_two(first: bytes, second: bytes) -> bytes:
        solo = Solo(wiring(above=("top", "top2")))
        other = {"sender": "top2", "instance": INSTANCES["top2"]}
        contexts = [message(CONTEXT, digest=second, text="ctx 1", **other), message(CONTEXT, digest=first)]
        ((_, digest),) = results(solo.take(message(OBSERVATIONS), message(TASKS), message(TASKS, **other), *contexts))
        return digest

    assert of_two(DIGEST, DIGEST[::-1]) != of_two(DIGEST[::-1], DIGEST)


def test_the_chain_covers_the_last_digest_the_epoch_the_roster_and_the_worlds_digest() -> None:
    def chained(roster: bytes, *committed: tuple[int, bytes]) -> bytes:
        chain = DigestChain(roster)
        for epoch, digest in committed:
            assert chain.commit(epoch, digest) == chain.digest
            assert chain.epoch == epoch
        return chain.digest

    one, two, other = DIGEST, DIGEST[::-1], bytes(32)
    results = [
        chained(one, (1, one), (2, two)),
        chained(two, (1, one), (2, two)),
        chained(one, (1, two), (2, two)),
        chained(one, (1, one), (2, other)),
        chained(one, (1, one), (3, two)),
        chained(one, (2, two)),
    ]
    assert len(set(results)) == len(results)


def test_a_chain_goes_on_from_any_epoch_and_covers_no_attempt() -> None:
    whole = DigestChain(DIGEST)
    first = whole.commit(1, DIGEST)
    resumed = DigestChain(DIGEST, 1, first)
    assert whole.commit(2, DIGEST) == resumed.commit(2, DIGEST)


@pytest.mark.parametrize(("operator", "kinds"), [("observe", (OBSERVATIONS,)), ("predict", EPOCH)])
def test_after_an_operator_raised_its_inputs_are_not_taken_again(operator: str, kinds: tuple[str, ...]) -> None:
    calls = []
    works = getattr(MixingNode, operator)

    @wraps(works)
    def fails_once(*arguments: Any) -> Any:
        calls.append(operator)
        if len(calls) == 1:
            raise RuntimeError("out of luck")
        return works(*arguments)

    with patch.object(MixingNode, operator, fails_once):
        solo = Solo()
    with pytest.raises(OperatorError, match="out of luck"):
        solo.take(*(message(kind) for kind in kinds))
    solo.take(*(message(kind) for kind in kinds))
    assert calls == [operator]
    for kind in kinds:
        with pytest.raises(ContradictionError, match="somebody else speaks in the name"):
            solo.take(message(kind, text="another"))
    assert results(solo.epoch(attempt=1)) == results(Solo().epoch(attempt=1))


def test_the_table_that_is_told_is_the_one_that_is_executed() -> None:
    told: list[list[str]] = []
    lines = (table.__doc__ or "").partition("---------------  ---")[2].splitlines()[1:]
    for line in lines[: lines.index("")]:
        verdict, action = line[4:21].strip(), line[72:].strip()
        if verdict:
            told.append([verdict, action])
    assert told == [[row.verdict.name, row.action.name] for row in ROWS]


class ByTable(Engine):
    """Takes nothing in by the quick way."""

    def receive(self, message: Message) -> None:
        self._receive_by_table(message)


def _taken(solo: Solo, each: Message) -> str:
    """What an engine makes of a message; as text, as states have arrays in them."""
    try:
        return repr(solo.take(each))
    except ContradictionError as error:  # it was held until another attempt counted
        return str(error)


@settings(max_examples=150)
@given(seed=st.integers(0, 2**32))
def test_the_quick_way_is_the_tables(seed: int) -> None:
    """Any messages in any order: right ones, and such as differ from them in any field."""
    rng = Random(seed)
    quick, slow = (Solo(wiring(below=("low", "low2"), above=("top", "top2"))) for _ in range(2))
    slow.engine = ByTable(slow.engine.wiring, slow.recorder)
    for _ in range(60):
        make = rng.choice((message, second))
        epoch = quick.engine.epoch + rng.choice((0, 0, 0, 1, 1, 2, -1))
        change: dict[str, Any] = {"attempt": quick.engine.attempt + rng.choice((0, 0, 0, 0, 1, -1))}
        wrong = {"roster": ROSTER + rng.choice((-1, 1)), "instance": 3, "receiver": "top", "digest": b"", "sender": "x"}
        if rng.random() < 0.15:
            field = rng.choice(sorted(wrong))
            change[field] = wrong[field]
        if epoch < 0 or change["attempt"] < 0:
            continue
        each = make(rng.choice(EPOCH), epoch, **change, extensions={AFTER: quick.engine.attempt})
        taken = [_taken(solo, each) for solo in (quick, slow)]
        assert taken[0] == taken[1]
        assert quick.engine.waits_for == slow.engine.waits_for
