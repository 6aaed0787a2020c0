from __future__ import annotations

import pytest

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.meter import Meter, kind_of
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message

STEP = Step(1, 0, 0.0, (), None, (), (), "default", (), None)
DONE = Completed(STEP, b"", b"")


class Clock:
    """Nanoseconds that pass when it is told so."""

    def __init__(self) -> None:
        self.now = 1000

    def __call__(self) -> int:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def meter(clock: Clock) -> Meter:
    return Meter(clock)


def message(kind: str, sender: str) -> Message:
    return Message(Header(kind, sender, "mid", 1), ())


def called(operator: str) -> Called:
    return Called(1, 0, "mid", operator, None)


def epoch(meter: Meter, clock: Clock) -> None:
    """Two below, one above: 5 + 7 ns of waiting for them, 20 for the one above."""
    clock.now += 5
    meter.received(message(OBSERVATIONS, "left"))
    meter.served()
    clock.now += 7
    meter.received(message(OBSERVATIONS, "right"))
    clock.now += 100
    meter.called(called("observe"))
    clock.now += 10
    meter.called(called("sense"))
    clock.now += 3
    meter.sending(message(OBSERVATIONS, "mid"))
    meter.sent(message(OBSERVATIONS, "mid"))
    meter.served()
    clock.now += 20
    meter.received(message(CONTEXT, "top"))
    clock.now += 30
    meter.called(called("select_policy"))
    clock.now += 40
    meter.called(called("policy fast"))
    clock.now += 50
    meter.called(called("predict"))
    clock.now += 2
    meter.completed(DONE)
    clock.now += 1
    meter.served()


def test_times_go_to_operators_and_to_those_who_are_waited_for(meter: Meter, clock: Clock) -> None:
    epoch(meter, clock)
    read = meter.read(waits_for="left")
    assert read["work_ns"] == {"observe": 100, "policy": 70, "predict": 50, "edges": 10, "act": 0, "other": 6}
    # the first observations ended no wait: who came last was waited for
    assert read["waiting_ns"] == {"right": 12, "top": 20, "left": 0}
    assert (read["epochs"], read["ns"]) == (1, 100 + 70 + 50 + 10 + 6 + 32)
    assert read["epochs_ns"] == []


def test_all_time_is_accounted_for(meter: Meter, clock: Clock) -> None:
    for _ in range(5):
        epoch(meter, clock)
        read = meter.read(waits_for="left")
        assert sum(read["work_ns"].values()) + sum(read["waiting_ns"].values()) == read["ns"]
    assert read["epochs_ns"] == [268] * 4


def test_what_is_under_way_counts(meter: Meter, clock: Clock) -> None:
    clock.now += 9
    assert meter.read(waits_for="left")["waiting_ns"] == {"left": 9}
    meter.received(message(OBSERVATIONS, "left"))
    clock.now += 500
    assert meter.read(busy="observe")["work_ns"]["observe"] == 500
    meter.called(called("observe"))
    clock.now += 60
    assert meter.read(busy="policy slow")["work_ns"]["policy"] == 60
    assert meter.read()["work_ns"]["other"] == 60


def test_what_has_just_come_was_waited_for_although_nothing_followed_from_it_yet(meter: Meter, clock: Clock) -> None:
    clock.now += 9
    meter.received(message(OBSERVATIONS, "left"))
    assert meter.read()["waiting_ns"] == {"left": 9}


def test_a_turn_of_its_own_is_waited_for_by_nobodys_name(meter: Meter, clock: Clock) -> None:
    clock.now += 4
    meter.turned()
    clock.now += 6
    meter.called(called("observe"))
    meter.served()
    read = meter.read()
    assert (read["waiting_ns"], read["work_ns"]["observe"]) == ({"": 4}, 6)


@pytest.mark.parametrize(
    ("operator", "kind"),
    [("observe", "observe"), ("policy move 0.25", "policy"), ("context", "edges"), ("act", "act"), ("report", "other")],
)
def test_kinds_of_operators(operator: str, kind: str) -> None:
    assert kind_of(operator) == kind
