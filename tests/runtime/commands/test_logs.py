from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.deployments import write
from support.live import Live, Program, environment

from hierax.runtime.commands.main import main
from hierax.runtime.host.run_folder import begin_run
from hierax.runtime.watch.logs import LAUNCH_FILE, LaunchLog, open_log


@pytest.fixture
def logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A launch that is over, whose supervisor has said three things."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = begin_run("aaaa1111", {"pid": 2**22 - 1, "hierarchy": "toys"})
    log = LaunchLog(open_log(folder / "logs", LAUNCH_FILE), "aaaa1111", lambda: 5)
    for what in ("toys is launched", "arm: its process ended by signal SIGKILL"):
        log.write(what)
    log.close("the run is over")
    return "aaaa1111"


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    assert main(["logs", *arguments, "--format", "json"]) == 0
    return [json.loads(each) for each in capsys.readouterr().out.splitlines()]


def test_the_log_of_a_launch_that_is_over(logged: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert [each["message"] for each in shown(capsys)][1:] == [
        "arm: its process ended by signal SIGKILL",
        "the run is over",
    ]
    assert len(shown(capsys, "--run", logged, "--grep", "SIG(KILL|TERM)")) == 1
    for named in ("toys", "aaa"):
        assert len(shown(capsys, "--run", named)) == 3
    assert shown(capsys, "--level", "warning") == []
    assert len(shown(capsys, "--since", "1h", "--node", "launch", "-f")) == 3


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--run", "aaaa1112"], "--run: there is no log of a launch 'aaaa1112'; did you mean 'aaaa1111'?"),
        (["--run", "tosy"], "--run: there is no log of a launch 'tosy'; did you mean 'toys'?"),
        (["--node", "lunch"], "--node: there is no log of 'lunch' in run aaaa1111; did you mean 'launch'?"),
        (["--since", "soon"], "--since: expected how long ago"),
        (
            ["--since", "800000d"],
            "--since: expected how long ago, such as 10m, or a time such as 2030-01-02T03:04, got",
        ),
        (["--since", f"{'9' * 400}s"], "--since: expected how long ago"),
        (["--since", "0001-01-01T00:00+01:00"], "--since: expected how long ago"),
        (["--grep", "("], "--grep: '(' is no regular expression"),
    ],
)
def test_what_is_wrong_is_one_line(
    logged: str, capsys: pytest.CaptureFixture[str], arguments: list[str], what: str
) -> None:
    assert main(["logs", *arguments]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert what in said.err
    assert said.err.count("\n") == 1


def test_all_processes_of_a_launch_log(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    found = shown(capsys, "--run", live.run["run"])
    assert {each["node"] for each in found} == {"launch", "world", "low", "high"}
    assert {each["run"] for each in found} == {live.run["run"]}


def test_a_node_that_fails_leaves_its_traceback_and_following_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    failing = Program(
        ["launch", str(write(tmp_path)), "--set", "nodes.left.class=support.toy_nodes:Failing"], environment(tmp_path)
    )
    try:
        assert failing.ends() == 1
    finally:
        failing.kill()
    assert len([each for each in failing.err if "the camera is gone" in each]) == 1
    (entry,) = shown(capsys, "-f", "--level", "error")
    assert (entry["node"], entry["epoch"]) == ("left", 1)
    assert "RuntimeError: the camera is gone" in entry["exception"]
    last = shown(capsys, "--node", "launch")[-1]["message"]
    assert last.startswith("the run is broken off: left: observe in epoch 1: RuntimeError")
