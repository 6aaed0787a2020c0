"""A signal ends a run: what was committed until then is reported as a run of so many epochs reports it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import msgpack
import pytest
from support.launched import Command, Launched, until

from hierax.runtime.commands.main import main
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run as run_here

ENDLESS = ("--epochs", "10000000")
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]

STUCK = """\
hierarchy: two
world: clock
nodes:
  clock: {class: "support.slow_nodes:Clock"}
  node: {class: "support.slow_nodes:Stuck", parameters: {epoch: 50}}
edges:
  clock -> node: {sense: "support.slow_nodes:number"}
"""


def reported(command: Command, number: signal.Signals) -> dict[str, Any]:
    """What a command says that a signal ends."""
    os.kill(command.process.pid, number)
    out = command.end()
    assert command.process.returncode == 130, command.err
    assert "Traceback" not in command.err
    assert command.said[-1][1] == "interrupted"
    assert out, command.err
    return dict(json.loads(out))


def wanted(epochs: int, deployment: str = "servo", *settings: str) -> Any:
    """What a run of so many epochs reports."""
    return run_here(read_deployment(deployment, settings), epochs=epochs, seed=0).plain()


def same(report: dict[str, Any], deployment: str = "servo", *settings: str) -> None:
    """It is what a run of so many epochs reports."""
    assert report["interrupted"] is True
    assert report["unreported"] == []
    run = wanted(report["epochs"], deployment, *settings)
    assert report["digest"] == run["digest"]
    assert report["nodes"] == run["nodes"]


def checked(recording: Path, epochs: int | None, capsys: pytest.CaptureFixture[str]) -> None:
    """A recording is whole, and has so many epochs; None: there is none."""
    if epochs is not None:
        assert main(["check", str(recording), "--format", "json"]) == 0
        assert json.loads(capsys.readouterr().out)["epochs"] == epochs


@pytest.mark.parametrize("number", SIGNALS)
def test_a_launch_reports_what_was_committed(
    tmp_path: Path, number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "run.mcap"
    record = ("--record", str(recording)) if number is signal.SIGINT else ()
    with Launched(tmp_path, "servo", *ENDLESS, *record) as launch:
        launch.until_epoch(20)
        report = reported(launch, number)
        assert json.loads((launch.output / "summary.json").read_text())["digest"] == report["digest"]
        assert launch.written[report["epochs"]].hex() == report["digest"]
    same(report)
    checked(recording, report["epochs"] if record else None, capsys)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_run_in_one_process_does(tmp_path: Path, number: signal.Signals, capsys: pytest.CaptureFixture[str]) -> None:
    output, recording = tmp_path / "output", tmp_path / "run.mcap"
    options = ("--output", str(output), "--record", str(recording), "--format", "json")
    with Command(tmp_path, "run", "servo", *ENDLESS, *options) as run:
        until(lambda: output.exists() and (output / "digests.msgpack").exists(), "it is under way")
        until(lambda: (output / "digests.msgpack").stat().st_size > 5000, "some epochs")
        report = reported(run, number)
    assert json.loads((output / "summary.json").read_text()) == report
    same(report)
    checked(recording, report["epochs"], capsys)


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_epochs_that_overlap_end_with_a_drained_one(tmp_path: Path, mode: str) -> None:
    delays = tuple(f"edges.{edge}.delay=1" for edge in ("world -> camera", "camera -> motion"))
    settings = (argument for setting in delays for argument in ("--set", setting))
    with Command(
        tmp_path, mode, "servo", *settings, *ENDLESS, "--output", str(tmp_path / "o"), "--format", "json"
    ) as run:
        digests = tmp_path / "o" / "digests.msgpack"
        until(lambda: digests.exists() and digests.stat().st_size > 5000, "some epochs")
        report = reported(run, signal.SIGINT)
    same(report, "servo", *delays)


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_of_an_epoch_that_hangs_nothing_is_reported(tmp_path: Path, mode: str) -> None:
    file = tmp_path / "two.yaml"
    file.write_text(STUCK)
    with Command(tmp_path, mode, str(file), *ENDLESS, "--format", "json") as run:
        run.until_said("stuck")
        report = reported(run, signal.SIGINT)
        told = "its process did not answer; its checkpoint tells its state, and no metrics" in run.err
        assert told is (mode == "launch")
    assert report["epochs"] == 49
    same(report, str(file))


def test_a_world_that_is_stopped_is_reported_by_its_record(tmp_path: Path) -> None:
    with Launched(tmp_path, "servo", *ENDLESS) as launch:
        launch.until_epoch(20)
        os.kill(launch.until_pid("world"), signal.SIGSTOP)
        written = list(launch.written.items())[:-1]  # as where it is stopped after its record, and before that
        (launch.output / "digests.msgpack").write_bytes(b"".join(map(msgpack.packb, written)))
        report = reported(launch, signal.SIGINT)
        assert launch.written[report["epochs"]].hex() == report["digest"]
    assert report["nodes"].pop("world")["metrics"] == {}
    run = wanted(report["epochs"])
    assert report["digest"] == run["digest"]
    del run["nodes"]["world"]
    assert report["nodes"] == run["nodes"]


def test_a_node_that_has_just_died_has_its_part_in_the_report(tmp_path: Path) -> None:
    with Launched(tmp_path, "servo", *ENDLESS, "--set", "restart.restart_delay=60") as launch:
        launch.until_epoch(20)
        launch.kill("camera")
        launch.until_said("it is started again")
        launch.kill("camera")
        until(lambda: launch.err.count("it is started again") == 2, "it is waited for")
        report = reported(launch, signal.SIGTERM)
    run = wanted(report["epochs"])
    assert report["digest"] == run["digest"]
    assert set(report["nodes"]) == set(run["nodes"])
    assert report["nodes"]["camera"]["belief"] == run["nodes"]["camera"]["belief"]


def test_a_launch_that_has_only_just_begun_is_reported(tmp_path: Path) -> None:
    with Launched(tmp_path, "servo", *ENDLESS) as launch:
        launch.until_epoch(1)
        same(reported(launch, signal.SIGINT))


def test_what_was_broken_off_can_be_resumed(tmp_path: Path) -> None:
    with Launched(tmp_path, "servo", *ENDLESS) as launch:
        launch.until_epoch(20)
        report = reported(launch, signal.SIGINT)
    until_epoch = report["epochs"] + 30
    with Launched(tmp_path, "--resume", str(tmp_path / "state"), "--epochs", str(until_epoch)) as again:
        resumed = again.report()
    assert resumed["digest"] == wanted(until_epoch)["digest"]


@pytest.mark.parametrize("mode", ["run", "launch"])
def test_a_second_signal_ends_it_at_once(tmp_path: Path, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    file = tmp_path / "two.yaml"
    file.write_text(STUCK)
    with Command(tmp_path, mode, str(file), *ENDLESS) as run:
        run.until_said("stuck")
        os.kill(run.process.pid, signal.SIGINT)
        until(lambda: _is_caught(run.process.pid) or not run.running, "the first one is taken in")
        os.kill(run.process.pid, signal.SIGINT)
        assert run.end() == ""
        assert run.process.returncode == 130
        assert "Traceback" not in run.err
    left = [*tmp_path.glob("hierax-*"), *tmp_path.glob("hierax/*")]
    assert not left, "checkpoints, and what the launch is found by, go with it"


def _is_caught(pid: int) -> bool:
    """Whether no signal waits to be taken in."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except FileNotFoundError:
        return True
    waiting = [line.split()[1] for line in lines if line.startswith(("SigPnd", "ShdPnd"))]
    return not any(int(each, 16) for each in waiting)
