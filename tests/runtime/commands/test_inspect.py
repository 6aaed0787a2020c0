from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from support.live import Live

from hierax.runtime.commands import inspect as inspecting
from hierax.runtime.commands.inspect import as_json
from hierax.runtime.commands.main import main
from hierax.runtime.commands.which_launch import Meant
from hierax.runtime.core.node import Node
from hierax.runtime.core.probe import Step
from hierax.runtime.core.showing import Box, Curve, Things
from hierax.runtime.transport.launch_client import LaunchStatus
from hierax.runtime.viewing.recorded_run import Look


class Telling(Node):
    def initial_belief(self) -> Any:
        return 0.0

    def show(self, step: Step, before: Any) -> Things:
        return {
            "why": f"from {before} to {step.belief}",
            "level/a": Curve(step.belief),
            "level/b": step.sensed,
            "/scene/box": Box([1.0, 1.0, 1.0]),
        }


def test_a_node_as_json_says_what_it_believes_and_why(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "low", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["hierarchy"], told["node"], told["below"], told["above"]) == ("live", "low", ["world"], ["high"])
    assert told["class"] == "hierax.runtime.sim.nodes:Drawer"
    assert told["epoch"] > 0
    assert told["policy"] in told["policies"]
    assert {"observations", "sensed", "tasks", "context", "actions", "belief", "committed"} <= told.keys()
    assert not {"process", "before"} & told.keys()
    assert told["shows"] == {}


def test_it_is_what_the_run_in_one_process_has_in_that_epoch(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "high", "--format", "json", "--full"]) == 0
    told = json.loads(capsys.readouterr().out)
    (live.folder / "stop").unlink(missing_ok=True)
    node = live.repeated(told["epoch"])["nodes"]["high"]
    assert {key: told[key] for key in ("belief", "policy", "actions")} == {
        key: node[key] for key in ("belief", "policy", "actions")
    }


def test_a_node_as_text(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "world"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"world of live, run {live.run['run']}: after epoch ")
    assert lines[2:4] == ["below  nothing", "above  low"]
    assert any(line.startswith("belief") for line in lines)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> str:
    pytest.importorskip("mcap", reason="the extra [record] is not installed")
    path = tmp_path_factory.mktemp("recorded") / "servo.mcap"
    assert main(["run", "servo", "--epochs", "6", "--seed", "5", "--record", str(path)]) == 0
    return str(path)


@pytest.mark.parametrize(("options", "epoch"), [([], 6), (["--epoch", "4"], 4), (["--epoch", "1"], 1)])
def test_a_node_of_a_recording(
    recorded: str, options: list[str], epoch: int, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["inspect", "camera", recorded, *options, "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["hierarchy"], told["class"], told["epoch"]) == ("servo", "hierax.nodes.servo:CameraNode", epoch)
    assert (told["below"], told["above"]) == (["world"], ["motion"])
    shown = told["shows"]["position_m"]
    assert shown.keys() == {"seen", "believed"}
    assert main(["inspect", "camera", recorded, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith(f"after epoch {epoch} (committed)")
    assert f"shows position_m  {{seen: {shown['seen']:.6g}, believed: {shown['believed']:.6g}}}" in lines


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["camrea", "FILE"], "FILE: there is no node 'camrea' in it; did you mean 'camera'?"),
        (
            ["camera", "FILE", "--epoch", "7"],
            "FILE: what camera did in epoch 7 is not in it; it took part in epoch 6 last before that",
        ),
        (["camera", "FILE", "--run", "a"], "give a recording, or say which launch is meant: not both"),
        (["camera", "--epoch", "7"], "--epoch and --trust are for recordings"),
    ],
)
def test_what_is_not_in_a_recording(
    recorded: str, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["inspect", *(recorded if each == "FILE" else each for each in arguments)]) == 1
    assert capsys.readouterr().err == f"error: {said.replace('FILE', recorded)}\n"


def test_what_a_node_shows_is_told_with_the_belief_that_the_epoch_began_in() -> None:
    node, step = Telling(), Step(1, 0, 0.0, (), 1.0, (), (), "default", (), 2.0)
    assert Look("arm", node, step, 7.0).told() == {"why": {"why": "from 7.0 to 2.0"}, "level": {"a": 2.0, "b": 1.0}}


def test_a_node_that_there_is_not(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "hihg"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"error: there is no node 'hihg' in live, run {live.run['run']}; did you mean 'high'?\n"


MOVES = "\x1b]0;owned\x07\x1b[2J\n"


class Foreign:
    """A launch whose node says what moves the cursor."""

    def __init__(self, belief: Any) -> None:
        self._belief = belief

    def __enter__(self) -> Foreign:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def status(self) -> LaunchStatus:
        return LaunchStatus("toys", "5163af85", 3, 0, {"arm": {"process": "a", "state": "running"}})

    def node_state(self, status: LaunchStatus, name: str) -> dict[str, Any]:
        step = Step(3, 0, 0.0, (), 1.0, (), (), MOVES, (), self._belief)._asdict()
        about = {"class": f"a:{MOVES}", "below": [], "above": [], "committed": True, "policies": [MOVES]}
        return {**about, **step, "before": None}


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspecting, "launch_meant", lambda *_: Meant("tcp/127.0.0.1:1"))
    monkeypatch.setattr(inspecting, "client_at", lambda _: Foreign({MOVES: MOVES, "long": ["x" * 90] * 2}))
    shown = {MOVES: {MOVES: math.nan, "text": f"two\nlines {MOVES}"}}
    monkeypatch.setattr(inspecting, "_told", lambda *_: shown)


def test_what_a_node_says_moves_no_cursor(foreign: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "arm"]) == 0
    out = capsys.readouterr().out
    assert all(line.isprintable() for line in out.splitlines())
    written = r"\x1b]0;owned\x07\x1b[2J"
    assert rf"class  a:{written}\n" in out.splitlines()
    assert rf"policy  {written}\n (of {written}\n)" in out.splitlines()
    assert out.endswith(f"\ntwo\nlines {written}\n\n")


def test_a_figure_that_is_none_is_json(foreign: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", "arm", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["shows"][MOVES][MOVES] == "NaN"


@pytest.mark.parametrize(("full", "shown"), [(True, list), (False, dict)])
def test_arrays_are_summarised_unless_all_is_wanted(full: bool, shown: type) -> None:
    answer: dict[str, Any] = {"process": "a", "belief": np.zeros(100)}
    told = as_json("toys", "aa", "arm", answer, full)
    assert isinstance(told["belief"], shown)
    json.dumps(told, allow_nan=False)
