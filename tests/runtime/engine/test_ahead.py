"""A world that works ahead sends and keeps what any other one does, and calls its operators earlier."""

from __future__ import annotations

from typing import Any

import pytest
from support.engines import Solo, message
from support.recording import Output, sent, steps

from hierax.runtime import Elements, Tick, Value
from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.hierarchy import BoundEdge, Edge
from hierax.runtime.core.node import World
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.schemas.messages import CONTEXT, TASKS
from hierax.schemas.values import encode_value

EPOCHS = 12  # epochs in which it is looked at what operators do to their arguments, and others


class Noting(World):
    """Notes what is called, and when; it ends after some epochs."""

    def __init__(self, works_ahead: bool, last: int = 100) -> None:
        self.works_ahead = works_ahead
        self.last = last
        self.calls: list[str] = []
        self.fails_in = 0

    def initial_belief(self) -> Value:
        return {"steps": 0, "told": ""}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick) -> Value:
        self.calls.append(f"predict {tick.epoch} {len(context)}")
        return {"steps": belief["steps"] + 1, "told": repr((context, actions))}

    def finished(self, belief: Value) -> bool:
        return bool(belief["steps"] >= self.last)

    def seen(self, belief: Value, tick: Tick) -> Elements:
        """φ of the edge to the one above."""
        self.calls.append(f"sense {tick.epoch}")
        if tick.epoch == self.fails_in:
            raise RuntimeError("dark")
        return (belief["steps"], tick.time_s, tick.rng.random())


def solo_of(node: Noting) -> Solo:
    setting = OperatorSetting(seed=3)
    edge = BoundEdge.of(Edge("low", "top", sense=node.seen), setting)
    place = Place(4, bytes(range(32)), {"low": 7, "top": 9}, frozenset({("low", "top")}))
    return Solo(Wiring(BoundNode("low", node, (), ("top",), setting), [edge], place))


def down(kind: str, epoch: int, *elements: Value) -> Any:
    given = message(kind, epoch, sender="top", receiver="low")
    return given._replace(payload=elements)


def content(outputs: list[Output]) -> bytes:
    """All that is sent and done, in bytes."""
    messages = [(each.header.kind, each.header.epoch, each.header.time_s, each.payload) for each in sent(outputs)]
    done = [(step.epoch, step.tasks, step.context, step.actions, step.belief) for step in steps(outputs)]
    return encode_value((tuple(messages), tuple(done)))


@pytest.mark.parametrize("context", [(), ("watch out",)])
def test_it_does_what_any_other_world_does(context: Elements) -> None:
    plain, ahead = (solo_of(Noting(works_ahead)) for works_ahead in (False, True))
    for epoch in range(1, EPOCHS):
        outputs = [
            solo.begin() + solo.take(down(TASKS, epoch)) + solo.take(down(CONTEXT, epoch, *context))
            for solo in (plain, ahead)
        ]
        assert content(outputs[0]) == content(outputs[1])
        assert plain.engine.encoded == ahead.engine.encoded


def begun_in(epoch: int, node: Noting) -> Solo:
    """One that has begun this epoch."""
    solo = solo_of(node)
    for earlier in range(1, epoch):
        solo.begin()
        solo.take(down(TASKS, earlier), down(CONTEXT, earlier))
    solo.begin()
    node.calls.clear()
    return solo


def test_it_predicts_and_senses_once_its_tasks_are_there_and_sends_nothing_of_it() -> None:
    node = Noting(works_ahead=True)
    solo = begun_in(5, node)
    assert sent(solo.take(down(TASKS, 5))) == []
    assert node.calls == ["predict 5 0", "sense 6"]
    assert steps(solo.take(down(CONTEXT, 5)))
    assert [each.header.epoch for each in sent(solo.begin())] == [6]
    assert node.calls == ["predict 5 0", "sense 6"]


def test_any_other_world_waits() -> None:
    node = Noting(works_ahead=False)
    solo = begun_in(5, node)
    solo.take(down(TASKS, 5))
    assert node.calls == []


def test_where_context_comes_it_predicts_and_senses_again() -> None:
    node = Noting(works_ahead=True)
    solo = begun_in(5, node)
    solo.take(down(TASKS, 5), down(CONTEXT, 5, "watch out"))
    solo.begin()
    assert node.calls == ["predict 5 0", "sense 6", "predict 5 1", "sense 6"]


def test_where_it_cannot_predict_without_context_it_waits_for_that() -> None:
    class Guided(Noting):
        def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick) -> Value:
            return {**super().predict(context, actions, belief, tick), "told": context[0]}

    node = Guided(works_ahead=True)
    solo = solo_of(node)
    solo.begin()
    solo.take(down(TASKS, 1))
    assert [step.belief["told"] for step in steps(solo.take(down(CONTEXT, 1, "left")))] == ["left"]
    assert node.calls == ["sense 1", "predict 1 0", "predict 1 1"]
    solo.begin()
    solo.take(down(TASKS, 2))
    with pytest.raises(OperatorError, match="low: predict in epoch 2: IndexError"):
        solo.take(down(CONTEXT, 2))


def test_an_epoch_that_is_begun_again_uses_nothing_of_the_attempt_before() -> None:
    node = Noting(works_ahead=True)
    solo = begun_in(5, node)
    solo.take(down(TASKS, 5))
    solo.begin_again(1)
    again = [down(TASKS, 5), down(CONTEXT, 5)]
    assert steps(solo.take(*(each._replace(header=each.header._replace(attempt=1)) for each in again)))
    assert node.calls == ["predict 5 0", "sense 6", "sense 5", "predict 5 0", "sense 6"]


def test_it_senses_for_no_epoch_that_there_will_not_be() -> None:
    node = Noting(works_ahead=True, last=5)
    solo = begun_in(5, node)
    solo.take(down(TASKS, 5))
    assert node.calls == ["predict 5 0"]


def test_what_fails_ahead_fails_in_its_epoch() -> None:
    node = Noting(works_ahead=True)
    node.fails_in = 6
    solo = begun_in(5, node)
    assert steps(solo.take(down(TASKS, 5), down(CONTEXT, 5)))
    with pytest.raises(OperatorError, match=r"low->top.*epoch 6.*dark"):
        solo.begin()


def test_another_roster_has_its_edges_sensed() -> None:
    node = Noting(works_ahead=True)
    solo = begun_in(5, node)
    solo.take(down(TASKS, 5), down(CONTEXT, 5))
    place = solo.engine.wiring.place
    edge = BoundEdge.of(Edge("low", "top", sense=node.seen), OperatorSetting(seed=3))
    other = Wiring(solo.engine.node, [edge], place)
    other.roster = place.roster + 1
    solo.prepare(other)
    solo.engine.rewire(other.roster)
    solo.begin()
    assert node.calls == ["predict 5 0", "sense 6", "sense 6"]
