from __future__ import annotations

import os
import signal
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, cast

import pytest
from support.canvas import KeptCanvas
from support.deployments import write
from support.launched import Command, until
from support.pace import paced

from hierax.runtime.core.showing import Graph
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.launch.run_file import known_runs
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus
from hierax.runtime.viewing.live import MOST_EPOCHS_PER_S, show_launch, shown_every
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.watch.watcher import Stepper
from hierax.schemas.keys import STEP, Keys
from hierax.schemas.values import encode_value

SNIPPET = """\
nodes:
  second: {class: "hierax.nodes.servo:MotionNode"}
edges:
  camera -> second: {sense: "hierax.nodes.servo:position"}
"""


def test_a_quick_launch_is_not_shown_in_every_epoch() -> None:
    assert shown_every(round(2 * 7.5 * MOST_EPOCHS_PER_S), took_s=2.0) == 8
    assert shown_every(0, took_s=0.0) == 1


def test_a_launch_is_seen_until_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    canvas = KeptCanvas()
    attached: list[Command] = []

    def whole(*nodes: str) -> int:
        """Epochs that are shown of all these nodes."""
        wanted = {"hierarchy", "epochs/took_ms", *(f"{node}/belief" for node in nodes)}
        return sum(wanted <= things.keys() for things in canvas.drawn.values())

    def over() -> bool:
        """Attach a node, and when that is seen end the launch."""
        assert launch.process.poll() is None or attached, launch.err
        if not attached and whole("world", "camera", "motion") >= 5:
            attached.append(Command(tmp_path, "attach", str(write(tmp_path, SNIPPET, "second.yaml"))))
        if whole("world", "camera", "motion", "second") >= 3 and launch.process.poll() is None:
            attached[0].end()  # else the launch may be gone before it has answered
            os.kill(launch.process.pid, signal.SIGINT)
            launch.end()
        return False

    with Command(tmp_path, "launch", paced(tmp_path, "servo"), "--epochs", "10000000") as launch:
        until(lambda: bool(known_runs()), "the launch runs")
        with LaunchClient(known_runs()[0].endpoint, secret=known_runs()[0].secret) as client:
            assert show_launch(client, ViewPresenter(canvas), Allowance(("hierax.nodes.servo",)), over) > 15
        assert attached[0].process.returncode == 0, attached[0].err
        last = max(epoch for epoch, things in canvas.drawn.items() if "velocity_m_s/second/believed" in things)
        graph = canvas.drawn[last]["hierarchy"].thing
        assert isinstance(graph, Graph)
        assert set(graph.nodes) == {"world", "camera", "motion", "second"}
        assert launch.process.returncode == 130, launch.err
        assert canvas.layouts


class Shown:
    """A launch which shows these steps, each on the key with these names."""

    def __init__(self, deployment: Deployment, steps: Collection[tuple[str, str, bytes]]) -> None:
        self._deployment, self._steps = deployment, steps

    def keys(self) -> Keys:
        return Keys(self._deployment.name, "5f")

    def status(self) -> LaunchStatus:
        return LaunchStatus(self._deployment.name, "5f", 1, 0, {name: {} for name in self._deployment.roster.nodes})

    def ask_nodes(self, status: LaunchStatus, question: Any, names: Collection[str]) -> dict[str, Any]:
        return {self._deployment.roster.world: {"roster": self._deployment.roster.plain()}}

    def listen(self, key: str, heard: Callable[[str, bytes], None]) -> None:
        for sender, receiver, data in self._steps:
            heard(self.keys().seen(STEP, sender, receiver), data)


def test_a_step_is_of_who_shows_it_and_junk_is_not_shown(caplog: pytest.LogCaptureFixture) -> None:
    deployment = read_deployment("servo")
    steppers: dict[str, Stepper] = {}

    def watch(name: str, runner: Any) -> None:
        runner.watch(steppers.setdefault(name, Stepper()))

    single.run(deployment, epochs=3, seed=0, watch=watch)
    steps = [(name, name, data) for name, stepper in steppers.items() for data in stepper.take()]
    of_motion = [data for name, _, data in steps if name == "motion"]

    def drawn(steps: Collection[tuple[str, str, bytes]]) -> dict[int, Any]:
        canvas, allowance = KeptCanvas(), Allowance(("hierax.nodes.*",))
        show_launch(cast("LaunchClient", Shown(deployment, steps)), ViewPresenter(canvas), allowance, lambda: True)
        return canvas.plain()

    expected = drawn(steps)
    assert any("camera/belief" in things for things in expected.values())
    assert drawn([*steps, *(("motion", "camera", data) for data in of_motion)]) == expected
    assert not caplog.messages
    junk = [b"junk", b"", encode_value({"done_ns": 1, "epoch": 3})]
    assert drawn([*steps, *(("motion", "motion", data) for data in junk)]) == expected
    (warning,) = caplog.messages
    assert warning.startswith("motion: not shown, as all else that is no step: ")
