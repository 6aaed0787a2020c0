"""Launches are recorded whole, with changes and deaths in them; what a killed recorder has written is there."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.live import Live, until

from hierax.runtime.recording.check import check_recording
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of

Start = Callable[..., Live]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    started: list[Live] = []

    def begin(*options: str) -> Live:
        started.append(Live(tmp_path, *options, pace_s=0.01))
        return started[-1]

    yield begin
    for launch in started:
        launch.close()


def is_repeated(recording: Recording) -> int:
    """That all whole epochs are alike in all results and digests; the last one's number."""
    first = recording.ending.first if recording.ending is not None else 1  # of the one before a digest may lack
    again = Replay(recording, allowance_of(recording), world=True, first=first)
    comparison = compare(recording.epochs(first), again.epochs())
    assert comparison.alike, comparison
    assert comparison.epochs == comparison.last - first + 1
    assert comparison.digests == comparison.epochs
    return comparison.last


def kill(live: Live, name: str) -> None:
    """Kill a node's process, and wait until another one has taken part."""
    node = live.run["nodes"][name]
    os.kill(node["pid"], signal.SIGKILL)
    until(lambda: live.run["nodes"].get(name, node)["instance"] != node["instance"], f"another process of {name}")
    live.goes_on()


def test_a_launch_is_recorded_with_changes_and_deaths(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    live = start("--record", str(file), "--check")
    attached = live.change("attach", live.snippet("top", "high"))
    kill(live, "low")
    replaced = live.change("replace", "high", live.snippet("high", generation=1))
    kill(live, "world")
    again = live.change("replace", "high", live.snippet("high", generation=1))  # by its like
    kill(live, "high")
    detached = live.change("detach", "top")
    live.goes_on()
    report = live.ends()
    recording = Recording.open(file)
    assert not recording.loss
    assert recording.ending is not None
    assert (recording.ending.first, recording.ending.last) == (1, report["epochs"])
    assert is_repeated(recording) == report["epochs"]
    assert check_recording(recording).violations == []
    assert recording.digests()[report["epochs"]].hex() == report["digest"]
    names = {epoch.epoch: set(epoch.roster.nodes) for epoch in recording.epochs()}
    assert "top" not in names[attached - 1]
    assert "top" in names[attached] & names[detached - 1]
    assert "top" not in names[detached]
    assert names.keys() == set(range(1, report["epochs"] + 1))
    assert attached < replaced < again
    said = [fault.what for fault in recording.faults()]
    assert sum("its process ended by signal SIGKILL" in what for what in said) == 3
    assert max(epoch.attempt for epoch in recording.epochs()) >= 1


def test_a_launch_is_recorded_from_the_middle_on(start: Start, tmp_path: Path) -> None:
    live = start()
    done = live.hierax("record", "lvie", "-o", "x.mcap")
    assert (done.returncode, done.stderr) == (1, "error: no launch 'lvie' runs on this machine; did you mean 'live'?\n")
    file = tmp_path / "part.mcap"
    recorder = live.start("record", "live", "-o", str(file), "--format", "json")
    recorder.says("recording live, run ")
    until(lambda: file.stat().st_size > 3000, "something recorded")
    kill(live, "low")
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.ends() == 0, recorder.err
    told = json.loads("".join(recorder.out))
    recording = Recording.open(file)
    assert recording.ending is not None
    assert (told["first"], told["last"]) == (recording.ending.first, recording.ending.last)
    assert told["first"] > 1
    assert is_repeated(recording) == told["last"]
    assert check_recording(recording).violations == []

    second = tmp_path / "second.mcap"
    done = live.hierax("record", "-o", str(second), "--epochs", "20", "--format", "json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["last"] - told["first"] == 19
    assert is_repeated(Recording.open(second)) == told["last"]
    live.goes_on()
    live.ends()


def test_whose_recorder_elsewhere_has_ended_waits_for_none_when_it_comes_back(start: Start, tmp_path: Path) -> None:
    """It may be late for its place in the run: a process waits 10 s for a recorder that does not come."""
    live = start("--set", "restart.on_loss=stop", "--set", "restart.rejoin_timeout=9")
    reaches = ("--connect", live.endpoint, "--key", str(live.key))
    done = live.hierax("record", *reaches, "-o", str(tmp_path / "part.mcap"), "--epochs", "5")
    assert done.returncode == 0, done.stderr
    kill(live, "low")
    live.ends()


def test_what_is_left_out_of_a_launch_is_said_and_the_rest_is_whole(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    live = start("--record", str(file), "--check", "--exclude", "obs/world/*", "--exclude", "steps/high")
    second = tmp_path / "part.mcap"
    done = live.hierax("record", "live", "-o", str(second), "--epochs", "20", "--exclude", "ctx/**", "--format", "json")
    assert done.returncode == 0, done.stderr
    kill(live, "low")
    report = live.ends()
    recording = Recording.open(file)
    assert recording.ending is not None
    assert recording.ending.last == report["epochs"] == len(recording.digests())
    left_out = dict(recording.ending.left_out)
    assert min(left_out["obs/world/*"], left_out["steps/high"]) >= report["epochs"]
    assert not list(recording.messages(node="world", kind="obs"))
    assert len(list(recording.messages(node="low", kind="obs"))) >= report["epochs"]
    assert "obs/world/*, steps/high was left out (--exclude)" in recording.loss
    part = Recording.open(second)
    assert part.ending is not None
    assert dict(part.ending.left_out)["ctx/**"] >= 40
    assert not list(part.messages(kind="ctx"))
    assert check_recording(part).violations == []


@pytest.mark.parametrize("most", [("--max-size", "60kB"), ("--max-duration", "0.3s")])
def test_a_recording_of_a_launch_ends_where_it_is_told_to(start: Start, tmp_path: Path, most: tuple[str, str]) -> None:
    file, second = tmp_path / "run.mcap", tmp_path / "part.mcap"
    live = start("--record", str(file), *most)
    done = live.hierax("record", "live", "-o", str(second), *most, "--format", "json")  # ends by itself
    assert done.returncode == 0, done.stderr
    live.goes_on()
    kill(live, "low")
    report = live.ends()
    assert any(f"({' '.join(most)[:12]}" in line for line in live.launch.err), live.launch.err
    for recording in (Recording.open(file), Recording.open(second)):
        ending = recording.ending
        assert ending is not None
        assert ending.first <= ending.last < report["epochs"]
        assert most[0] in recording.loss
        assert is_repeated(recording) == ending.last
        assert all(not epoch.lacking for epoch in recording.epochs(ending.first))  # before it was not whole yet
        if most[0] == "--max-size":
            assert recording.path.stat().st_size <= 60_000


def test_the_run_survives_its_recorder_and_says_so(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    live = start("--record", str(file))
    until(lambda: file.stat().st_size > 20_000, "something recorded")
    os.kill(_recorder_of(live.launch.process.pid), signal.SIGKILL)
    live.launch.says("the recorder's process ended by signal SIGKILL; the run goes on")
    live.goes_on()
    (tmp_path / "stop").touch()
    assert live.launch.ends() == 1
    (tmp_path / "stop").unlink()
    assert live.launch.err[-1] == "error: the recorder's process ended by signal SIGKILL\n"
    recording = Recording.open(file)
    assert "it was cut off" in recording.loss
    complete = [epoch.epoch for epoch in recording.epochs() if not epoch.lacking]
    assert complete == list(range(1, len(complete) + 1))
    assert len(complete) > 20
    assert compare(
        recording.epochs(last=complete[-1]), Replay(recording, allowance_of(recording), last=complete[-1]).epochs()
    ).alike


def _recorder_of(supervisor: int) -> int:
    """The process that records."""
    out = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(supervisor)], capture_output=True, text=True, check=True
    )
    (line,) = [line for line in out.stdout.splitlines() if "hierax.runtime.recording.live_recording" in line]
    return int(line.split()[0])
