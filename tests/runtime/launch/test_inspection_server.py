"""A node's answers at its window: who looks is answered, and what nobody asks for any more ends."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import pytest
from support.engines import wiring

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.engine import Engine
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.launch import inspection_server as desks
from hierax.runtime.launch.inspection_server import LEASE_S, InspectionServer
from hierax.runtime.transport.control import InspectionEndpoint
from hierax.runtime.transport.node_answers import is_answer
from hierax.runtime.transport.port import MemoryNetwork
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import decode_value, encode_value


class FakeWindow:
    """Questions come as they are put, and answers are kept."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.answers: list[Any] = []
        self.shown: list[tuple[str, str, str]] = []

    def questions(self) -> Iterator[tuple[Any, Any]]:
        while self.asked:
            yield self.asked.pop(0), self.answers.append

    def show(self, kind: str, sender: str, receiver: str, data: bytes) -> None:
        self.shown.append((kind, sender, receiver))


class Room:
    """A desk, its window, and the time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.busy = ""
        monkeypatch.setattr(desks.time, "monotonic", lambda: self.now)
        self.window = FakeWindow()
        self.observers = Observers("mid")
        self.roster: Roster | None = None
        window = cast(InspectionEndpoint, self.window)
        seen = ("mid", "token", self.observers, lambda: self.roster)
        self.inspection = InspectionServer(*seen, window, lambda: self.busy)

    def ask(self, look: str, **fields: Any) -> Any:
        self.window.asked.append({"look": look, **fields})
        self.inspection.serve()
        answer = self.window.answers.pop()
        heard = decode_value(encode_value(answer))
        assert "process" not in answer or is_answer(look, heard), answer
        return answer


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> Room:
    room = Room(monkeypatch)
    NodeRunner(wiring(), MemoryNetwork().open_port("mid"), room.observers)
    return room


def engine_of(room: Room) -> Engine:
    assert room.observers.engine is not None
    return room.observers.engine


def test_a_meter_runs_while_somebody_asks(room: Room) -> None:
    assert room.observers.watchers == ()
    assert not engine_of(room).events
    first = room.ask("meter")
    assert (first["process"], first["meter"]["epochs"]) == ("token", 0)
    assert engine_of(room).events
    for _ in range(3):
        room.now += LEASE_S - 1
        assert room.ask("meter")["meter"]["ns"] >= first["meter"]["ns"]
    room.now += LEASE_S + 1
    room.inspection.serve()
    assert room.observers.watchers == ()
    assert not engine_of(room).events


def test_copies_are_shown_while_somebody_wants_them(room: Room) -> None:
    mine, others = ["obs", "mid", "top"], ["obs", "low", "mid"]
    assert room.ask("echo", edges=[mine, others])["lease_s"] == LEASE_S
    (copier,) = room.observers.watchers
    room.now += LEASE_S - 1
    room.ask("echo", edges=[["ctx", "mid", "low"]])
    assert cast(Any, copier).wanted == {("obs", "mid", "top"), ("ctx", "mid", "low")}
    room.now += 2
    room.inspection.serve()
    assert cast(Any, copier).wanted == {("ctx", "mid", "low")}
    room.now += LEASE_S
    room.inspection.serve()
    assert room.observers.watchers == ()


def test_steps_are_shown_while_somebody_wants_them(room: Room) -> None:
    assert room.ask("steps", every=2) == {"process": "token", "lease_s": LEASE_S, "roster": None}
    (stepper,) = cast(Any, room.observers.watchers)
    assert stepper.every == 2
    for epoch in (1, 2):
        stepper.completed(Completed(Step(epoch, 0, 0.0, (), 1.0, (), (), "default", (), 1.0), b"", b""))
    room.now += LEASE_S - 1
    room.ask("steps", every=1)
    assert room.window.shown == [("step", "mid", "mid")]
    room.now += LEASE_S + 1
    room.inspection.serve()
    assert room.observers.watchers == ()


def test_the_belief_that_the_last_epoch_began_in_is_known_where_the_one_before_was_seen(room: Room) -> None:
    for epoch, before in ((3, None), (4, 3.0), (6, None), (6, None)):
        belief = float(epoch)
        step = Step(epoch, 0, 0.0, (), belief, (), (), "default", (), belief)
        room.observers.completed([Completed(step, b"", b"")])
        assert room.ask("state")["before"] == before


def test_the_worlds_steps_come_with_the_roster(room: Room) -> None:
    roster = Roster("mid", {"mid": Reference("a:B", {})}, ())
    room.roster = roster
    assert Roster.read(room.ask("steps", every=1)["roster"]) == roster


def test_what_a_node_is_busy_with_and_waits_for(room: Room) -> None:
    room.busy = "observe of mid"
    answer = room.ask("meter")
    assert (answer["busy"], answer["waits_for"]) == ("observe of mid", [])
    assert answer["meter"]["work_ns"]["observe"] >= 0
    assert answer["rss_bytes"] > 1 << 20
    assert answer["cpu_s"] > 0


def test_the_state_before_the_first_epoch(room: Room) -> None:
    answer = room.ask("state")
    assert (answer["epoch"], answer["committed"], answer["below"], answer["above"]) == (0, True, ["low"], ["top"])
    assert answer["belief"] == engine_of(room).state.belief
    assert room.ask("neighbours") == {"process": "token", "below": ["low"], "above": ["top"]}


def test_a_process_that_is_still_coming(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room(monkeypatch)
    assert "still coming" in room.ask("state")["refusal"]
    assert room.ask("neighbours")["below"] == []
    assert room.ask("meter")["epoch"] == 0


@pytest.mark.parametrize(
    "question",
    [
        None,
        "meter",
        {},
        {"look": "away"},
        {"look": "echo"},
        {"look": "echo", "edges": [1]},
        {"look": "steps", "every": 0},
    ],
)
def test_what_is_no_question_is_refused(room: Room, question: Any) -> None:
    room.window.asked.append(question)
    room.inspection.serve()
    assert "refusal" in room.window.answers.pop()
