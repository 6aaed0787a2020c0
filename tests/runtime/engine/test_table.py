"""Every row of the protocol's table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from support.hierarchies import MixingNode, MixingWorld

from hierax.runtime.core.binding import BoundNode, Setting
from hierax.runtime.core.hierarchy import BoundEdge, Edge
from hierax.runtime.engine.engine import DigestChain, Engine, Place
from hierax.runtime.engine.outputs import Committed, Completed, Output, Refused, Send
from hierax.runtime.engine.table import ACTIONS, HELD_MESSAGES, Action, Phase, Verdict
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message

DIGEST = bytes(range(32))
ROSTER = 4
INSTANCES = {"low": 7, "mid": 8, "top": 9}


def middle() -> Engine:
    """A node with one neighbour below, and one above that gives it tasks."""
    setting = Setting()
    node = BoundNode("mid", MixingNode("mid"), ("low",), ("top",), setting)
    pairs = [("low", "mid"), ("mid", "top")]
    edges = [BoundEdge.of(Edge(*pair), setting) for pair in pairs]
    return Engine(node, edges, Place(ROSTER, DIGEST, INSTANCES, frozenset(pairs)))


def world() -> Engine:
    setting = Setting()
    node = BoundNode("low", MixingWorld("low"), (), ("mid",), setting)
    return Engine(node, [BoundEdge.of(Edge("low", "mid"), setting)], Place(ROSTER, DIGEST, INSTANCES))


def message(kind: str, epoch: int = 1, **change: Any) -> Message:
    """A right message to the middle node."""
    sender = "low" if kind == OBSERVATIONS else "top"
    digest = DIGEST if kind == CONTEXT else b""
    header = Header(kind, sender, "mid", epoch, 0, ROSTER, INSTANCES[sender], 0.5, digest)
    return Message(header._replace(**change), (f"{kind} {epoch}",))


def take(engine: Engine, *messages: Message) -> list[Output]:
    return [output for each in messages for output in engine.receive(each)]


def steps(outputs: list[Output]) -> list[int]:
    return [output.step.epoch for output in outputs if isinstance(output, Completed)]


def verdicts(outputs: list[Output]) -> list[Verdict]:
    return [output.verdict for output in outputs if isinstance(output, Refused)]


EPOCH = (OBSERVATIONS, TASKS, CONTEXT)

REFUSED: list[tuple[Verdict, str, dict[str, Any]]] = [
    (Verdict.FOREIGN, OBSERVATIONS, {"receiver": "top"}),
    (Verdict.FOREIGN, OBSERVATIONS, {"sender": "stranger"}),
    (Verdict.FOREIGN, OBSERVATIONS, {"sender": "top"}),
    (Verdict.FOREIGN, TASKS, {"sender": "low"}),
    (Verdict.OLD_ROSTER, OBSERVATIONS, {"roster": ROSTER - 1}),
    (Verdict.OTHER_INSTANCE, OBSERVATIONS, {"instance": 6}),
    (Verdict.OTHER_INSTANCE, CONTEXT, {"instance": 10}),
    (Verdict.INCOMPLETE, CONTEXT, {"digest": b""}),
]


@pytest.mark.parametrize(("verdict", "kind", "change"), REFUSED)
def test_what_is_refused_is_reported_and_changes_nothing(verdict: Verdict, kind: str, change: dict[str, Any]) -> None:
    engine = middle()
    outputs = take(engine, message(kind, **change))
    assert verdicts(outputs) == [verdict]
    assert len(outputs) == 1
    assert engine.waits_for == (("low", OBSERVATIONS),)
    assert steps(take(engine, *map(message, EPOCH))) == [1]


def test_a_message_of_a_roster_to_come_is_held_and_not_taken() -> None:
    engine = middle()
    assert take(engine, message(OBSERVATIONS, roster=ROSTER + 1)) == []
    assert engine.waits_for == (("low", OBSERVATIONS),)
    assert steps(take(engine, *map(message, EPOCH))) == [1]
    # it is judged again whenever the epoch changes, and still is not for this roster
    assert engine.waits_for == (("low", OBSERVATIONS),)
    assert engine.judge(message(OBSERVATIONS, 2, roster=ROSTER + 1).header) is Verdict.NEW_ROSTER


@pytest.mark.parametrize("late", [{"epoch": 1}, {"epoch": 0}])
@pytest.mark.parametrize("kind", EPOCH)
def test_what_is_late_is_dropped(kind: str, late: dict[str, int]) -> None:
    engine = middle()
    take(engine, *map(message, EPOCH))
    assert engine.judge(message(kind, **late).header) is Verdict.LATE
    assert take(engine, message(kind, **late)) == []
    assert engine.waits_for == (("low", OBSERVATIONS),)


def test_a_later_attempt_is_early_and_an_earlier_one_late() -> None:
    engine = middle()
    assert engine.judge(message(OBSERVATIONS, attempt=1).header) is Verdict.EARLY
    engine.attempt = 2
    assert engine.judge(message(OBSERVATIONS, attempt=1).header) is Verdict.LATE


def test_the_next_epoch_begins_with_its_first_attempt() -> None:
    engine = middle()
    engine.attempt = 2
    assert steps(take(engine, *(message(kind, attempt=2) for kind in EPOCH))) == [1]
    assert steps(take(engine, *(message(kind, 2) for kind in EPOCH))) == [2]


@pytest.mark.parametrize("order", [(TASKS, CONTEXT), (CONTEXT, TASKS)])
def test_what_is_early_is_held_until_its_half_or_epoch(order: tuple[str, str]) -> None:
    engine = middle()
    early = [message(kind, 2) for kind in (OBSERVATIONS, *order)]
    assert take(engine, *early, *(message(kind) for kind in order)) == []
    outputs = take(engine, message(OBSERVATIONS))
    completed = [output.step for output in outputs if isinstance(output, Completed)]
    assert [(step.epoch, step.observations, step.tasks, step.context) for step in completed] == [
        (epoch, (f"obs {epoch}",), (f"task {epoch}",), (f"ctx {epoch}",)) for epoch in (1, 2)
    ]


def test_so_many_are_held_and_no_more_of_each_sender_and_kind() -> None:
    engine = middle()
    assert take(engine, *(message(OBSERVATIONS, 2 + n) for n in range(HELD_MESSAGES))) == []
    assert verdicts(take(engine, message(OBSERVATIONS, 2 + HELD_MESSAGES))) == [Verdict.EARLY]
    assert take(engine, message(CONTEXT, 2)) == []
    assert steps(take(engine, *map(message, EPOCH))) == [1]
    assert engine.epoch == 2
    assert engine.waits_for == (("top", TASKS),)


@pytest.mark.parametrize("kind", EPOCH)
def test_a_double_is_dropped_and_the_first_one_counts(kind: str) -> None:
    engine = middle()
    outputs: list[Output] = []
    for each in EPOCH:
        outputs += take(engine, message(each))
        if each == kind:
            again = message(each)._replace(payload=("again",))
            assert engine.judge(again.header) in (Verdict.DOUBLE, Verdict.LATE)
            assert take(engine, again) == []
    (step,) = [output.step for output in outputs if isinstance(output, Completed)]
    assert (step.observations, step.tasks, step.context) == (("obs 1",), ("task 1",), ("ctx 1",))


def test_a_double_of_one_of_two_that_are_waited_for_is_dropped() -> None:
    engine = middle()
    take(engine, message(OBSERVATIONS), message(TASKS))
    assert engine.judge(message(TASKS).header) is Verdict.DOUBLE
    assert engine.judge(message(OBSERVATIONS).header) is Verdict.DOUBLE
    assert take(engine, message(TASKS)._replace(payload=("again",))) == []
    (step,) = [output.step for output in take(engine, message(CONTEXT)) if isinstance(output, Completed)]
    assert step.tasks == ("task 1",)


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({"receiver": "top", "roster": ROSTER - 1}, Verdict.FOREIGN),
        ({"roster": ROSTER - 1, "instance": 0}, Verdict.OLD_ROSTER),
        ({"roster": ROSTER + 1, "instance": 0}, Verdict.NEW_ROSTER),
        ({"instance": 0, "digest": b""}, Verdict.OTHER_INSTANCE),
        ({"digest": b"", "epoch": 0}, Verdict.INCOMPLETE),
        ({"epoch": 0, "attempt": 9}, Verdict.LATE),
        ({"epoch": 2}, Verdict.EARLY),
    ],
)
def test_the_first_row_that_fits_decides(change: dict[str, Any], verdict: Verdict) -> None:
    assert middle().judge(message(CONTEXT, **change).header) is verdict


def test_every_verdict_has_its_action() -> None:
    assert set(ACTIONS) == set(Verdict)
    assert {verdict for verdict, action in ACTIONS.items() if action is Action.TAKE} == {Verdict.CURRENT}


def test_what_is_sent_says_who_when_and_of_which_roster() -> None:
    engine = middle()
    sent = [
        output.message.header
        for epoch in (1, 2)
        for output in take(engine, *(message(kind, epoch, time_s=epoch / 4) for kind in EPOCH))
        if isinstance(output, Send)
    ]
    expected = []
    for epoch in (1, 2):
        place = (epoch, 0, ROSTER, INSTANCES["mid"], epoch / 4)
        expected += [(OBSERVATIONS, "mid", "top", *place), (CONTEXT, "mid", "low", *place)]
    assert [header[:8] for header in sent] == expected
    assert [bool(header.digest) for header in sent] == [False, True, False, True]


def test_only_an_idle_world_begins() -> None:
    engine = world()
    assert engine.phase is Phase.IDLE
    outputs = list(engine.begin())
    assert [type(output) for output in outputs] == [Send]
    assert engine.phase is Phase.PREDICT
    for wrong in (engine, middle()):
        with pytest.raises(ValueError, match="only a world that is idle"):
            wrong.begin()


def test_a_message_for_a_world_that_is_idle_waits_for_the_epoch() -> None:
    engine = world()
    header = Header(CONTEXT, "mid", "low", 1, 0, ROSTER, INSTANCES["mid"], 0.0, DIGEST)
    assert engine.judge(header) is Verdict.EARLY
    outputs = [*take(engine, Message(header, ())), *engine.begin()]
    assert [type(output) for output in outputs] == [Send, Completed, Committed]
    assert engine.judge(header) is Verdict.DOUBLE


def test_a_nodes_digest_covers_its_parents_in_name_order() -> None:
    def digest(change: Callable[[bytes], bytes]) -> bytes:
        engine = middle()
        take(engine, message(OBSERVATIONS), message(TASKS), message(CONTEXT, digest=change(DIGEST)))
        return engine.digest

    assert digest(lambda given: given) == digest(bytes)
    assert digest(lambda given: given) != digest(lambda given: given[::-1])


def test_the_chain_covers_the_last_digest_the_epoch_the_roster_and_the_worlds_digest() -> None:
    def chained(roster: bytes, *committed: tuple[int, bytes]) -> bytes:
        chain = DigestChain(roster)
        for epoch, digest in committed:
            assert chain.commit(Committed(epoch, 0, digest)) == chain.digest
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
