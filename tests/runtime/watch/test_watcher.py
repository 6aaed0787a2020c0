"""What a runner tells its watchers, and that the run is the same with them."""

from __future__ import annotations

import pytest
from support.deployments import write

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.execution.single import run
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import Message


class Told(Watcher):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.events: list[str] = []
        self.closed = False

    def received(self, message: Message) -> None:
        self.events.append(f"received {message.header.kind} {message.header.epoch}")

    def called(self, called: Called) -> None:
        self.events.append(f"called {called.operator} {called.epoch}")

    def sending(self, message: Message) -> Message:
        self.events.append(f"sending {message.header.kind} {message.header.epoch}")
        return message._replace(header=message.header._replace(extensions={"from": "a watcher"}))

    def sent(self, message: Message) -> None:
        assert message.header.extensions == {"from": "a watcher"}
        self.events.append(f"sent {message.header.kind} {message.header.epoch}")

    def acted(self, epoch: int) -> None:
        self.events.append(f"acted {epoch}")

    def completed(self, completed: Completed) -> None:
        self.events.append(f"completed {completed.step.epoch}")

    def committed(self, epoch: int, digest: bytes) -> None:
        self.events.append(f"committed {epoch}")

    def served(self) -> None:
        self.events.append("served")

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def told(tmp_path) -> dict[str, Told]:  # type: ignore[no-untyped-def]
    deployment = read_deployment(write(tmp_path))
    told: dict[str, Told] = {}

    def watch(name: str, runner: NodeRunner) -> None:
        told[name] = Told()
        runner.watch(told[name])

    plain = run(deployment, epochs=2, seed=5)
    assert run(deployment, epochs=2, seed=5, watch=watch).digest == plain.digest
    return told


def test_a_node_between_others(told: dict[str, Told]) -> None:
    events = told["left"].events
    of_epoch = [
        "received obs {0}",
        "called observe {0}",
        "called sense {0}",
        "sending obs {0}",
        "sent obs {0}",
        "called select_policy {0}",
        "called policy default {0}",
        "served",
        "received ctx {0}",
        "called predict {0}",
        "sending ctx {0}",
        "sent ctx {0}",
        "completed {0}",
        "served",
    ]
    assert events == [event.format(epoch) for epoch in (1, 2) for event in of_epoch]


def test_the_world_begins_the_next_epoch_before_it_tells_of_the_last(told: dict[str, Told]) -> None:
    events = told["world"].events
    assert events.index("acted 1") < events.index("sending obs 2") < events.index("committed 1")
    assert events.index("committed 1") < events.index("completed 1")
    assert [event for event in events if event.startswith("committed")] == ["committed 1", "committed 2"]


def test_watchers_are_closed_with_the_run(told: dict[str, Told]) -> None:
    assert all(each.closed for each in told.values())


def test_who_leaves_is_told_nothing_more(tmp_path) -> None:  # type: ignore[no-untyped-def]
    runners: list[NodeRunner] = []
    first, second = Told(), Told()

    def watch(name: str, runner: NodeRunner) -> None:
        if name == "left":
            runners.append(runner)
            runner.watch(first)
            runner.watch(second)
            runner.observers.unwatch(first)

    run(read_deployment(write(tmp_path)), epochs=1, seed=0, watch=watch)
    assert first.events == []
    assert second.events
    runners[0].observers.unwatch(second)
    assert not runners[0].engine.events
