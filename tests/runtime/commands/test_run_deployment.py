from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.deployments import write

from hierax.runtime.commands.main import main
from hierax.runtime.commands.options import Format, RunOptions
from hierax.runtime.commands.run_deployment import run_deployment
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import Deployment, DeploymentError
from hierax.runtime.execution.output_folder import SUMMARY
from hierax.runtime.execution.report import NodeReport, Report


class FakeRunner:
    """Commits three epochs, or fails; keeps what it was called with."""

    def __init__(self, failure: HieraxError | None = None) -> None:
        self.failure = failure
        self.called: dict[str, Any] = {}

    def __call__(
        self, deployment: Deployment, *, progress: Callable[[int, bytes], None] | None, **options: Any
    ) -> Report:
        self.called = {"progress": progress, **options}
        if self.failure is not None:
            raise self.failure
        for epoch in (1, 2, 3):
            if progress is not None:
                progress(epoch, bytes(32))
        nodes = {"world": NodeReport(float("nan"), "default", (), {"count": 3.0})}
        return Report(deployment.name, "fake", options["seed"], 3, bytes(32).hex(), 0.1, [0.01], nodes, start_s=0.5)


def run(runner: FakeRunner, path: Path, **options: Any) -> int:
    given = RunOptions(**{"output_format": Format.json, **options})
    return run_deployment(runner, str(path), given)


def test_options_reach_the_runner(tmp_path: Path) -> None:
    runner = FakeRunner()
    assert run(runner, write(tmp_path), epochs=9, seed=4) == 0
    assert runner.called == {"epochs": 9, "seed": 4, "output": None, "progress": None}


def test_the_files_number_of_epochs_is_the_default(tmp_path: Path) -> None:
    runner = FakeRunner()
    run(runner, write(tmp_path))
    assert runner.called["epochs"] == 3


def test_json_is_all_that_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(FakeRunner(), write(tmp_path), seed=4)
    out, err = capsys.readouterr()
    assert err == ""
    result = json.loads(out)
    assert list(result) == ["hierarchy", "mode", "epochs", "seed", "digest", "wall_s", "epoch_us", "nodes"]
    assert result["nodes"]["world"] == {
        "belief": "NaN",
        "policy": "default",
        "actions": [],
        "metrics": {"count": 3.0},
    }


def test_the_output_folder_is_made_and_has_a_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "a" / "b"
    runner = FakeRunner()
    run(runner, write(tmp_path), output=output)
    assert runner.called["output"] == output
    summary = json.loads((output / SUMMARY).read_text())
    assert summary == {**json.loads(capsys.readouterr().out), "start_s": 0.5}


def test_an_output_folder_that_cannot_be_made(tmp_path: Path) -> None:
    path = write(tmp_path)
    with pytest.raises(HieraxError, match=r"--output .*: it cannot be made or written: Not a directory"):
        run(FakeRunner(), path, output=path / "sub")


def test_a_failure_with_a_path_in_the_roster_gets_its_line(tmp_path: Path) -> None:
    class LostError(HieraxError):
        where = "nodes.left.class"

    path = write(tmp_path)
    with pytest.raises(DeploymentError) as caught:
        run(FakeRunner(LostError("nodes.left.class: there is no module 'x'")), path)
    assert str(caught.value) == f"{path}:13: nodes.left.class: there is no module 'x'"


def test_progress_is_shown_on_a_terminal_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    runner = FakeRunner()
    run(runner, write(tmp_path))
    assert runner.called["progress"] is not None
    assert "3/3" in terminal.getvalue()


def test_a_real_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path))
    output = tmp_path / "out"
    assert main(["run", path, "--epochs", "2", "--seed", "3", "--format", "json", "--output", str(output)]) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["hierarchy"], first["mode"], first["epochs"], first["seed"]) == ("toys", "run", 2, 3)
    assert first["nodes"]["world"] == {"belief": 4, "policy": "default", "actions": [], "metrics": {"count": 4.0}}
    assert json.loads((output / "summary.json").read_text()) == first
    assert main(["run", path, "--epochs", "2", "--seed", "3", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["digest"] == first["digest"]


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_that_fails_before_its_first_epoch_replaces_nothing_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap", reason="the extra [record] is not installed")
    places = ("--record", str(tmp_path / "a.mcap"), "--output", str(tmp_path / "out"))
    wrong = ("run", "servo", "--epochs", "3", *places, "--set", "noise=abc")
    assert main([*wrong]) == 1
    assert not list(tmp_path.iterdir())
    assert main(["run", "servo", "--epochs", "3", *places]) == 0  # which nothing is in the way of
    before = contents(tmp_path)
    capsys.readouterr()
    assert main([*wrong, "--overwrite"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert contents(tmp_path) == before
    assert main(["run", "servo", "--epochs", "2", *places, "--overwrite"]) == 0
    assert contents(tmp_path).keys() == before.keys()
    assert contents(tmp_path) != before


def test_a_run_until_the_world_has_finished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path))
    assert (
        main(["run", path, "--set", "epochs=null", "--set", "nodes.world.parameters.last=10", "--format", "json"]) == 0
    )
    assert json.loads(capsys.readouterr().out)["epochs"] == 5


def test_a_node_that_fails_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(write(tmp_path)), "--set", "nodes.left.class=support.toy_nodes:Failing"]) == 1
    err = capsys.readouterr().err
    told = r"error: left: observe in epoch 1: RuntimeError: the camera is gone \(\S+toy_nodes\.py:\d+, in observe\)\n"
    assert re.fullmatch(told, err)


def test_a_change_beyond_the_last_epoch_is_told_of(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "servo", "--epochs", "3", "--at", "2:detach:motion"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["run", "servo", "--epochs", "3", "--at", "999:detach:motion"]) == 0
    said = "hierax: --at: the run ended before epoch 999: what was to change there is not made\n"
    assert capsys.readouterr().err == said
