"""The owner by itself: what it tells whom, and when; refusals, doubles and what comes late."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hierax.runtime.owner.arrivals import MAX_REPEATS
from hierax.runtime.owner.effects import DETACH, OwnerEffects, OwnerPolicy
from hierax.runtime.owner.members import REMEMBERED
from hierax.runtime.owner.owner import FETCH_S, MAX_TRIES, OVER, Owner
from hierax.runtime.owner.planning import MAX_DROPPED
from hierax.schemas.control import (
    NEVER,
    AskStatus,
    CatchUp,
    CaughtUp,
    Control,
    Dismiss,
    Failed,
    Fetch,
    HandOver,
    Join,
    Lost,
    Order,
    Prepare,
    Propose,
    Ready,
    Resend,
    State,
    Status,
    Taken,
    TakeOver,
    Unchanged,
)
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge

NODE = Reference("toys:Node", {})
OTHER = Reference("toys:Other", {})
CHAIN = Roster(
    "world", {"world": NODE, "low": NODE, "high": NODE}, (RosterEdge("world", "low"), RosterEdge("low", "high"))
)
SETTINGS = OwnerPolicy(modules=("toys",), epoch_deadline_s=1.0, start_timeout_s=3.0, answer_timeout_s=2.0)


class Owned(OwnerEffects):
    """An owner and all that it calls, in order.

    Args:
        settings: of the owner.
        options: of the owner.
    """

    def __init__(self, settings: OwnerPolicy = SETTINGS, **options: Any) -> None:
        self.now = 0.0
        self.calls: list[tuple[Any, ...]] = []
        processes = options.pop("processes", {name: f"{name}.1" for name in CHAIN.nodes})
        self.owner = Owner(options.pop("roster", CHAIN), processes, self, lambda: self.now, settings, **options)

    def send_order(self, process: str, order: Order) -> None:
        self.calls.append((process, order))

    def write_record(self) -> None:
        self.calls.append(("keep", self.owner.planning.highest))

    def begin(self, epoch: int, attempt: int, version: int) -> None:
        self.calls.append(("begin", epoch, attempt, version))

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        self.calls.append(("answer", request, epoch, refusal))

    def end(self, name: str, process: str, why: str) -> None:
        self.calls.append(("end", process, why))

    def stop(self, why: str) -> None:
        self.calls.append(("stop", why))

    def note(self, what: str) -> None:
        self.calls.append(("note", what))

    def hear(self, *words: Control) -> list[tuple[Any, ...]]:
        """What it calls when these come."""
        for word in words:
            self.owner.hear(word)
        return self.take()

    def take(self) -> list[tuple[Any, ...]]:
        """What it has called since the last time, notes apart."""
        calls, self.calls = self.calls, []
        return [call for call in calls if call[0] != "note"]

    def proceed(self) -> list[tuple[Any, ...]]:
        """What it calls when an epoch may begin."""
        self.owner.proceed()
        return self.take()

    def commit(self) -> list[tuple[Any, ...]]:
        """What it calls when the epoch is committed."""
        self.owner.committed(self.owner.progress.epoch + 1)
        return self.proceed()

    def wait(self, seconds: float) -> list[tuple[Any, ...]]:
        """What it calls when time has passed."""
        self.now += seconds
        self.owner.tick()
        return self.take()

    def ready(self, version: int, *processes: str) -> list[tuple[Any, ...]]:
        """What it calls when these say that they are ready."""
        return self.hear(*(Ready(process.partition(".")[0], process, version, "") for process in processes))


def propose(change: Change, key: str = "c1") -> Propose:
    plain: Any = change.plain()
    return Propose(key, plain)


def join(process: str, epoch: int = NEVER, request: str = "", **fields: Any) -> Join:
    return Join(process.partition(".")[0], process, request, epoch, False, "")._replace(**fields)


def begun(**options: Any) -> Owned:
    """One in its first epoch."""
    owned = Owned(**options)
    assert owned.proceed() == [("begin", 1, 0, 0)]
    return owned


def prepares(calls: list[tuple[Any, ...]]) -> list[str]:
    """Who is told to get ready."""
    return [who for who, order, *_ in calls if isinstance(order, Prepare)]


TOP = Attach({"top": NODE}, (RosterEdge("high", "top"),))


def test_an_attach_takes_both_phases() -> None:
    owned = begun()
    assert owned.hear(propose(TOP)) == []
    calls = owned.hear(join("top.1", request="c1"))
    assert calls[0] == ("keep", 1), "nobody hears of a version before its number is recorded"
    assert sorted(prepares(calls)) == ["high.1", "top.1", "world.1"]
    assert ("low.1", Unchanged(1, 0)) in calls, "it has nothing to load, and no answer to give"
    assert owned.ready(1, "high.1", "world.1") == []
    assert owned.commit() == [("begin", 2, 0, 0)], "it waits for the newcomer, and the epochs do not"
    assert owned.ready(1, "top.1") == [], "it takes effect between two epochs"
    assert owned.commit() == [("begin", 3, 0, 1)]
    assert owned.commit() == [("begin", 4, 0, 1), ("answer", "c1", 3, "")], "told when its first epoch is committed"


def test_those_that_are_not_touched_are_told_but_not_waited_for() -> None:
    owned = begun()
    owned.hear(propose(TOP))
    owned.hear(join("top.1", request="c1"))
    owned.ready(1, "high.1", "top.1", "world.1")  # low is silent
    assert owned.commit() == [("begin", 2, 0, 1)]


def test_a_change_that_is_asked_for_twice_is_made_once() -> None:
    owned = begun()
    owned.hear(propose(Detach("high")), propose(Detach("high")))
    owned.ready(1, "low.1", "world.1")
    assert owned.hear(propose(Detach("high"))) == []
    owned.commit()
    assert ("answer", "c1", 2, "") in owned.commit()
    assert owned.hear(propose(Detach("high"))) == [("answer", "c1", 2, "")]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (Attach({"top": Reference("evil:Node", {})}, (RosterEdge("high", "top"),)), "may not be loaded in this run"),
        (Detach("low"), "only it joins 'high' to the world"),
        (Detach("hgih"), "did you mean 'high'"),
        (Replace("world", NODE), "it is the world"),
        (Attach({"top": NODE}), "cannot attach 'top'"),
    ],
)
def test_what_cannot_be_done_is_refused_at_once(change: Change, why: str) -> None:
    owned = begun()
    ((kind, request, epoch, refusal),) = owned.hear(propose(change))
    assert (kind, request, epoch) == ("answer", "c1", 0)
    assert why in refusal


def test_what_is_no_change_is_refused() -> None:
    ((_, _, _, refusal),) = begun().hear(Propose("c1", {"change": "explode"}))
    assert "expected attach, detach or replace" in refusal


def test_a_newcomer_that_does_not_come_or_cannot() -> None:
    owned = begun()
    owned.hear(propose(TOP))
    assert owned.wait(2.9)[0][1] == AskStatus(1)
    assert ("answer", "c1", 0, "no process for top came up in time (start_timeout_s)") in owned.wait(0.2)
    owned.hear(propose(TOP, "c2"))
    assert owned.hear(join("top.1", request="c2", refusal="no such module")) == [("answer", "c2", 0, "no such module")]
    owned.hear(propose(TOP, "c3"), join("top.2", request="c3"))
    calls = owned.hear(Ready("top", "top.2", 1, "no camera"))
    assert ("answer", "c3", 0, "top: no camera") in calls
    assert ("top.2", Dismiss("top: no camera")) in calls
    assert owned.hear(join("top.3", request="c3")) == [("top.3", Dismiss("top: nobody asks for it (any more)"))]


def test_who_is_here_before_the_change_that_it_was_started_for_may_offer_itself_again() -> None:
    """The one comes over Zenoh and the other by a pipe, which is read by another thread."""
    owned = begun()
    assert owned.hear(join("top.1", request="c1")) == []
    owned.hear(propose(TOP))
    assert "top.1" in prepares(owned.hear(join("top.1", request="c1")))
    owned.ready(1, "high.1", "world.1", "top.1")
    owned.commit()
    assert owned.hear(join("top.2", request="c1")) == [("top.2", Dismiss("top: nobody asks for it (any more)"))]


def test_who_says_nothing_is_named() -> None:
    owned = begun(settings=SETTINGS_PATIENT)
    owned.hear(propose(TOP), join("top.1", request="c1"))
    owned.ready(1, "high.1", "world.1")
    assert [who for who, *_ in owned.wait(1.5)] == ["top.1"], "it is told again"
    owned.hear(join("high.1", active=True))
    assert ("answer", "c1", 0, "no answer from top within 2 s") in owned.wait(1.0)


SETTINGS_PATIENT = OwnerPolicy(modules=("toys",), answer_timeout_s=2.0)


def test_a_dropped_version_is_not_used_again() -> None:
    owned = begun()
    owned.hear(propose(TOP), join("top.1", request="c1"))
    owned.hear(Ready("top", "top.1", 1, "no"))
    calls = owned.hear(propose(Detach("high"), "c2"))
    assert calls[0] == ("keep", 2)


def dropped(owned: Owned, count: int) -> list[tuple[Any, ...]]:
    """What it calls when so many changes were prepared, one after the other, and refused."""
    calls: list[tuple[Any, ...]] = []
    for _ in range(count):
        number = owned.owner.planning.highest + 1
        owned.hear(propose(TOP, f"c{number}"), join(f"top.{number}", request=f"c{number}"))
        calls = owned.hear(Ready("top", f"top.{number}", number, "no"))
    return calls


def test_after_many_dropped_versions_the_roster_in_force_has_a_new_number() -> None:
    owned, last = begun(), MAX_DROPPED + 1
    before = owned.owner.members.roster
    calls = dropped(owned, MAX_DROPPED)
    assert ("keep", last) in calls
    assert prepares(calls) == ["world.1"], "nobody has anything to load"
    assert ("high.1", Unchanged(last, 0)) in calls
    owned.hear(propose(Detach("high"), "other"))
    owned.ready(last, "world.1")
    calls = owned.commit()
    assert calls[0] == ("begin", 2, 0, last)
    assert ("keep", last + 1) in calls, "what was asked for meanwhile is prepared then"
    assert owned.owner.members.roster == replace(before, version=last)


def test_nobody_is_killed_for_a_new_number_that_is_long_in_coming() -> None:
    owned = begun()
    dropped(owned, MAX_DROPPED)
    assert [call for call in owned.wait(SETTINGS.answer_timeout_s + 0.1) if call[0] == "end"] == []
    assert prepares(owned.wait(0.2)) == ["world.1"]


def test_a_node_that_is_lost_comes_back_before_there_is_a_new_number() -> None:
    owned = begun()
    dropped(owned, MAX_DROPPED)
    owned.hear(Lost("high", "high.1", True))
    assert owned.owner.planning.plan is None
    assert sorted(prepares(owned.hear(join("high.2", 0)))) == ["high.2", "low.1", "world.1"]
    last = MAX_DROPPED + 2
    assert owned.ready(last, "high.2", "low.1", "world.1")[0] == ("begin", 1, 1, last)
    assert owned.owner.planning.plan is None


def replaced(owned: Owned | None = None) -> Owned:
    """One that waits for the state of the node that is replaced; it is in its first epoch before that."""
    owned = owned or begun()
    owned.hear(propose(Replace("high", OTHER)), join("high.2", request="c1"))
    owned.ready(1, "high.2", "low.1", "world.1")
    assert owned.commit() == [("high.1", HandOver(1, 1, 0)), ("keep", 1)]
    return owned


def test_a_replace_hands_the_state_over() -> None:
    owned = replaced()
    assert owned.hear(State("high", 1, b"state")) == [("high.2", TakeOver(1, 1, 0, b"state"))]
    assert owned.hear(State("high", 1, b"state")) == [], "one that is said twice counts once"
    assert owned.hear(Taken("low", 1, "who asks?"), Taken("stranger", 1, "")) == []
    assert owned.hear(Taken("high", 1, "")) == [("begin", 2, 0, 1)]
    assert owned.hear(join("high.1", 1, active=True)) == [], "it waits until what replaces it has done an epoch"
    begins, dismisses, answers = owned.commit()
    assert begins == ("begin", 3, 0, 1)
    assert dismisses == ("high.1", Dismiss("high: another process runs it from epoch 2 on"))
    assert answers == ("answer", "c1", 2, "")


def fails(owned: Owned) -> list[tuple[Any, ...]]:
    """What the owner calls when what replaces a node has failed in its first epoch."""
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""))
    return owned.hear(Failed("low", "low.1", 1, "low->high", "low->high: sense in epoch 2: out of luck"))


def test_what_fails_in_the_place_of_another_is_undone() -> None:
    owned = replaced()
    calls = fails(owned)
    assert sorted(prepares(calls)) == ["high.1", "low.1", "world.1"], "the process that was replaced is there still"
    (order,) = [order for who, order, *_ in calls if who == "high.1"]
    assert Roster.read(order.roster).instances.get("high", 0) == 0
    assert (order.alone, order.tried) == ((), ())
    assert fails(owned) == [], "said twice"
    answers, begins, dismisses = owned.ready(2, "high.1", "low.1", "world.1")
    why = "low->high: sense in epoch 2: out of luck; what it was to replace goes on"
    assert answers == ("answer", "c1", 0, why)
    assert begins == ("begin", 2, 1, 2)
    assert dismisses[0] == "high.2"
    assert owned.owner.members.roster.content_hash() == CHAIN.content_hash()
    assert owned.owner.members.born["high"] == (0, 1, "")
    assert owned.commit() == [("begin", 3, 0, 2)]


def test_who_is_told_of_a_trial() -> None:
    owned = begun()
    owned.hear(propose(Replace("high", OTHER)))
    calls = owned.hear(join("high.2", request="c1"))
    assert {order.tried for _, order in calls[1:]} == {("high",)}
    owned.ready(1, "high.2", "low.1", "world.1")
    owned.commit()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""))
    owned.hear(Lost("low", "low.1", True))
    calls = owned.hear(join("low.2", 1, version=0))
    assert {order.tried for _, order in calls[1:]} == {("high",)}, "its first epoch is begun again"
    owned.ready(2, "high.2", "low.2", "world.1")
    assert {order.tried for _, order in owned.hear(propose(Detach("high"), "c2"))[1:]} == {()}


@pytest.mark.parametrize("is_back", ["before", "after"])
def test_where_what_was_replaced_has_died_its_next_process_goes_on(is_back: str) -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.1", True))
    back = join("high.3", 1, version=0)
    if is_back == "before":
        assert owned.hear(back) == []
        calls = fails(owned)
    else:
        assert fails(owned) == owned.hear(propose(Detach("high"), "c2")) == []
        calls = owned.hear(back)
    assert sorted(prepares(calls)) == ["high.3", "low.1", "world.1"]
    assert {order.alone for _, order in calls[1:]} == {()}
    calls = owned.ready(2, "high.3", "low.1", "world.1")
    assert ("begin", 2, 1, 2) in calls
    assert ("answer", "c1", 0, "low->high: sense in epoch 2: out of luck; what it was to replace goes on") in calls
    assert ("high.2", Dismiss("high: another process runs it from epoch 2 on")) in calls
    assert owned.owner.members.roster.content_hash() == CHAIN.content_hash()
    assert owned.owner.members.roster.instance("high") == 2


@pytest.mark.parametrize("active", [False, True])
def test_what_was_replaced_and_was_cut_off_is_to_come_again(active: bool) -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.1", True))
    ((process, word),) = owned.hear(join("high.1", 1, active=active))
    assert process == "high.1"
    assert isinstance(word, Dismiss)
    assert word.again


def test_what_was_replaced_and_has_died_again_is_waited_for() -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.1", True))
    owned.hear(join("high.3", 1, version=0))
    assert fails(owned)
    assert owned.hear(Lost("high", "high.3", True)) == []
    assert sorted(prepares(owned.hear(join("high.4", 1, version=0)))) == ["high.4", "low.1", "world.1"]


@pytest.mark.parametrize(
    ("word", "why"),
    [
        (Lost("high", "high.1", False), "its process is lost and is not started again"),
        (join("high.3", 0, version=0), "its checkpoint is of epoch 0, and the hierarchy is in epoch 2"),
        (join("high.3", 1, version=0, refusal="no camera"), "no camera"),
    ],
)
def test_where_what_was_replaced_cannot_come_back_the_run_ends(word: Control, why: str) -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.1", True))
    owned.hear(word)
    failed = "low->high: sense in epoch 2: out of luck"
    assert fails(owned) == [("stop", f"{failed}; and what high has replaced cannot go on: {why}")]


def test_a_process_of_what_was_replaced_for_good_is_sent_away() -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.1", True))
    owned.hear(join("high.3", 1, version=0))
    assert ("high.3", Dismiss("high: another process runs it from epoch 2 on")) in owned.commit()
    calls = owned.hear(join("high.4", 1, version=0))
    assert calls == [("high.4", Dismiss("high: another node has taken its place"))]


def test_an_owner_that_is_new_knows_what_is_tried() -> None:
    roster = Roster(CHAIN.world, {**CHAIN.nodes, "high": OTHER}, CHAIN.edges, 1, {"high": 1})
    processes = {"low": "low.1", "high": "high.2"}
    tried = ("high", CHAIN, "high.1", (0, 1, ""), False)
    born = {"high": (1, 2, "c1")}
    owned = Owned(roster=roster, processes=processes, epoch=1, attempt=0, highest=1, born=born, tried=tried)
    owned.owner.take_back("world.2")
    owned.ready(2, "low.1", "world.2")
    calls = owned.hear(Failed("high", "high.2", 2, "high", "high: out of luck"))
    assert sorted(prepares(calls)) == ["high.1", "low.1", "world.2"]
    calls = owned.ready(3, "high.1", "low.1", "world.2")
    assert ("answer", "c1", 0, "high: out of luck; what it was to replace goes on") in calls
    assert owned.owner.members.roster.content_hash() == CHAIN.content_hash()


def test_what_is_to_be_undone_goes_with_the_node_that_it_stands_on() -> None:
    owned = Owned(OwnerPolicy(modules=("toys",), on_loss={"low": DETACH}))
    owned.proceed()
    owned = replaced(owned)
    assert fails(owned)
    calls = owned.hear(Lost("low", "low.1", False))
    assert prepares(calls) == ["world.1"]
    calls = owned.ready(3, "world.1")
    assert calls[0] == ("begin", 2, 1, 3)
    assert {who for who, order in calls[1:] if isinstance(order, Dismiss)} == {"high.2", "low.1"}
    assert owned.owner.members.roster.nodes.keys() == {"world"}
    calls = owned.commit()
    assert ("high.1", Dismiss("high: it is detached")) in calls
    why = "low->high: sense in epoch 2: out of luck; high: detached again before the first epoch was committed"
    assert calls[-1] == ("answer", "c1", 0, why)


def test_where_what_was_replaced_is_further_than_a_damaged_record_the_run_ends() -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"), Taken("high", 1, ""), Lost("high", "high.2", True))
    ((_, question),) = owned.hear(join("high.1", 2, active=True, version=2, attempt=1))
    assert isinstance(question, AskStatus)
    ((kind, why),) = owned.hear(Status("high", question.inquiry, 2, 1, (), "", 2))
    assert kind == "stop"
    assert "the world's record was damaged" in why


@pytest.mark.parametrize("when", ["before", "after"])
def test_two_states_that_differ_stop_the_run(when: str) -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"))
    if when == "after":
        owned.hear(Taken("high", 1, ""))
    ((kind, why),) = owned.hear(State("high", 1, b"forged"))
    assert kind == "stop"
    assert why == "two states of high for version 1 of the roster differ: somebody else speaks in the name of high"


def test_a_replace_whose_node_cannot_take_the_state() -> None:
    owned = replaced()
    owned.hear(State("high", 1, b"state"))
    calls = owned.hear(Taken("high", 1, "no such key"))
    assert ("answer", "c1", 0, "high: no such key") in calls
    assert calls[-1] == ("begin", 2, 0, 0)


def test_a_lost_node_comes_back_before_it_is_replaced() -> None:
    owned = begun()
    owned.hear(Lost("high", "high.1", True))
    assert owned.hear(propose(Replace("high", OTHER)), join("high.2", request="c1")) == []
    assert sorted(prepares(owned.hear(join("high.3", 0)))) == ["high.3", "low.1", "world.1"]
    calls = owned.ready(1, "high.3", "low.1", "world.1")
    assert calls[0] == ("begin", 1, 1, 1)
    assert "high.2" in prepares(calls), "now its turn has come"


def test_nothing_is_replaced_in_the_midst_of_an_epoch() -> None:
    """Else the epoch could be committed after all, when the state before it is handed over already."""
    owned = begun()
    owned.hear(Lost("high", "high.1", True))
    assert owned.hear(propose(Replace("low", OTHER)), join("low.2", request="c1")) == []
    calls = owned.hear(join("high.2", 0))
    assert sorted(prepares(calls)) == ["high.2", "low.1", "world.1"]
    assert all(Roster.read(order.roster).nodes["low"] == NODE for _, order in calls[1:])
    calls = owned.ready(1, "high.2", "low.1", "world.1")
    assert calls[0] == ("begin", 1, 1, 1)
    assert "low.2" in prepares(calls), "now its turn has come"
    assert owned.ready(2, "high.2", "low.2", "world.1") == [], "between two epochs"
    assert owned.commit()[0] == ("low.1", HandOver(2, 1, 1))
    assert owned.hear(State("low", 2, b"state")) == [("low.2", TakeOver(2, 1, 1, b"state"))], "after attempt 1"


def test_a_replace_goes_along_with_a_recovery_when_no_epoch_runs() -> None:
    owned = begun()
    owned.hear(Lost("high", "high.1", True))  # it had done its part
    owned.hear(propose(Replace("low", OTHER)), join("low.2", request="c1"))
    owned.commit()
    assert sorted(prepares(owned.hear(join("high.2", 1)))) == ["high.2", "low.2", "world.1"]
    assert owned.ready(1, "high.2", "low.2", "world.1") == [("low.1", HandOver(1, 1, 0))]


def test_a_crash_is_a_new_instance_and_a_new_attempt() -> None:
    owned = begun()
    assert owned.hear(Lost("low", "low.1", True)) == []
    owned.hear(join("low.2", 1))
    calls = owned.ready(1, "low.2", "high.1", "world.1")
    assert calls[0] == ("begin", 1, 1, 1)
    assert owned.owner.members.roster.instance("low") == 1
    assert owned.owner.members.roster.content_hash() == CHAIN.content_hash()


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"epoch": 1}, "its checkpoint is of epoch 1, and the hierarchy is in epoch 4"),
        ({"epoch": NEVER}, "it has no checkpoint"),
        ({"epoch": NEVER, "refusal": "slot 0 torn"}, "slot 0 torn"),
        ({"epoch": 3, "version": 9}, "it was in version 9 of the roster, and the hierarchy is in 0"),
    ],
)
def test_an_unsound_checkpoint_is_refused(fields: dict[str, Any], why: str) -> None:
    owned = Owned(epoch=3)
    owned.proceed()
    owned.hear(Lost("high", "high.1", True))
    ((who, order),) = owned.hear(join("high.2", **fields))
    assert who == "high.2"
    assert why in order.why
    ((kind, said),) = owned.hear(Lost("high", "high.2", False))
    assert kind == "stop"
    assert why in said


def test_a_checkpoint_of_another_node_of_that_name_is_refused() -> None:
    owned = Owned(epoch=3, born={"high": (2, 3, "c1")}, roster=Roster(CHAIN.world, CHAIN.nodes, CHAIN.edges, 2))
    owned.proceed()
    owned.hear(Lost("high", "high.1", True))
    assert owned.hear(join("high.2", 3, version=1)) == [("high.2", Dismiss("high: another node has taken its place"))]
    assert prepares(owned.hear(join("high.3", 3, version=2)))


def test_a_checkpoint_of_an_attempt_that_was_not_committed_is_refused() -> None:
    owned = Owned(epoch=3, last_attempt=2)
    owned.proceed()
    owned.hear(Lost("high", "high.1", True))
    why = "its checkpoint is of attempt 1 of epoch 3, and attempt 2 counts"
    assert owned.hear(join("high.2", 3, attempt=1)) == [("high.2", Dismiss(why))]
    assert prepares(owned.hear(join("high.3", 3, attempt=2)))


def test_those_that_are_missing_when_it_begins_are_given_up_in_the_order_of_their_names() -> None:
    names = [f"n{index}" for index in range(8)]
    roster = Roster("world", dict.fromkeys(["world", *names], NODE), tuple(RosterEdge("world", name) for name in names))
    settings = OwnerPolicy(on_loss=dict.fromkeys(names, "detach"), rejoin_timeout_s=dict.fromkeys(names, 1.0))
    owned = Owned(settings, roster=roster, processes={"world": "world.1"})
    owned.now = 1.5
    owned.owner.tick()
    given_up = [call[1].partition(":")[0] for call in owned.calls if call[0] == "note" and "detached" in call[1]]
    assert given_up == names


def test_a_checkpoint_of_an_attempt_that_nobody_has_begun_says_that_somebody_else_spoke() -> None:
    owned = Owned(epoch=3, last_attempt=2)
    owned.proceed()
    owned.hear(Lost("high", "high.1", True))
    ((process, order),) = owned.hear(join("high.2", 3, attempt=3))
    assert process == "high.2"
    assert isinstance(order, Dismiss)
    assert "attempt 3 of epoch 3, and attempt 2 counts, the last one: somebody else has sent it" in order.why


def test_of_which_attempt_a_checkpoint_is_counts_from_the_commit_on() -> None:
    owned = begun()
    owned.hear(Lost("high", "high.1", True), join("high.2", 1))
    owned.ready(1, "high.2", "low.1", "world.1")  # attempt 1
    owned.hear(Lost("high", "high.2", True))
    assert prepares(owned.hear(join("high.3", 1))), "sound, as long as epoch 1 is not committed"
    why = "its checkpoint is of attempt 0 of epoch 1, and attempt 1 counts"
    assert ("high.3", Dismiss(why)) in owned.commit()
    assert owned.owner.progress.last_attempt == 1


def test_a_commit_may_leave_one_that_is_back_behind() -> None:
    owned = begun()
    owned.hear(Lost("high", "high.1", True))  # it had done its part
    assert prepares(owned.hear(join("high.2", 0))), "sound, as long as epoch 1 is not committed"
    assert ("high.2", Dismiss("its checkpoint is of epoch 0, and the hierarchy is in epoch 2")) in owned.commit()


def test_on_loss() -> None:
    settings = OwnerPolicy(on_loss={"high": "detach", "low": "stop"}, rejoin_timeout_s={"high": 1.0, "low": 1.0})
    owned = begun(settings=settings)
    owned.hear(Lost("high", "high.1", True))
    assert owned.wait(0.9) == []
    assert owned.wait(0.2)[0] == ("keep", 1)
    assert owned.ready(1, "low.1", "world.1")[0] == ("begin", 1, 1, 1)
    assert set(owned.owner.members.roster.nodes) == {"world", "low"}
    owned.hear(Lost("low", "low.1", True))
    ((kind, why),) = owned.wait(1.1)
    assert kind == "stop"
    assert "it did not come back in time" in why


def test_one_whose_processes_come_back_and_die_each_time_is_given_up_all_the_same() -> None:
    """No tick need see it between one process and the next: it is held for no longer than `rejoin_timeout`."""
    settings = OwnerPolicy(on_loss={"high": "detach"}, rejoin_timeout_s={"high": 1.0})
    owned = begun(settings=settings)
    assert prepares(owned.hear(Lost("high", "high.1", True), join("high.2", 0)))
    owned.now = 1.1
    calls = owned.hear(Lost("high", "high.2", True), join("high.3", 0))
    assert prepares(calls) == ["low.1", "world.1"], "high is detached"
    assert owned.ready(2, "low.1", "world.1")[0] == ("begin", 1, 1, 2)
    assert set(owned.owner.members.roster.nodes) == {"world", "low"}


def attached_alone() -> Owned:
    """One to which `top` was attached above `low`, and fails alone; in the first epoch with it."""
    owned = begun()
    owned.hear(propose(Attach({"top": NODE}, (RosterEdge("low", "top"),)))._replace(alone=("top",)))
    calls = owned.hear(join("top.1", request="c1"))
    assert [order.alone for _, order in calls if isinstance(order, Prepare)] == [("top",)] * 3
    owned.ready(1, "world.1", "low.1", "top.1")
    assert owned.commit()[-1] == ("begin", 2, 0, 1)
    return owned


def test_what_fails_alone_is_detached_and_the_epoch_done_again() -> None:
    owned = attached_alone()
    failed = Failed("low", "low.1", 1, "low->top", "low->top: sense in epoch 2: ValueError: no")
    calls = owned.hear(failed, failed)
    assert [process for process, order, *_ in calls if isinstance(order, Prepare)] == ["low.1", "world.1"]
    assert [order.alone for _, order, *_ in calls if isinstance(order, Prepare)] == [(), ()]
    calls = owned.ready(2, "world.1", "low.1")
    assert calls == [("begin", 2, 1, 2), ("top.1", Dismiss("top: it is detached from epoch 2 on"))]
    assert owned.hear(failed) == [], "of a version that is past"
    answer = owned.commit()[1]
    refusal = f"{failed.why}; top: detached again before the first epoch was committed"
    assert answer == ("answer", "c1", 0, refusal)


@pytest.mark.parametrize(
    "change",
    [
        {"process": "low.0"},
        {"name": "high", "process": "high.1"},
        {"version": 0},
        {"version": 2},
        {"subject": "world->top"},
        {"subject": "low->high"},
        {"subject": "top"},
        {"subject": "low"},
    ],
)
def test_a_failure_that_somebody_else_tells_of(change: dict[str, Any]) -> None:
    owned = attached_alone()
    assert owned.hear(Failed("low", "low.1", 1, "low->top", "no")._replace(**change)) == []


def test_a_failure_while_the_next_version_is_prepared() -> None:
    owned = attached_alone()
    owned.hear(propose(Detach("high"), "c2"))
    owned.hear(Failed("top", "top.1", 1, "top", "top: observe in epoch 2: ValueError: no"))
    assert owned.ready(3, "world.1", "low.1")[0] == ("begin", 2, 1, 3)
    assert set(owned.owner.members.roster.nodes) == {"world", "low", "high"}
    owned.ready(4, "world.1", "low.1")
    owned.commit()
    assert set(owned.owner.members.roster.nodes) == {"world", "low"}


def test_several_lost_nodes_are_detached_at_once() -> None:
    roster = Roster(
        "world", {"world": NODE, "a": NODE, "b": NODE}, (RosterEdge("world", "a"), RosterEdge("world", "b"))
    )
    settings = OwnerPolicy(on_loss={"a": "detach", "b": "detach"})
    owned = begun(settings=settings, roster=roster, processes={name: f"{name}.1" for name in roster.nodes})
    owned.hear(Lost("a", "a.1", False), Lost("b", "b.1", False))
    assert owned.ready(owned.owner.planning.highest, "world.1")[0][:3] == ("begin", 1, 1)
    assert set(owned.owner.members.roster.nodes) == {"world"}


def test_a_node_that_nobody_runs_is_given_up() -> None:
    owned = begun()
    owned.hear(Lost("high", "high.1", True))
    assert owned.hear(Lost("high", "", False))[0][0] == "stop"
    assert begun().hear(Lost("high", "", False)) == [], "but it has a process"


def test_a_change_in_which_processes_die_again_and_again() -> None:
    owned = begun()
    owned.hear(propose(Detach("high")))
    calls = []
    for number in range(1, MAX_TRIES + 2):
        calls += owned.hear(Lost("low", f"low.{number}", True), join(f"low.{number + 1}", 1))
    assert ("answer", "c1", 0, "processes died each time that it was prepared") in calls


def test_what_comes_late_does_no_harm() -> None:
    owned = begun()
    owned.hear(Lost("low", "low.1", True), join("low.2", 1))
    owned.ready(1, "low.2", "high.1", "world.1")
    late: tuple[Control, ...] = (
        Ready("low", "low.1", 1, ""),
        Ready("low", "low.2", 1, "no"),
        State("low", 1, b"state"),
        Taken("low", 1, "no"),
        Lost("low", "low.1", True),
        Status("low", 7, 1, 0, (), "observe"),
    )
    assert owned.hear(*late) == []
    ((who, order),) = owned.hear(join("low.1", 1))
    assert who == "low.1"
    assert order == Dismiss("low: it was cut off, and taken for lost"), "it may be cut off, and not dead"
    assert owned.commit() == [("begin", 2, 0, 1)]


def test_only_who_has_a_place_is_told_of_a_version() -> None:
    owned = begun()
    assert prepares(owned.hear(Fetch("low", "low.1", 0))) == ["low.1"]
    assert owned.hear(Fetch("low", "low.0", 0)) == []
    assert owned.hear(Fetch("low", "low.1", 5)) == []


def test_who_asks_whether_it_still_has_a_place() -> None:
    owned = begun()
    assert owned.hear(join("low.1", active=True)) == []
    assert isinstance(owned.hear(join("low.0", active=True))[0][1], Dismiss)
    assert isinstance(owned.hear(join("gone.1", active=True))[0][1], Dismiss)
    owned.hear(Lost("low", "low.1", True))
    assert owned.hear(join("low.0", active=True)) == [("end", "low.0", "it was taken for lost")]
    why = "low: it was cut off, and taken for lost in epoch 1"
    assert owned.hear(join("low.1", active=True)) == [("low.1", Dismiss(why, again=True))], "it was not dead after all"
    why = "low: it was cut off, and taken for lost"
    assert owned.hear(join("low.1")) == [("low.1", Dismiss(why, again=True))], "nor before it had taken part"


def asked(calls: list[tuple[Any, ...]]) -> AskStatus:
    """What a process is asked that says that it is ahead."""
    ((who, question),) = calls
    assert who == "low.1"
    return question


@pytest.mark.parametrize("place", [{"epoch": 2}, {"epoch": 10**12}, {"epoch": 1, "version": 1}])
def test_a_node_that_is_further_than_the_world_stops_the_run(place: dict[str, int]) -> None:
    owned = begun()
    epoch, version = place["epoch"], place.get("version", 0)
    question = asked(owned.hear(join("low.1", epoch, active=True, version=version)))
    ((kind, why),) = owned.hear(Status("low", question.inquiry, epoch, 0, (), "", version))
    assert kind == "stop"
    assert f"low is in epoch {epoch}" in why
    assert "somebody else has sent it observations in the name of world" in why


def test_what_is_said_in_a_nodes_name_alone_does_no_harm() -> None:
    owned = begun()
    question = asked(owned.hear(join("low.1", 10**12, active=True)))
    assert owned.hear(Status("low", question.inquiry, 1, 0, (), "")) == []
    assert owned.hear(Status("low", question.inquiry, 10**12, 0, (), "")) == [], "it was asked once"
    assert owned.commit() == [("begin", 2, 0, 0)]
    strange = owned.hear(join("low.9", 10**12, active=True))
    assert [type(order) for _, order in strange] == [Dismiss], "of a process that nobody knows nothing is believed"


def test_no_process_is_dismissed_by_what_is_said_of_another_node() -> None:
    owned = begun()
    assert owned.hear(join("low.1", 1, active=True, name="high"), join("world.1", 1, active=True, name="low")) == []
    owned.hear(propose(TOP))
    owned.hear(join("top.1", request="c1"))
    assert owned.hear(join("top.1", 1, active=True, name="low")) == []


def test_an_attempt_that_nobody_has_begun_is_overtaken() -> None:
    owned = begun()
    for count in range(MAX_REPEATS + 1):
        attempt = 5 + 6 * count
        question = asked(owned.hear(join("low.1", 1, active=True, attempt=attempt)))
        calls = owned.hear(Status("low", question.inquiry, 1, attempt, (), ""))
        assert calls[0][:3] == (("begin", 1, attempt + 1) if count < MAX_REPEATS else ("stop", *calls[0][1:3]))
    assert "low is in epoch 1" in calls[0][1]


def test_who_waits_in_an_attempt_that_nobody_counts_is_brought_back() -> None:
    owned = begun()
    owned.commit()
    question = asked(owned.hear(join("low.1", 1, active=True, attempt=1)))
    waiting = Status("low", question.inquiry, 1, 1, (("high", "ctx"),), "")
    why = "it waits in attempt 1 of epoch 1, and attempt 0 counts"
    assert owned.hear(waiting) == [("end", "low.1", why)]
    question = asked(owned.hear(join("low.1", 1, active=True, attempt=1)))
    assert owned.hear(Status("low", question.inquiry, 1, 1, (), "")) == [], "the next epoch moves it on"


def test_who_is_in_an_attempt_of_another_version_is_overtaken() -> None:
    owned = begun()
    owned.hear(propose(Detach("high")))
    owned.ready(1, "low.1", "world.1")
    assert owned.commit()[0] == ("begin", 2, 0, 1)
    assert owned.hear(join("low.1", 1, active=True, version=0)) == [], "it may have been said before"
    question = asked(owned.hear(join("low.1", 2, active=True, version=0)))
    assert owned.hear(Status("low", question.inquiry, 2, 0, (), "", 0))[0] == ("begin", 2, 1, 1)


def test_a_node_that_is_asked_may_be_in_a_roster_before() -> None:
    owned = begun()
    owned.hear(propose(Detach("high")))
    owned.ready(1, "low.1", "world.1")
    owned.commit()
    assert owned.wait(1.1) == [("world.1", AskStatus(1)), ("low.1", AskStatus(1))][::-1]
    owned.hear(Status("world", 1, 2, 0, (("low", "ctx"),), "", 1), Status("low", 1, 2, 0, (("high", "ctx"),), "", 0))
    calls = owned.wait(0.1)
    assert ("world.1", Resend(2, 0, ("low",))) in calls, "what it waits for nobody is to send it"


def test_processes_that_nobody_knows_are_not_all_remembered() -> None:
    owned = begun()
    for number in range(2 * REMEMBERED):
        owned.hear(join(f"low.x{number}", 1))
    assert len(owned.owner.members._heard_s) <= REMEMBERED


def test_who_asks_for_the_roster_again_and_again_is_told_it_some_times() -> None:
    owned = begun()
    assert prepares(owned.hear(*[Fetch("low", "low.1", 0)] * 100)) == ["low.1"]
    owned.now += FETCH_S
    assert prepares(owned.hear(Fetch("low", "low.1", 0))) == ["low.1"]


def test_what_was_made_is_told_when_the_run_is_over() -> None:
    owned = Owned(epoch=4, attempt=0, highest=6, born={"high": (6, 4, "c1"), "low": (0, 1, "")})
    owned.owner.finish(drained=True)
    owned.take()
    assert owned.hear(propose(TOP), propose(TOP, "c2")) == [("answer", "c1", 4, ""), ("answer", "c2", 0, OVER)]


RATED = replace(SETTINGS, rated=True, overlaps=True)


def last_epoch(**options: Any) -> Owned:
    """An owner with rates in whose last epoch others may be behind the world."""
    owned = Owned(RATED, epoch=4, attempt=0, **options)
    owned.owner.finish(drained=False)
    return owned


def test_with_rates_a_run_is_over_when_all_are_done_with_the_last_epoch() -> None:
    owned = last_epoch()
    assert owned.take() == [("high.1", CatchUp(4)), ("low.1", CatchUp(4))]
    owned.hear(CaughtUp("low", "low.1", 4), CaughtUp("high", "high.1", 3), CaughtUp("high", "high.0", 4))
    assert not owned.owner.progress.over
    assert owned.wait(0.1) == [("high.1", CatchUp(4))], "the question may have been lost"
    assert owned.hear(propose(TOP)) == [("answer", "c1", 0, OVER)]
    owned.hear(CaughtUp("high", "high.1", 4))
    assert owned.owner.progress.over
    assert owned.wait(0.1) == []


def test_with_rates_who_is_lost_at_the_end_is_had_back_first() -> None:
    owned = last_epoch()
    owned.hear(CaughtUp("low", "low.1", 4), Lost("high", "high.1", True), CaughtUp("high", "high.1", 4))
    assert not owned.owner.progress.over
    assert sorted(prepares(owned.hear(join("high.2", 3)))) == ["high.2", "low.1", "world.1"]
    assert owned.ready(1, "world.1", "low.1", "high.2")[0] == ("begin", 5, 1, 1), (
        "the world takes up the version, no epoch"
    )
    assert not owned.owner.progress.running
    assert owned.wait(0.1) == [("high.2", CatchUp(4))]
    owned.hear(CaughtUp("high", "high.2", 4))
    assert owned.owner.progress.over


def test_with_rates_a_change_that_is_under_way_at_the_end_is_refused_and_who_is_back_is_not() -> None:
    owned = Owned(RATED, epoch=4, attempt=0)
    owned.hear(Lost("high", "high.1", True), propose(TOP), join("high.2", 3))
    owned.take()
    owned.owner.finish(drained=False)
    calls = owned.take()
    assert ("answer", "c1", 0, OVER) in calls
    assert sorted(prepares(calls)) == ["high.2", "low.1", "world.1"]


def test_with_rates_nobody_is_behind_a_drained_last_epoch() -> None:
    owned = Owned(RATED, epoch=4, attempt=0)
    owned.owner.finish(drained=True)
    assert owned.owner.progress.over
    assert owned.take() == []


def test_with_rates_who_hangs_at_the_end_is_killed() -> None:
    owned = last_epoch()
    owned.hear(CaughtUp("low", "low.1", 4))
    ended: list[tuple[Any, ...]] = []
    while not ended and owned.now < 10.0:
        calls = owned.wait(0.3)
        ended = [call for call in calls if call[0] == "end"]
        for number in {order.inquiry for _, order, *_ in calls if isinstance(order, AskStatus)}:
            for name, busy in (("world", ""), ("low", ""), ("high", "observe")):
                owned.hear(Status(name, number, 4, 0, (), busy))
    assert [process for _, process, _ in ended] == ["high.1"]
    assert "epoch 4" in ended[0][2]


def test_the_world_comes_back() -> None:
    owned = Owned(processes={"low": "low.1", "high": "high.1"}, epoch=4, attempt=2, highest=6, born={"low": (0, 1, "")})
    owned.owner.take_back("world.2")
    calls = owned.take()
    assert calls[0] == ("keep", 7)
    assert sorted(prepares(calls)) == ["low.1", "world.2"]
    assert owned.ready(7, "low.1", "world.2")[0] == ("begin", 5, 3, 7)
    assert owned.commit() == [("begin", 6, 1, 7)], "the first attempt may have been begun, and forgotten"


def test_what_may_have_been_acted_upon_is_done_again_with_the_same_nodes() -> None:
    owned = Owned(processes={"low": "low.1", "high": "high.1"}, epoch=4, attempt=0, settled=True)
    owned.owner.take_back("world.2")
    owned.hear(propose(Detach("high")))
    assert owned.ready(1, "low.1", "world.2")[0] == ("begin", 5, 1, 1)
    owned.commit()
    owned.ready(2, "low.1", "world.2")
    owned.commit()
    assert "high" not in owned.owner.members.roster.nodes


def test_an_answer_that_the_dead_process_owed() -> None:
    owned = Owned(epoch=4, attempt=0, born={"high": (3, 5, "c1")})
    owned.proceed()
    assert owned.hear(propose(Replace("high", OTHER))) == []
    assert ("answer", "c1", 5, "") in owned.commit()


def test_the_run_is_over() -> None:
    owned = begun()
    owned.hear(propose(TOP))
    owned.owner.committed(1)
    owned.owner.finish(drained=True)
    assert owned.take() == [("answer", "c1", 0, "the run is over")]
    assert owned.hear(propose(Detach("high"), "c2")) == [("answer", "c2", 0, "the run is over")]
    assert owned.hear(join("top.1", request="c1"), Lost("low", "low.1", True)) == []
    assert owned.wait(100.0) == []


def test_a_hang_is_looked_into() -> None:
    owned = begun()
    assert owned.wait(0.9) == []
    assert [order for _, order in owned.wait(0.2)] == [AskStatus(1)] * 3
    owned.hear(Status("world", 1, 1, 0, (("low", "ctx"),), ""), Status("low", 1, 1, 0, (("high", "ctx"),), ""))
    assert owned.wait(0.3) == [("high.1", AskStatus(1))], "the question may have been lost"
    assert owned.wait(0.1) == [("end", "high.1", "it does not answer in epoch 1, past the deadline")]


def test_one_in_an_operator_is_the_culprit() -> None:
    owned = begun()
    owned.wait(1.1)
    owned.hear(
        Status("world", 1, 1, 0, (("low", "ctx"),), ""),
        Status("low", 1, 1, 0, (("high", "ctx"),), ""),
        Status("high", 1, 1, 0, (), "observe"),
    )
    assert owned.wait(0.1) == [("end", "high.1", "it is in observe in epoch 1, past the deadline")]


def test_with_rates_one_that_is_behind_and_gets_on_is_no_culprit_until_it_stops() -> None:
    owned = begun(settings=replace(SETTINGS, overlaps=True, rated=True))
    for _ in range(39):
        owned.commit()
    blamed: list[tuple[Any, ...]] = []
    ended_s = 0.0
    for look in range(1, 200):
        calls = owned.wait(0.05)
        inquiry = max((order.inquiry for _, order, *_ in calls if isinstance(order, AskStatus)), default=0)
        high = min(look // 4, 25)  # it stops after five seconds
        if inquiry:
            waiting = Status("world", inquiry, 40, 0, (("low", "ctx"),), "")
            owned.hear(waiting, Status("low", inquiry, 40, 0, (("high", "ctx"),), ""))
            owned.hear(Status("high", inquiry, high, 0, (), "observe"))
        blamed += [call for call in calls if call[0] == "end"]
        if blamed:
            ended_s = owned.now
            break
    assert blamed == [("end", "high.1", "it is in observe in epoch 40, past the deadline")]
    assert 5.0 + 1.0 <= ended_s <= 5.0 + 2.5, "an epoch of its own may take a second"


def test_what_was_lost_is_sent_again_and_then_the_link_is_blamed() -> None:
    owned = begun()
    owned.wait(1.1)
    for inquiry in range(1, 5):
        owned.hear(
            Status("world", inquiry, 1, 0, (("low", "ctx"),), ""),
            Status("low", inquiry, 1, 0, (("high", "ctx"),), ""),
            Status("high", inquiry, 1, 0, (), ""),
        )
        calls = owned.wait(0.1)
        if inquiry <= 3:
            assert ("high.1", Resend(1, 0, ("low",))) in calls
            owned.wait(0.1)
    assert calls == [("end", "high.1", "a link to it carries nothing")]


def test_a_keeper_that_is_cut_off_as_well() -> None:
    settings = OwnerPolicy(epoch_deadline_s=1.0, answer_timeout_s=2.0, on_loss={"high": "detach"})
    owned = begun(settings=settings)
    owned.wait(1.1)
    owned.hear(Status("world", 1, 1, 0, (("low", "ctx"),), ""), Status("low", 1, 1, 0, (("high", "ctx"),), ""))
    assert owned.wait(0.3) == [("high.1", AskStatus(1))]
    assert owned.wait(0.1)[0][:2] == ("end", "high.1")
    assert owned.owner.members.lost.keys() == set()
    owned.wait(2.1)
    assert owned.owner.members.lost.keys() == {"high"}
