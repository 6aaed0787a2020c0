"""A node of a run that may change: what it takes over from the one that it replaces."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from support.hierarchies import MixingNode

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.digest import encode_state
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.port import MemoryNetwork
from hierax.schemas.control import Control, Fetch, Taken, TakeOver, Unchanged
from hierax.schemas.messages import OBSERVATIONS, Header, Message

NODE = MixingNode("n")
STATE = encode_state(NODE.initial_belief(), NODE.initial_policy, ())
TAKE_OVER = TakeOver(version=4, epoch=7, attempt=3, state=STATE)


@pytest.fixture
def slots(tmp_path: Path) -> Slots:
    return Slots(MappedFile(tmp_path / "checkpoint"))


def newcomer(slots: Slots, said: list[Control]) -> Member:
    """A member that is wired, and has had no part in an epoch."""
    wiring = Wiring(BoundNode("n", NODE, (), (), OperatorSetting()), (), Place())
    member = Member(
        Seat("n", "token", lambda _: wiring, MemoryNetwork().open_port("n")), said.append, Checkpoints(slots)
    )
    member.run(wiring, joins=True)
    return member


def runner_of(member: Member) -> NodeRunner:
    assert member.runner is not None
    return member.runner


def engine_of(member: Member) -> Engine:
    return runner_of(member).engine


def test_it_goes_on_from_the_attempt_that_counts(slots: Slots) -> None:
    said: list[Control] = []
    member = newcomer(slots, said)
    member.obey(TAKE_OVER)
    assert said == [Taken("n", 4, "")]
    assert (engine_of(member).epoch, engine_of(member).attempt) == (7, 3)
    found = Checkpoints(slots).read()
    assert found is not None
    checkpoint, _ = found
    assert (checkpoint.epoch, checkpoint.attempt, checkpoint.roster, checkpoint.instance) == (7, 3, 4, 4)
    assert checkpoint.start == checkpoint.now == STATE


def test_both_slots_hold_what_it_took_over(slots: Slots) -> None:
    """One that is damaged beside an empty one would count as never whole."""
    newcomer(slots, []).obey(TAKE_OVER)
    first, second = slots.read()
    assert first.data == second.data is not None


def test_what_an_older_version_handed_over_comes_too_late(slots: Slots) -> None:
    said: list[Control] = []
    member = newcomer(slots, said)
    member.obey(TAKE_OVER)
    member.obey(TakeOver(version=3, epoch=6, attempt=9, state=STATE))
    assert said == [Taken("n", 4, "")]
    assert (engine_of(member).epoch, engine_of(member).attempt) == (7, 3)


def test_what_is_no_state_is_refused_and_nothing_is_kept(slots: Slots) -> None:
    said: list[Control] = []
    member = newcomer(slots, said)
    member.obey(TakeOver(version=4, epoch=7, attempt=3, state=b"\xc1"))
    assert isinstance(said[0], Taken)
    assert said[0].refusal.startswith("cannot take over the belief: ")
    assert engine_of(member).epoch == 0
    assert Checkpoints(slots).read() is None


def test_a_version_that_changes_nothing_here_is_prepared_without_a_word(slots: Slots) -> None:
    said: list[Control] = []
    member = newcomer(slots, said)
    member.obey(Unchanged(1, 0))
    member.obey(Unchanged(2, 1))
    assert engine_of(member).prepared == {1, 2}
    first, second = engine_of(member).wiring_of(0), engine_of(member).wiring_of(2)
    assert first is not None
    assert second is not None
    assert (second.roster, second.place.roster, second.node) == (2, 2, first.node)
    assert said == []


def test_a_version_like_one_that_it_never_had_is_asked_for_when_a_message_of_it_comes(slots: Slots) -> None:
    said: list[Control] = []
    member = newcomer(slots, said)
    member.obey(Unchanged(5, 4))
    assert engine_of(member).prepared == frozenset()
    assert said == []
    runner_of(member).step(Message(Header(OBSERVATIONS, "other", "n", 1, roster=5), ()))
    assert said == [Fetch("n", "token", 5)]


def test_what_comes_before_its_roster_and_is_more_than_is_kept_is_told_once(
    slots: Slots, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a roster that is on its way: where its bearer is slow, epochs go on meanwhile."""
    member = newcomer(slots, [])
    with caplog.at_level(logging.INFO, "hierax"):
        for epoch in range(1, 40):
            runner_of(member).step(Message(Header(OBSERVATIONS, "other", "n", epoch, roster=5), ()))
    told = [(record.levelno, record.message) for record in caplog.records if "refused" in record.message]
    assert [level for level, _ in told] == [logging.INFO]
    assert told[0][1].endswith(": of a roster that is not here yet")
