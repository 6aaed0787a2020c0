"""A node running: its limits, its timing, and what its probes and its report may do wrong."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import msgpack
import pytest
from support.hierarchies import MixingNode
from support.toy_nodes import Counter, Keeper

from hierax.runtime import NO_TICK, Node, Probe, Step, Tick, Value
from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.digest import DigestChain, encode_state
from hierax.runtime.core.errors import HierarchyError, HieraxError, OperatorError, ProbeError
from hierax.runtime.engine.wiring import Place, Wiring
from hierax.runtime.execution.checkpoints import taken_over
from hierax.runtime.execution.observers import Observers
from hierax.runtime.execution.output_folder import Log
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.runner import NodeRunner, World
from hierax.runtime.transport.port import MemoryNetwork
from hierax.schemas.messages import CONTEXT, Header, Message

ROSTER_HASH = bytes(range(32))


def alone(world: Node, limit: int | None, *probes: Probe, states: Log | None = None) -> NodeRunner:
    """A hierarchy of nothing but a world, whose clock ticks whole seconds."""
    wiring = Wiring(BoundNode("w", world, (), (), OperatorSetting()), (), Place())
    ticks = count()
    pacemaker = Pacemaker(DigestChain(ROSTER_HASH), limit, lambda *_: None, clock=lambda: float(next(ticks)))
    observers = Observers("w", probes, states)
    return NodeRunner(wiring, MemoryNetwork().open_port("w"), observers, world=World(pacemaker))


def pacemaker_of(runner: NodeRunner) -> Pacemaker:
    assert runner.world is not None
    return runner.world.pacemaker


@pytest.mark.parametrize(
    ("limit", "last", "epochs"), [(3, None, 3), (0, None, 0), (None, 4, 4), (None, 0, 0), (9, 2, 2), (2, 9, 2)]
)
def test_it_ends_at_the_limit_or_when_the_world_has_finished(limit: int | None, last: int | None, epochs: int) -> None:
    keeper = Keeper()
    runner = alone(Counter(last=last), limit, keeper)
    runner.finish()
    pacemaker = pacemaker_of(runner)
    assert pacemaker.done
    assert (pacemaker.chain.epoch, pacemaker.times.took_s.count) == (epochs, epochs)
    assert [step.epoch for step in keeper.steps] == list(range(1, epochs + 1))
    assert runner.report().metrics == {"count": float(epochs)}


def test_each_epoch_is_timed_from_its_beginning_to_its_commit() -> None:
    runner = alone(Counter(), 3)
    runner.finish()
    times = pacemaker_of(runner).times
    assert times.took_s.numbers().tolist() == [1.0, 1.0, 1.0]
    assert times.wall_s == 5.0


def test_without_an_epoch_no_time_passes() -> None:
    runner = alone(Counter(), 0)
    runner.finish()
    assert pacemaker_of(runner).times.wall_s == 0.0


def test_a_world_alone_tells_each_epoch_before_the_one_after_the_next() -> None:
    """So that nothing piles up in a run without end."""
    told: list[int] = []
    seen: list[tuple[int, int]] = []

    class Watched(Counter):
        def predict(self, context: Any, actions: Any, belief: Value) -> Value:
            seen.append((belief + 1, len(told)))
            return belief + 1

    runner = alone(Watched(), 5)
    pacemaker_of(runner).on_commit = lambda epoch, _: told.append(epoch)
    runner.finish()
    assert told == [1, 2, 3, 4, 5]
    assert seen == [(1, 0), (2, 0), (3, 1), (4, 2), (5, 3)]


def test_a_world_acts_once_an_epoch_after_its_prediction_and_before_the_commit() -> None:
    done: list[tuple[Any, ...]] = []

    class Acting(Counter):
        def predict(self, context: Any, actions: Any, belief: Value) -> Value:
            done.append(("predict", belief + 1))
            return belief + 1

        def act(self, actions: Any, tick: Tick = NO_TICK) -> None:
            done.append(("act", tick.epoch, tick.time_s, actions, tick.operator))

    runner = alone(Acting(), 2)
    pacemaker = pacemaker_of(runner)
    stop = pacemaker.stop

    def stopped() -> None:
        done.append(("commit",))
        stop()

    pacemaker.stop = stopped  # type: ignore[method-assign]
    runner.finish()
    expected = [[("predict", epoch), ("act", epoch, epoch - 1.0, (), "act"), ("commit",)] for epoch in (1, 2)]
    assert done == [each for epoch in expected for each in epoch]


def test_what_must_lack_no_epoch_is_written_before_anything_of_it_is_done(tmp_path: Path) -> None:
    """A process may die at any instant; what other probes see comes when nobody waits."""
    log = tmp_path / "states" / "w.msgpack"
    done: list[tuple[str, int]] = []

    class Seen(Probe):
        def __init__(self, prompt: bool) -> None:
            self.prompt = prompt

        def record(self, step: Step) -> None:
            done.append(("prompt" if self.prompt else "other", step.epoch))

    class Acting(Counter):
        def act(self, actions: Any, tick: Tick = NO_TICK) -> None:
            logged = [row[0] for row in msgpack.Unpacker(io.BytesIO(log.read_bytes()))]
            assert logged == list(range(1, tick.epoch + 1))
            done.append(("act", tick.epoch))

    runner = alone(Acting(), 2, Seen(False), Seen(True), states=Log(log))
    runner.finish()
    runner.observers.close()
    assert [each for each in done if each[0] != "other"] == [("prompt", 1), ("act", 1), ("prompt", 2), ("act", 2)]
    assert [each for each in done if each[0] == "other"] == [("other", 1), ("other", 2)]
    assert done.index(("other", 1)) > done.index(("act", 1))


def test_an_epoch_whose_act_failed_is_not_committed() -> None:
    class Acting(Counter):
        def act(self, actions: Any) -> None:
            raise RuntimeError("the gripper is stuck")

    runner = alone(Acting(), 2)
    with pytest.raises(OperatorError, match=r"^w: act in epoch 1: RuntimeError: the gripper is stuck \("):
        runner.finish()
    assert pacemaker_of(runner).chain.epoch == 0


def test_what_is_refused_is_said_and_the_node_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    runner = alone(Counter(), 1)
    runner.finish()
    with caplog.at_level("INFO", logger="hierax"):
        runner.step(Message(Header(CONTEXT, "stranger", "w", 1, digest=bytes(32)), ()))
    assert [record.getMessage() for record in caplog.records] == [
        "w: refused a ctx message from stranger of epoch 1: not along an edge of this node"
    ]
    assert runner.engine.epoch == 1


class Faulty(Probe):
    """Raises in one of its operations."""

    def __init__(self, operation: str) -> None:
        self._operation = operation

    def record(self, step: Step) -> None:
        self._raise("record")

    def close(self) -> None:
        self._raise("close")

    def _raise(self, operation: str) -> None:
        if operation == self._operation:
            raise RuntimeError("disk full")


class Closing(Keeper):
    """Knows whether it was closed."""

    closed = False

    def close(self) -> None:
        self.closed = True


def test_a_probe_that_raises_is_named_with_its_epoch() -> None:
    runner = alone(Counter(), 3, Faulty("record"))
    with pytest.raises(ProbeError, match=r"^w: record in epoch 1 of its probe Faulty: RuntimeError: disk full$"):
        runner.finish()


def test_a_probe_that_does_not_close_keeps_no_other_from_it(tmp_path: Path) -> None:
    probes = (Closing(), Faulty("close"), Closing())
    runner = alone(Counter(), 1, *probes, states=Log(tmp_path / "states" / "w.msgpack"))
    runner.finish()
    with pytest.raises(ProbeError, match=r"^w: close of its probe Faulty: RuntimeError: disk full$"):
        runner.observers.close()
    assert [probe.closed for probe in probes if isinstance(probe, Closing)] == [True, True]
    assert (tmp_path / "states" / "w.msgpack").stat().st_size > 0


@pytest.mark.parametrize(
    ("metrics", "what"),
    [
        (None, "AttributeError"),
        ({"error": "much"}, "expected a number as 'error', got 'much'$"),
        ({3: 1.0}, "expected figures by name, 3 is no string"),
    ],
)
def test_metrics_that_are_no_figures_by_name_are_the_nodes_fault(metrics: Any, what: str) -> None:
    class Wrong(Counter):
        def metrics(self, belief: Value) -> dict[str, float]:
            return metrics  # type: ignore[no-any-return]

    runner = alone(Wrong(), 2)
    runner.finish()
    with pytest.raises(OperatorError, match=rf"^w: metrics in epoch 2: .*{what}"):
        runner.report()


def test_a_world_that_cannot_tell_whether_it_has_finished_is_named() -> None:
    class Unsure(Counter):
        def finished(self, belief: Value) -> bool:
            raise RuntimeError("no idea")

    with pytest.raises(OperatorError, match=r"^w: finished in epoch 0: RuntimeError: no idea \(.*, in finished\)$"):
        alone(Unsure(), None).finish()


def exits(*_: Any) -> Any:
    raise SystemExit(0)


@pytest.mark.parametrize("method", ["finished", "time_s"])
def test_a_world_that_exits_fails(method: str) -> None:
    world = type("Leaving", (Counter,), {method: exits})()
    with pytest.raises(OperatorError, match=rf"^w: {method} in epoch \d: SystemExit: 0 \(.*, in exits\)$"):
        alone(world, None).finish()


def test_a_node_that_exits_when_it_is_asked_for_policies_or_figures_fails() -> None:
    with pytest.raises(HierarchyError, match=r"^w: policies raised SystemExit: 0 \(.*, in exits\)$"):
        alone(type("Leaving", (Counter,), {"policies": exits})(), 1)
    runner = alone(type("Leaving", (Counter,), {"metrics": exits})(), 1)
    runner.finish()
    with pytest.raises(OperatorError, match=r"^w: metrics in epoch 1: SystemExit: 0 \(.*, in exits\)$"):
        runner.report()


def test_a_node_that_exits_when_it_takes_over_refuses_that() -> None:
    node = BoundNode("w", type("Leaving", (Counter,), {"take_over": exits})(), (), (), OperatorSetting())
    with pytest.raises(HieraxError, match=r"^its take_over exits: 0$"):
        taken_over(node, encode_state(0, "default", ()))


@pytest.mark.parametrize("method", ["record", "close"])
def test_a_probe_that_exits_fails(method: str) -> None:
    runner = alone(Counter(), 1, type("Leaving", (Closing,), {method: exits})())
    finish = runner.finish if method == "record" else runner.observers.close
    with pytest.raises(ProbeError, match=rf"^w: {method}( in epoch 1)? of its probe Leaving: SystemExit: 0$"):
        finish()


def test_an_operator_that_exits_fails() -> None:
    class Exiting(Counter):
        def predict(self, context: Any, actions: Any, belief: Value) -> Value:
            raise SystemExit(4)

    with pytest.raises(OperatorError, match=r"^w: predict in epoch 1: SystemExit: 4 \(\S+\.py:\d+, in predict\)$"):
        alone(Exiting(), 1).finish()


@pytest.mark.parametrize(("given", "what"), [(None, "must give a mapping"), (KeyError("camera"), "raised KeyError")])
def test_policies_that_cannot_be_had_are_the_nodes_fault(given: Any, what: str) -> None:
    class Lost(MixingNode):
        def policies(self) -> Mapping[str, Any]:
            if isinstance(given, Exception):
                raise given
            return given  # type: ignore[no-any-return]

    with pytest.raises(HierarchyError, match=rf"^n: policies {what}"):
        BoundNode("n", Lost("n"), ("w",), (), OperatorSetting())


def test_a_log_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "states").write_text("no folder")
    with pytest.raises(HieraxError, match=r"states/n\.msgpack: cannot be written: "):
        Log(tmp_path / "states" / "n.msgpack")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_log_on_a_full_disk_is_named(tmp_path: Path) -> None:
    log = Log(tmp_path / "full")
    with open("/dev/full", "wb") as full:
        os.dup2(full.fileno(), log._file.fileno())
    log.write(1, bytes(10))
    with pytest.raises(HieraxError, match="full: cannot be written: No space left"):
        log.close()
