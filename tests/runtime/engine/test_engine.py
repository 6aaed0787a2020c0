"""What the world alone may do, what an engine calls and in which order, and what it sends again."""

from __future__ import annotations

from typing import Any

import pytest
from support.engines import EPOCH, Solo, encoded, message, other, wiring
from support.recording import Acted, Completed, Kept, Recorder, Sent, of, sent, steps

from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Called, Committed
from hierax.runtime.engine.engine import AFTER, Engine
from hierax.runtime.engine.table import Phase
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, encode_message
from hierax.schemas.values import decode_value, encode_value


def mixing() -> Solo:
    return Solo(wiring(mixing=True))


# --- what the world alone may do


def world(*above: str) -> Solo:
    return Solo(wiring("low", (), above, mixing=True))


def down(sender: str, epoch: int = 1, **change: Any) -> Any:
    return message(CONTEXT, epoch, sender=sender, receiver="low", **change)


def test_only_a_world_that_is_done_begins() -> None:
    solo = world("mid")
    assert solo.engine.phase is Phase.DONE
    assert [type(output) for output in solo.begin()] == [Sent]
    assert solo.engine.phase is Phase.PREDICT
    for wrong in (solo, Solo()):
        with pytest.raises(ValueError, match="only a world that is done"):
            wrong.begin()


def test_only_a_world_that_has_begun_begins_again_as_a_later_attempt() -> None:
    solo = world("mid")
    node = Solo()
    node.take(message(OBSERVATIONS))
    for wrong in (solo, node):
        with pytest.raises(ValueError, match="only a world that has begun"):
            wrong.begin_again(1)
    solo.begin(2)
    for attempt in (1, 2):
        with pytest.raises(ValueError, match="as a later attempt"):
            solo.begin_again(attempt)
    assert [each.header.attempt for each in sent(solo.begin_again(3))] == [3]
    assert steps(solo.take(down("mid", attempt=3)))
    with pytest.raises(ValueError, match="only a world that has begun"):
        solo.begin_again(4)


def test_a_world_that_begins_again_forgets_what_came_and_says_the_same() -> None:
    solo = world("mid", "top")
    solo.begin()
    solo.take(down("mid"), down("top"))
    first = sent(solo.begin())
    solo.take(down("mid", 2, text="old"))
    again = sent(solo.begin_again(1))
    assert [each._replace(header=each.header._replace(attempt=1)).header for each in first] == [
        each.header for each in again
    ]
    assert encode_value(tuple(each.payload for each in first)) == encode_value(tuple(each.payload for each in again))
    assert solo.engine.waits_for == (("mid", CONTEXT), ("top", CONTEXT))
    assert solo.take(down("top", 2, text="old")) == []
    (step,) = steps(solo.take(*(down(sender, 2, text=f"new {sender}", attempt=1) for sender in ("top", "mid"))))
    assert (step.attempt, step.context) == (1, ("new mid", "new top"))


def test_a_world_alone_is_done_at_once() -> None:
    solo = world()
    for epoch in (1, 2):
        assert [type(output) for output in solo.begin(epoch)] == [Acted, Committed, Completed]
        assert (solo.engine.epoch, solo.engine.attempt, solo.engine.phase) == (epoch, epoch, Phase.DONE)


# --- what is called, and in which order


def test_a_node_saves_before_it_sends_context_and_is_done_after_that() -> None:
    outputs = mixing().epoch()
    kinds = [each.message.header.kind if isinstance(each, Sent) else type(each) for each in outputs]
    assert kinds == [Kept, OBSERVATIONS, TASKS, Kept, CONTEXT, Completed]


def test_tasks_go_down_before_the_context_from_above_is_there_and_context_does_not() -> None:
    solo = mixing()
    assert [each.header.kind for each in sent(solo.take(message(OBSERVATIONS)))] == [OBSERVATIONS]
    assert [each.header.kind for each in sent(solo.take(message(TASKS)))] == [TASKS]
    assert [each.header.kind for each in sent(solo.take(message(CONTEXT)))] == [CONTEXT]


def test_tasks_wait_for_those_of_all_above_and_for_nothing_else() -> None:
    solo = Solo(wiring(above=("top", "top2"), mixing=True))
    solo.take(message(OBSERVATIONS))
    assert solo.take(message(CONTEXT), message(TASKS), other(CONTEXT)) == []
    assert [each.header.kind for each in sent(solo.take(other(TASKS)))] == [TASKS, CONTEXT]


def test_what_a_node_does_is_the_same_whether_tasks_or_context_come_first() -> None:
    first, second = mixing(), mixing()
    whole = steps(first.epoch())
    other_order = steps(second.take(message(OBSERVATIONS), message(CONTEXT), message(TASKS)))
    assert encoded_step(whole) == encoded_step(other_order)


def encoded_step(done: list[Any]) -> bytes:
    (step,) = done
    return encode_value((step.tasks, step.context, step.policy, step.actions, step.belief))


class Prompt(Recorder):
    """Keeps what was predicted, too, as if it were completed then."""

    def predicted(self, completed: Completed) -> None:
        self.outputs.append(completed)


def test_the_outcome_is_told_before_the_checkpoint_the_context_and_the_act() -> None:
    node, above = mixing(), world("mid")
    for solo in (node, above):
        solo.recorder = Prompt()
        solo.engine = Engine(solo.engine.wiring, solo.recorder)
    outputs = node.epoch()
    kinds = [each.message.header.kind if isinstance(each, Sent) else type(each) for each in outputs]
    assert kinds == [Kept, OBSERVATIONS, TASKS, Completed, Kept, CONTEXT, Completed]
    first, second = of(Completed, outputs)
    assert first is second
    outputs = above.begin() + above.take(down("mid"))
    assert [type(output) for output in outputs] == [Sent, Completed, Acted, Committed, Completed]


def test_the_first_thing_that_a_node_keeps_is_its_initial_state() -> None:
    for joins, epoch in ((False, 1), (True, 5)):
        solo = Solo(wiring(below=("low", "low2")), joins=joins)
        initial = solo.engine.encoded
        assert solo.take(message(OBSERVATIONS, epoch)) == [Kept(epoch - 1, 0, initial, initial)]
        assert solo.take(message(OBSERVATIONS, epoch, attempt=1)) == []


def test_what_is_kept_is_the_state_at_the_start_and_now() -> None:
    solo = mixing()
    states = [solo.engine.encoded]
    for epoch, attempt in ((1, 0), (2, 1), (2, 2), (3, 0)):
        kept = of(Kept, solo.epoch(epoch, attempt=attempt, extensions={AFTER: 2} if epoch == 3 else {}))[-1]
        assert (kept.epoch, kept.attempt) == (epoch, attempt)
        assert kept.start == states[epoch - 1]
        assert ActiveNode(*decode_value(kept.now)).policy == solo.engine.state.policy
        assert kept.now == solo.engine.encoded == encoded(solo.engine.state)
        states[epoch:] = [kept.now]


def test_a_world_acts_before_it_commits_and_saves_nothing() -> None:
    solo = world("mid")
    outputs = solo.begin() + solo.take(down("mid"))
    assert [type(output) for output in outputs] == [Sent, Acted, Committed, Completed]
    (acted,), (committed,), (completed,) = (of(kind, outputs) for kind in (Acted, Committed, Completed))
    assert acted == Acted(1, completed.step.actions)
    assert committed == Committed(1, 0, completed.digest)


def test_a_task_leaves_before_the_prediction_and_one_context_before_the_next() -> None:
    solo = Solo()
    wired = wiring(below=("low", "low2"), mixing=True)
    solo.engine = Engine(wired, solo.recorder)
    solo.engine.events = True
    outputs = solo.take(other(OBSERVATIONS), *map(message, EPOCH))
    order = []
    for output in outputs:
        if isinstance(output, Called):
            order.append(f"{output.subject} {output.operator}")
        elif isinstance(output, Sent):
            order.append(f"{output.message.header.kind} to {output.message.header.receiver}")
    policy = solo.engine.state.policy
    assert order == [
        "mid observe",
        "mid->top sense",
        "obs to top",
        "mid select_policy",
        f"mid policy {policy}",
        "low->mid task",
        "task to low",
        "low2->mid task",
        "task to low2",
        "mid predict",
        "low->mid context",
        "ctx to low",
        "low2->mid context",
        "ctx to low2",
    ]


def test_what_was_sent_is_sent_again_to_whom_it_is_asked_for() -> None:
    solo = Solo(wiring(below=("low", "low2"), above=("top", "top2"), mixing=True))
    first = solo.take(message(OBSERVATIONS), other(OBSERVATIONS))
    assert resent(solo, "top2") == [each for each in sent(first) if each.header.receiver == "top2"] != []
    assert resent(solo, "low", "stranger", "mid") == []
    second = solo.take(*(each(kind) for each in (message, other) for kind in (TASKS, CONTEXT)))
    assert [each.header[:3] for each in resent(solo, "low2", "top")] == [
        (CONTEXT, "mid", "low2"),
        (TASKS, "mid", "low2"),
        (OBSERVATIONS, "mid", "top"),
    ]
    everything = resent(solo, "low", "low2", "top", "top2")
    assert sorted(map(encode_message, everything)) == sorted(map(encode_message, sent(first) + sent(second)))
    assert steps(second)


@pytest.mark.parametrize("change", [{"epoch": 1, "attempt": 1}, {"epoch": 2}])
def test_what_was_sent_before_the_epoch_or_attempt_is_not_sent_again(change: dict[str, int]) -> None:
    solo = Solo(wiring(below=("low", "low2"), mixing=True))
    solo.take(other(OBSERVATIONS), *map(message, EPOCH))
    solo.take(message(OBSERVATIONS, **change))
    assert resent(solo, "low", "top") == []
    solo.take(other(OBSERVATIONS, **change))
    assert [each.header[3:5] for each in resent(solo, "low", "top")] == [(change["epoch"], change.get("attempt", 0))]


def resent(solo: Solo, *receivers: str) -> list[Any]:
    solo.engine.resend(receivers)
    return sent(solo.recorder.take())


def test_who_waits_says_for_whom() -> None:
    solo = Solo(wiring(below=("low", "low2"), above=("top", "top2")))
    assert solo.engine.waits_for == (("low", OBSERVATIONS), ("low2", OBSERVATIONS))
    solo.take(other(OBSERVATIONS))
    assert solo.engine.waits_for == (("low", OBSERVATIONS),)
    solo.take(message(OBSERVATIONS), message(TASKS), other(CONTEXT))
    assert solo.engine.waits_for == (("top", CONTEXT), ("top2", TASKS))
    assert world("mid").engine.waits_for == ()
