"""What is attached fails alone in `run --at`, as it does in a launch: the run is that in which it is detached there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.live import DEPLOYMENT

from hierax.runtime.commands.main import main

MIX = "hierax.runtime.sim.nodes:Mix"
FAILING_MIX = "support.failing_nodes:FailingMix"

SNIPPET = """\
nodes:
  top: {{class: "support.failing_nodes:Failing", parameters: {{name: top, operator: {operator}, epoch: {at}}}{policy}}}
edges:
  {lower} -> top:
    sense: {{function: "{sense}", parameters: {{name: a{epoch[sense]}}}}}
    task: {{function: "{task}", parameters: {{name: b{epoch[task]}}}}}
    context: {{function: "{context}", parameters: {{name: c{epoch[context]}}}}}
  top -> {upper}:
    sense: {{function: "{up_sense}", parameters: {{name: d{epoch[up_sense]}}}}}
    task: {{function: "{up_task}", parameters: {{name: e{epoch[up_task]}}}}}
    context: {{function: "{up_context}", parameters: {{name: f{epoch[up_context]}}}}}
"""
"""A node between two others; any operator and any edge function of it may fail."""

FUNCTIONS = ("sense", "task", "context", "up_sense", "up_task", "up_context")
OPERATORS = ("observe", "predict")


def snippet(folder: Path, fails: str = "", at: int = 1, *, lower: str = "world", policy: str = "") -> Path:
    """A snippet whose node fails at one place, from an epoch on; empty: nowhere."""
    path = folder / f"top-{fails}-{at}{len(policy)}.yaml"
    functions: dict[str, Any] = {name: FAILING_MIX if name == fails else MIX for name in FUNCTIONS}
    epochs = {name: f", epoch: {at}" if name == fails else "" for name in FUNCTIONS}
    operator = fails if fails in OPERATORS else "none"
    upper = "high" if lower != "high" else "other"
    text = SNIPPET.format(operator=operator, at=at, lower=lower, upper=upper, policy=policy, epoch=epochs, **functions)
    path.write_text(text)
    return path


def run(
    folder: Path, capsys: pytest.CaptureFixture[str], *at: str, settings: tuple[str, ...] = (), code: int = 0
) -> dict[str, Any]:
    """The report of a run of 12 epochs."""
    file = folder / "live.yaml"
    file.write_text(DEPLOYMENT.format(stop=folder / "stop"))
    options = [word for change in at for word in ("--at", change)]
    options += [word for each in settings for word in ("--set", each)]
    assert main(["run", str(file), "--epochs", "12", "--format", "json", *options]) == code
    said = capsys.readouterr()
    return dict(json.loads(said.out)) if not code else {"error": said.err}


@pytest.mark.parametrize("fails", [*OPERATORS, *FUNCTIONS])
def test_in_its_first_epoch_and_later(
    fails: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    undisturbed = run(tmp_path, capsys)
    at_once = run(tmp_path, capsys, f"5:attach:{snippet(tmp_path, fails)}")
    assert at_once["digest"] == undisturbed["digest"], "it was never there"
    assert at_once["nodes"] == undisturbed["nodes"]
    (line,) = [record.getMessage() for record in caplog.records]
    place = f"top: {fails}" if fails in OPERATORS else {"u": "top->high"}.get(fails[0], "world->top")
    assert line.startswith(place)
    assert "in epoch 5: RuntimeError: out of luck (" in line
    assert line.endswith("; top is detached (on_loss)")
    later = snippet(tmp_path, fails, 9)
    expected = run(tmp_path, capsys, f"5:attach:{later}", "9:detach:top")["digest"]
    assert run(tmp_path, capsys, f"5:attach:{later}")["digest"] == expected != undisturbed["digest"]


def replacement(folder: Path, fails: str, at: int, policy: str = "") -> Path:
    """What takes the place of `high`, below it `low` as ever: at one place it fails, from an epoch on."""
    path = folder / f"high-{fails}-{at}{len(policy)}.yaml"
    operator = fails if fails in OPERATORS else "none"
    parameters = f"name: high, operator: {operator}, epoch: {at}, generation: 1"
    text = f'nodes:\n  high: {{class: "support.failing_nodes:Failing", parameters: {{{parameters}}}{policy}}}\n'
    if fails not in OPERATORS:
        functions = {name: "MIX" if name != fails else "FAILING_MIX" for name in FUNCTIONS[:3]}
        epochs = {name: f", epoch: {at}" if name == fails else "" for name in FUNCTIONS}
        text += "edges:\n  low -> high:\n"
        for name, function in functions.items():
            text += f'    {name}: {{function: "{globals()[function]}", parameters: {{name: z{name}{epochs[name]}}}}}\n'
    path.write_text(text)
    return path


@pytest.mark.parametrize("policy", ["", ", on_loss: detach"])
@pytest.mark.parametrize("fails", [*OPERATORS, *FUNCTIONS[:3]])
def test_what_replaces_another_and_fails_at_once_is_undone(
    fails: str, policy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    undisturbed = run(tmp_path, capsys)
    undone = run(tmp_path, capsys, f"5:replace:high:{replacement(tmp_path, fails, 5, policy)}")
    assert undone["digest"] == undisturbed["digest"], "it was never there"
    assert undone["nodes"] == undisturbed["nodes"]
    (line,) = [record.getMessage() for record in caplog.records]
    assert " in epoch 5: RuntimeError: out of luck (" in line
    assert line.endswith("; what high has replaced goes on")


def test_what_replaces_another_and_fails_later_ends_the_run_or_is_detached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for fails in ("observe", "context"):
        change = f"5:replace:high:{replacement(tmp_path, fails, 6)}"
        failed = run(tmp_path, capsys, change, code=1)
        assert " in epoch 6: RuntimeError: out of luck" in failed["error"]
        alone = f"5:replace:high:{replacement(tmp_path, fails, 6, ', on_loss: detach')}"
        expected = run(tmp_path, capsys, alone, "6:detach:high")
        assert run(tmp_path, capsys, alone)["digest"] == expected["digest"]


@pytest.mark.parametrize("settings", [("staleness=1",), ("staleness=null",)])
def test_where_epochs_overlap_what_was_replaced_goes_on(
    settings: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for fails in ("observe", "sense", "context"):
        report = run(tmp_path, capsys, f"5:replace:high:{replacement(tmp_path, fails, 1)}", settings=settings)
        assert report["epochs"] == 12
        assert sorted(report["nodes"]) == ["high", "low", "world"]


def test_what_only_it_joins_to_the_world_goes_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = snippet(tmp_path, "observe", 7)
    further = tmp_path / "further.yaml"
    node = 'nodes: {further: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: f}}}\nedges:\n'
    further.write_text(f'{node}  top -> further: {{sense: {{function: "{MIX}", parameters: {{name: g}}}}}}\n')
    changes = [f"3:attach:{path}", f"4:attach:{further}"]
    expected = run(tmp_path, capsys, *changes, "7:detach:top:cascade")
    assert run(tmp_path, capsys, *changes)["digest"] == expected["digest"]


def test_of_an_edge_between_two_that_were_attached_the_later_one_has_brought_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = snippet(tmp_path)
    further = tmp_path / "further.yaml"
    node = 'nodes: {further: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: f}}}\nedges:\n'
    further.write_text(f'{node}  top -> further: {{sense: {{function: "{FAILING_MIX}", parameters: {{name: g}}}}}}\n')
    changes = [f"3:attach:{path}", f"4:attach:{further}"]
    assert run(tmp_path, capsys, *changes)["digest"] == run(tmp_path, capsys, changes[0])["digest"]


def test_a_detach_of_what_has_failed_meanwhile_is_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change = f"3:attach:{snippet(tmp_path, 'predict', 6)}"
    assert run(tmp_path, capsys, change, "9:detach:top")["digest"] == run(tmp_path, capsys, change)["digest"]


@pytest.mark.parametrize("policy", [", on_loss: stop", ", on_loss: restart", ", restart_policy: always"])
def test_a_file_that_says_otherwise_ends_the_run(
    policy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = run(tmp_path, capsys, f"5:attach:{snippet(tmp_path, 'sense', policy=policy)}", code=1)
    assert failed["error"].startswith("error: world->top: sense in epoch 5: RuntimeError: out of luck")


def test_so_does_the_deployment_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, capsys, f"5:attach:{snippet(tmp_path, 'sense')}", settings=("restart.on_loss=restart",), code=1)


def test_a_node_of_the_deployment_that_is_to_be_detached(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fails = ('nodes.high.class="support.failing_nodes:Failing"', "nodes.high.parameters={name: high, epoch: 4}")
    failed = run(tmp_path, capsys, settings=fails, code=1)
    assert "error: high: observe in epoch 4: RuntimeError: out of luck" in failed["error"]
    expected = run(tmp_path, capsys, "4:detach:high", settings=fails)
    alone = run(tmp_path, capsys, settings=(*fails, "nodes.high.on_loss=detach"))
    assert alone["digest"] == expected["digest"]


@pytest.mark.parametrize("settings", [("staleness=1",), ("staleness=null",)])
def test_where_epochs_overlap_the_run_goes_on(
    settings: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for fails in ("observe", "sense", "context"):
        report = run(tmp_path, capsys, f"5:attach:{snippet(tmp_path, fails, 7)}", settings=settings)
        assert report["epochs"] == 12
        assert sorted(report["nodes"]) == ["high", "low", "world"]
