from __future__ import annotations

import numpy as np
import pytest

from hierax.runtime.core.probe import Step
from hierax.runtime.engine.effects import Completed
from hierax.runtime.watch.watcher import STEPS_KEPT, Copier, Stepper, read_step
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Header, Message, decode_message
from hierax.schemas.values import encode_value


def completed(epoch: int, sensed: object = 2.0) -> Completed:
    image = np.arange(4, dtype=np.uint8)
    step = Step(epoch, 1, 0.5, ({"image": image},), sensed, (), (1,), "go", (), {"x": 3.0})
    return Completed(step, b"", b"")


def test_a_step_comes_out_as_it_went_in() -> None:
    stepper = Stepper()
    stepper.completed(completed(7))
    (data,) = stepper.take()
    done_ns, step = read_step(data)
    assert done_ns > 0
    assert step._replace(observations=()) == completed(7).step._replace(observations=())
    assert step.observations[0]["image"].tolist() == [0, 1, 2, 3]
    assert not list(stepper.take())


def test_some_epochs_are_left_out_and_the_oldest_forgotten() -> None:
    stepper = Stepper()
    stepper.every = 3
    for epoch in range(1, 100):
        stepper.completed(completed(epoch))
    epochs = [read_step(data)[1].epoch for data in stepper.take()]
    assert epochs == list(range(99 - 3 * (STEPS_KEPT - 1), 100, 3))


def test_a_node_with_rates_is_seen_as_seldom_whatever_its_turns() -> None:
    stepper = Stepper()
    stepper.every = 4
    for epoch in range(3, 100, 10):  # none of which four divides
        stepper.completed(completed(epoch))
    assert [read_step(data)[1].epoch for data in stepper.take()] == list(range(13, 100, 10))


def test_what_cannot_travel_is_left_out() -> None:
    stepper = Stepper()
    stepper.completed(completed(1, sensed=object()))
    stepper.completed(completed(2))
    assert [read_step(data)[1].epoch for data in stepper.take()] == [2]


@pytest.mark.parametrize("value", [None, {}, {"done_ns": 1}, {"done_ns": 1, "epoch": 1, "colour": "red"}])
def test_what_is_no_step_is_refused(value: object) -> None:
    with pytest.raises(SchemaError, match="is no step of a node"):
        read_step(encode_value(value))


def test_only_what_is_wanted_is_shown() -> None:
    shown: list[tuple[str, str, str, bytes]] = []
    copier = Copier(lambda *what: shown.append(what))
    up = Message(Header(OBSERVATIONS, "arm", "top", 3), (1.5,))
    copier.sent(up)
    assert shown == []
    copier.wanted = {(OBSERVATIONS, "arm", "top")}
    copier.sent(up)
    copier.sent(Message(Header(CONTEXT, "arm", "low", 3), ()))
    ((kind, sender, receiver, data),) = shown
    assert (kind, sender, receiver) == (OBSERVATIONS, "arm", "top")
    assert decode_message(data) == up
