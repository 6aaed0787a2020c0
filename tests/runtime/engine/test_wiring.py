"""Versions of the roster: how a node is joined to its neighbours, and when it takes a version up."""

from __future__ import annotations

from typing import Any

import pytest
from support.engines import DIGEST, EPOCH, INSTANCES, ROSTER, Solo, message, wiring
from support.recording import Lacked, Output, Refused, Rewired, Sent, of, sent, steps, verdicts

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.hierarchy import BoundEdge, Edge
from hierax.runtime.engine.table import HELD_MESSAGES, Phase, Verdict
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message
from hierax.schemas.roster import Reference, Roster, RosterEdge

NEW = ROSTER + 1
NEWER = ROSTER + 2
LOW = INSTANCES["low"] + 100
"""The instance of `low` in the new versions."""


def new_wiring(roster: int = NEW, **change: Any) -> Wiring:
    return wiring(roster=roster, instances={**INSTANCES, "low": LOW}, **change)


def new(kind: str, epoch: int = 2, roster: int = NEW, **change: Any) -> Message:
    """A message of the new version, by default of the next epoch."""
    right = {"roster": roster, **({"instance": LOW} if kind == OBSERVATIONS else {})}
    return message(kind, epoch, **{**right, **change})


def done(prepared: tuple[int, ...] = (NEW,)) -> Solo:
    """A node that has finished epoch 1, with new versions at hand."""
    solo = Solo()
    solo.epoch()
    for roster in prepared:
        assert solo.prepare(new_wiring(roster)) == []
    return solo


def version(solo: Solo) -> int:
    return solo.engine.wiring.roster


# --- a wiring


def test_a_wiring_says_from_which_instance_what_is_awaited() -> None:
    functions = {"sense": tuple, "task": tuple, "context": tuple}
    pairs = {("a", "m"): functions, ("b", "m"): {}, ("m", "y"): functions, ("m", "z"): {}}
    edges = [BoundEdge.of(Edge(*pair, **kinds), OperatorSetting()) for pair, kinds in pairs.items()]
    node = BoundNode("m", wiring().node.node, ("a", "b"), ("y", "z"), OperatorSetting())
    place = Place(3, DIGEST, {"a": 5, "m": 6, "y": 8}, frozenset({("m", "y"), ("a", "m")}))
    wired = Wiring(node, edges, place)
    assert (wired.roster, wired.instance) == (3, 6)
    assert wired.below == {("a", OBSERVATIONS): 5, ("b", OBSERVATIONS): 0}
    assert wired.above == {("y", CONTEXT): 8, ("y", TASKS): 8, ("z", CONTEXT): 0}
    assert wired.tasking == ("y",)
    given = {
        "sense": [(name, call is not None) for name, call in wired.sense],
        "task": [(name, call is not None) for name, call in wired.task],
        "context": [(name, call is not None) for name, call in wired.context],
    }
    assert given == {
        "sense": [("y", True), ("z", False)],
        "task": [("a", True)],
        "context": [("a", True), ("b", False)],
    }


def test_a_place_is_that_of_its_roster() -> None:
    reference = Reference("package.module:name")
    edges = (RosterEdge("w", "a", task=reference), RosterEdge("w", "b", sense=reference))
    roster = Roster("w", dict.fromkeys("wab", reference), edges, 7, {"w": 2})
    place = Place.of(roster)
    assert place == Place(7, roster.content_hash(), {"w": 2}, frozenset({("w", "a")}))
    assert (place.instance("w"), place.instance("a")) == (2, 0)


# --- when a version is taken up


def test_a_message_of_a_version_that_is_not_here_is_held_until_it_is() -> None:
    solo = done(())
    assert solo.take(new(OBSERVATIONS)) == [Lacked(NEW)]
    assert (version(solo), solo.engine.epoch, solo.engine.prepared) == (ROSTER, 1, frozenset())
    outputs = solo.prepare(new_wiring())
    assert [type(output) for output in outputs] == [Rewired, Sent]
    assert outputs[0] == Rewired(NEW)
    (header,) = [each.header for each in sent(outputs)]
    assert (header.kind, header.epoch, header.roster) == (OBSERVATIONS, 2, NEW)
    assert (version(solo), solo.engine.epoch, solo.engine.phase) == (NEW, 2, Phase.PREDICT)


def test_each_version_that_is_not_here_is_named() -> None:
    solo = done(())
    assert solo.take(new(OBSERVATIONS)) == [Lacked(NEW)]
    assert solo.take(new(OBSERVATIONS, roster=NEWER)) == [Lacked(NEWER)]
    solo.prepare(new_wiring())
    assert solo.take(new(OBSERVATIONS, roster=NEWER, attempt=1)) == [Lacked(NEWER)]
    assert version(solo) == NEW


def test_all_that_is_held_for_a_version_is_taken_with_it() -> None:
    solo = done(())
    outputs = solo.take(*(new(kind) for kind in reversed(EPOCH)))
    assert outputs == [Lacked(NEW)] * 3
    (step,) = steps(solo.prepare(new_wiring()))
    assert (step.epoch, step.observations, step.tasks, step.context) == (2, ("obs 2",), ("task 2",), ("ctx 2",))


def test_a_version_is_not_taken_up_without_an_observation_message_of_it() -> None:
    solo = done()
    assert (version(solo), solo.engine.prepared) == (ROSTER, {NEW})
    assert solo.take(new(CONTEXT), new(TASKS)) == []
    assert [step.epoch for step in steps(solo.epoch(2))] == [2]
    assert version(solo) == ROSTER
    assert {each.header.roster for each in sent(solo.epoch(3))} == {ROSTER}


@pytest.mark.parametrize("change", [{"epoch": 2}, {"epoch": 2, "attempt": 3}, {"epoch": 1, "attempt": 1}])
def test_it_is_taken_up_with_the_next_epoch_or_a_later_attempt(change: dict[str, int]) -> None:
    solo = done()
    rewired, *outputs = solo.take(new(OBSERVATIONS, **change))
    assert rewired == Rewired(NEW)
    assert [each.header.roster for each in sent(outputs)] == [NEW]
    assert (solo.engine.epoch, solo.engine.attempt) == (change["epoch"], change.get("attempt", 0))
    assert solo.engine.prepared == frozenset()
    (step,) = steps(solo.take(new(TASKS, **change), new(CONTEXT, **change)))
    assert step.epoch == change["epoch"]


@pytest.mark.parametrize(
    "change",
    [{"epoch": 1}, {"epoch": 3}, {"epoch": 3, "attempt": 1}, {"epoch": 0, "attempt": 1}, {"epoch": 0}],
)
def test_nor_with_one_of_another_epoch(change: dict[str, int]) -> None:
    solo = done()
    assert solo.take(new(OBSERVATIONS, **change)) == []
    assert version(solo) == ROSTER
    assert [step.epoch for step in steps(solo.epoch(2))] == [2]


def test_before_the_first_epoch_no_attempt_is_a_later_one() -> None:
    solo = Solo()
    solo.prepare(new_wiring())
    assert solo.take(new(OBSERVATIONS, 0, attempt=1)) == []
    assert version(solo) == ROSTER


@pytest.mark.parametrize("came", range(1, len(EPOCH)))
def test_it_is_not_taken_up_in_the_middle_of_an_attempt(came: int) -> None:
    solo = done()
    solo.take(*(message(kind, 2) for kind in EPOCH[:came]))
    assert solo.take(new(OBSERVATIONS), new(OBSERVATIONS, 3), new(CONTEXT), new(TASKS)) == []
    assert (version(solo), solo.engine.epoch) == (ROSTER, 2)
    outputs = solo.take(*(message(kind, 2) for kind in EPOCH[came:]))
    assert [step.epoch for step in steps(outputs)] == [2]
    # done with it, the node goes on with what was held, and the new version with it
    assert [each.header[3:6:2] for each in sent(outputs)] == [(2, ROSTER), (3, NEW)]
    assert (version(solo), solo.engine.epoch) == (NEW, 3)


@pytest.mark.parametrize("came", range(1, len(EPOCH)))
def test_a_later_attempt_takes_it_up_and_ends_the_attempt_under_way(came: int) -> None:
    solo = done()
    start = solo.engine.state
    solo.take(*(message(kind, 2, text="old") for kind in EPOCH[:came]))
    outputs = solo.take(new(OBSERVATIONS, attempt=1))
    assert of(Rewired, outputs) == [Rewired(NEW)]
    assert solo.engine.start is solo.engine.state is start
    late = [message(kind, 2, text="old") for kind in EPOCH]
    assert verdicts(solo.take(*late)) == [Verdict.OLD_ROSTER] * len(EPOCH)
    (step,) = steps(solo.take(new(TASKS, attempt=1), new(CONTEXT, attempt=1)))
    assert (step.epoch, step.attempt, step.observations) == (2, 1, ("obs 2",))


def test_messages_of_the_older_version_are_refused_afterwards() -> None:
    solo = done()
    solo.take(new(OBSERVATIONS))
    for old in (*(message(kind, 2) for kind in EPOCH), message(OBSERVATIONS, 3), message(OBSERVATIONS, 2, attempt=9)):
        assert solo.take(old) == [Refused(old.header, Verdict.OLD_ROSTER)]
    assert (version(solo), solo.engine.epoch, solo.engine.attempt) == (NEW, 2, 0)


def test_it_is_the_messages_version_and_not_the_latest() -> None:
    solo = done((NEW, NEWER))
    solo.take(new(OBSERVATIONS))
    assert (version(solo), solo.engine.prepared) == (NEW, {NEWER})
    solo.take(new(TASKS), new(CONTEXT))
    solo.take(new(OBSERVATIONS, 3, NEWER))
    assert (version(solo), solo.engine.prepared) == (NEWER, frozenset())


def test_a_version_may_be_passed_over_and_is_then_an_older_one() -> None:
    solo = done((NEW, NEWER))
    held = new(OBSERVATIONS, 3)
    assert solo.take(held) == []
    outputs = solo.take(new(OBSERVATIONS, 2, NEWER))
    assert [type(output) for output in outputs] == [Rewired, Sent, Refused]
    assert outputs[-1] == Refused(held.header, Verdict.OLD_ROSTER)
    assert (version(solo), solo.engine.prepared) == (NEWER, frozenset())
    assert solo.prepare(new_wiring()) == []
    assert solo.engine.prepared == frozenset()


def test_a_version_that_is_in_force_is_not_prepared_again() -> None:
    solo = done(())
    solo.take(message(OBSERVATIONS, 2))
    assert solo.prepare(new_wiring(ROSTER, below=("low", "low2"))) == []
    assert solo.engine.prepared == frozenset()
    assert solo.engine.wiring.below == {("low", OBSERVATIONS): INSTANCES["low"]}


WRONG_UNDER_THE_NEW: list[dict[str, Any]] = [
    {"instance": INSTANCES["low"]},
    {"sender": "low2", "instance": INSTANCES["low2"]},
    {"sender": "top"},
    {"receiver": "top"},
]


@pytest.mark.parametrize("change", [{"epoch": 2}, {"epoch": 1, "attempt": 1}])
@pytest.mark.parametrize("wrong", WRONG_UNDER_THE_NEW)
def test_a_message_that_the_new_version_refuses_does_not_bring_it(
    change: dict[str, int], wrong: dict[str, Any]
) -> None:
    solo = done()
    assert of(Rewired, solo.take(new(OBSERVATIONS, **{**change, **wrong}))) == []
    assert version(solo) == ROSTER
    assert [step.epoch for step in steps(solo.epoch(2))] == [2]


def test_under_the_new_version_the_old_instance_is_refused() -> None:
    solo = done()
    solo.take(new(OBSERVATIONS))
    for change in ({"epoch": 2, "attempt": 1}, {"epoch": 3}):
        wrong = new(OBSERVATIONS, instance=INSTANCES["low"], **change)
        assert verdicts(solo.take(wrong)) == [Verdict.OTHER_INSTANCE]
    assert (solo.engine.epoch, solo.engine.attempt) == (2, 0)


def test_what_is_held_for_versions_has_a_bound_too() -> None:
    solo = done(())
    outputs: list[Output] = []
    for attempt in range(HELD_MESSAGES + 1):
        outputs += solo.take(new(OBSERVATIONS, attempt=attempt))
    assert outputs[:HELD_MESSAGES] == [Lacked(NEW)] * HELD_MESSAGES
    assert verdicts(outputs) == [Verdict.NEW_ROSTER]
    solo.prepare(new_wiring())
    assert solo.engine.attempt == HELD_MESSAGES - 1


# --- what it changes


def test_neighbours_come_and_go() -> None:
    solo = done(())
    solo.prepare(new_wiring(below=("low", "low2"), above=("top2",), mixing=True))
    assert solo.take(message(OBSERVATIONS, 2, sender="low2", roster=NEW)) == [Rewired(NEW)]
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    outputs = solo.take(new(OBSERVATIONS, text="first"))
    assert [each.header.receiver for each in sent(outputs)] == ["top2"]
    assert solo.engine.waits_for == (("top2", CONTEXT), ("top2", TASKS))
    assert verdicts(solo.take(new(CONTEXT))) == [Verdict.FOREIGN]
    outputs = solo.take(*(new(kind, sender="top2", instance=INSTANCES["top2"]) for kind in (TASKS, CONTEXT)))
    assert [step.observations for step in steps(outputs)] == [("first", "obs 2")]
    assert [each.header[:3] for each in sent(outputs)] == [
        (TASKS, "mid", "low"),
        (TASKS, "mid", "low2"),
        (CONTEXT, "mid", "low"),
        (CONTEXT, "mid", "low2"),
    ]


def test_operators_know_the_new_neighbours_and_the_state_stays() -> None:
    solo = done(())
    state = solo.engine.state
    wired = new_wiring(below=("low", "low2"), above=())
    solo.prepare(wired)
    solo.take(message(OBSERVATIONS, 2, sender="low2", roster=NEW))
    assert solo.engine.node is wired.node
    assert solo.engine.start is state
    (step,) = steps(solo.take(new(OBSERVATIONS)))
    assert (step.policy, step.tasks, step.context) == (state.policy, (), ())


def test_messages_say_the_version_and_instance_that_the_node_is_of() -> None:
    solo = done()
    headers = [each.header for each in sent(solo.epoch(2) + solo.take(*(new(kind, 3) for kind in EPOCH)))]
    assert [header.roster for header in headers] == [ROSTER, ROSTER, NEW, NEW]
    assert {header.instance for header in headers} == {INSTANCES["mid"]}


# --- the world


def world(above: str = "mid", roster: int = ROSTER) -> Wiring:
    return wiring("low", (), (above,), roster=roster)


def test_the_world_takes_a_version_up_before_it_begins_an_epoch() -> None:
    solo = Solo(world())
    assert solo.prepare(world("top", NEW)) == []
    solo.begin()
    down = Header(CONTEXT, "mid", "low", 1, 0, ROSTER, INSTANCES["mid"], 0.0, DIGEST)
    assert solo.engine.prepared == {NEW}
    assert steps(solo.take(Message(down, ())))
    solo.engine.rewire(NEW)
    assert solo.recorder.take() == [Rewired(NEW)]
    (header,) = [each.header for each in sent(solo.begin())]
    assert (header.receiver, header.epoch, header.roster) == ("top", 2, NEW)


def test_or_begins_one_again() -> None:
    solo = Solo(world())
    solo.prepare(world("top", NEW))
    solo.begin()
    solo.engine.rewire(NEW)
    solo.recorder.take()
    (header,) = [each.header for each in sent(solo.begin_again(1))]
    assert (header.receiver, header.epoch, header.attempt, header.roster) == ("top", 1, 1, NEW)
    old = Header(CONTEXT, "mid", "low", 1, 0, ROSTER, INSTANCES["mid"], 0.0, DIGEST)
    assert verdicts(solo.take(Message(old, ()))) == [Verdict.OLD_ROSTER]
    assert solo.engine.waits_for == (("top", CONTEXT),)


def test_no_message_makes_the_world_take_one_up() -> None:
    solo = Solo(world())
    solo.begin()
    solo.prepare(world("top", NEW))
    for change in ({"epoch": 1, "attempt": 1}, {"epoch": 2}):
        assert solo.take(message(CONTEXT, receiver="low", roster=NEW, **change)) == []
        assert verdicts(solo.take(message(OBSERVATIONS, sender="top", receiver="low", roster=NEW, **change))) == []
    assert version(solo) == ROSTER


def test_a_version_that_was_not_prepared_cannot_be_taken_up() -> None:
    solo = Solo(world())
    with pytest.raises(KeyError):
        solo.engine.rewire(NEW)
    assert version(solo) == ROSTER
