from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from support.deployments import write
from support.live import Live, Program, environment

from hierax.runtime.commands.logs import Reader
from hierax.runtime.commands.main import main
from hierax.runtime.host.run_folder import LOGS, begin_run
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


@pytest.fixture
def arm_log(tmp_path: Path) -> Path:
    """The file of a node's log in a folder that `Reader` reads; it is not there yet."""
    (tmp_path / LOGS).mkdir()
    return tmp_path / LOGS / "arm.jsonl"


def lines(*messages: str, minute: int = 0) -> bytes:
    return b"".join(
        json.dumps({"time": f"2030-01-02T03:{minute:02}:04.5Z", "message": each}).encode() + b"\n" for each in messages
    )


def read(reader: Reader) -> list[str]:
    return [each["message"] for each in reader.read()]


def test_a_log_that_is_put_aside_is_read_on(tmp_path: Path, arm_log: Path) -> None:
    reader = Reader(tmp_path)
    arm_log.write_bytes(lines("1", "2"))
    assert read(reader) == ["1", "2"]
    with arm_log.open("ab") as file:
        file.write(lines("3"))
    arm_log.rename(f"{arm_log}.1")
    arm_log.write_bytes(lines("4", minute=1))
    assert read(reader) == ["3", "4"]
    assert read(reader) == []


@pytest.mark.parametrize("messages", [("5",), ("5", "6", "7", "8")], ids=["shorter", "longer"])
def test_a_new_log_in_the_place_of_an_old_one_is_read_from_its_beginning(
    tmp_path: Path, arm_log: Path, messages: tuple[str, ...]
) -> None:
    """The file that a log begins with after a rotation may be given the number of the file that is gone by it."""
    reader = Reader(tmp_path)
    arm_log.write_bytes(lines("1", "2", "3"))
    assert read(reader) == ["1", "2", "3"]
    number = arm_log.stat().st_ino
    arm_log.write_bytes(lines(*messages, minute=1))
    assert arm_log.stat().st_ino == number
    assert read(reader) == list(messages)
    with arm_log.open("ab") as file:
        file.write(lines("9"))
    assert read(reader) == ["9"]


def test_all_is_read_once_however_often_a_log_is_put_aside(
    tmp_path: Path, arm_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hierax.runtime.watch.logs.MAX_BYTES", 1000)
    reader, log = Reader(tmp_path), LaunchLog(open_log(arm_log.parent, "arm"), "aaaa1111", lambda: 5)
    found = []
    for number in range(100):
        log.write(str(number))
        found += read(reader)
    log.close()
    assert found == [str(number) for number in range(100)]


def test_of_a_log_that_is_gone_nothing_is_kept(tmp_path: Path, arm_log: Path) -> None:
    """But for one look, as a file that is put aside meanwhile may be found under neither of its names."""
    reader, elsewhere = Reader(tmp_path), tmp_path / "elsewhere"
    arm_log.write_bytes(lines("1"))
    assert read(reader) == ["1"]
    for looks, found in ((1, []), (2, ["1"])):
        arm_log.rename(elsewhere)
        for _ in range(looks):
            assert read(reader) == []
        elsewhere.rename(arm_log)
        assert read(reader) == found


@pytest.mark.parametrize("zone", ["UTC", "XXX+11", "XXX-11"])
@pytest.mark.parametrize(
    "when", ["0001-01-01T00:00:00+14:00", "0001-01-01T01:00:00Z", "9999-12-31T23:59:59-14:00", "-"]
)
def test_a_time_that_is_none_ends_nothing(
    logged: str, when: str, zone: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = next(Path(os.environ["XDG_STATE_HOME"]).rglob(f"{LAUNCH_FILE}.jsonl"))
    with path.open("ab") as file:
        file.write(json.dumps({"time": when, "message": "damaged"}).encode() + b"\n")
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        assert len(shown(capsys, "--run", logged)) == 4
        assert main(["logs", "--run", logged]) == 0
    finally:
        monkeypatch.delenv("TZ")
        time.tzset()
    assert "damaged" in capsys.readouterr().out
