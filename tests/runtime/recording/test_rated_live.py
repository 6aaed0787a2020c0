"""Launches with rates are recorded whole, and from the middle on, whatever changes and dies."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.live import Live, until

from hierax.runtime.recording.check import check_recording
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of

RATED = ("nodes.high.every=5", "nodes.high.offset=2", "edges.low -> high.delay=7", "edges.low -> high.gather=true")

Start = Callable[..., Live]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    started: list[Live] = []

    def begin(*options: str) -> Live:
        started.append(Live(tmp_path, *options, pace_s=0.01, settings=RATED))
        return started[-1]

    yield begin
    for launch in started:
        launch.close()


def is_repeated(recording: Recording) -> int:
    """That all whole epochs are alike in all results and digests, and in good order; the last one's number."""
    ending = recording.ending
    assert ending is not None
    assert not any(epoch.lacking for epoch in recording.epochs(ending.first))
    again = Replay(recording, allowance_of(recording), world=True, first=ending.first)
    comparison = compare(recording.epochs(ending.first), again.epochs())
    assert comparison.alike, comparison
    assert comparison.digests == comparison.epochs == comparison.last - ending.first + 1
    assert check_recording(recording).close() == []
    return comparison.last


def kill(live: Live, name: str) -> None:
    """Kill a node's process, and wait until another one is there."""
    node = live.run["nodes"][name]
    os.kill(node["pid"], signal.SIGKILL)
    until(lambda: live.run["nodes"].get(name, node)["instance"] != node["instance"], f"another process of {name}")
    live.goes_on()


def snippet(live: Live, turns: str, edge: str, *given: str, generation: int = 0) -> str:
    """A snippet with these rates of its node, and of its edge."""
    path = Path(live.snippet(*given, generation=generation))
    text = path.read_text().replace("{class:", f"{{{turns}, class:")
    path.write_text(text.replace("    context: {function", f"    {edge}\n    context: {{function"))
    return str(path)


def test_a_launch_is_recorded_with_changes_and_deaths(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    live = start("--record", str(file), "--check")
    live.change("attach", snippet(live, "every: 3", "delay: 4", "top", "high"))
    for name in ("low", "high"):
        kill(live, name)
    live.change("replace", "high", snippet(live, "every: 4", "", "high", generation=1))
    kill(live, "world")
    live.change("detach", "top")
    kill(live, "high")
    report = live.ends()
    recording = Recording.open(file)
    assert not recording.loss, recording.ending
    assert recording.ending is not None
    assert (recording.ending.first, recording.ending.last) == (1, report["epochs"])
    assert is_repeated(recording) == report["epochs"]
    assert recording.digests()[report["epochs"]].hex() == report["digest"]
    for words in (["replay", str(file), "--verify"], ["check", str(file)], ["replay", str(file), "--node", "low"]):
        done = live.hierax(*words)
        assert done.returncode == 0, done.stderr
    assert sum(gap.count for gap in recording.ending.cut_short) < 10


def test_a_launch_is_recorded_from_the_middle_on(start: Start, tmp_path: Path) -> None:
    live = start()
    file = tmp_path / "part.mcap"
    recorder = live.start("record", "live", "-o", str(file), "--format", "json")
    recorder.says("recording live, run ")
    until(lambda: file.stat().st_size > 3000, "something recorded")
    kill(live, "high")
    recorder.process.send_signal(signal.SIGINT)
    assert recorder.ends() == 0, recorder.err
    told = json.loads("".join(recorder.out))
    assert told["first"] > 1
    assert is_repeated(Recording.open(file)) == told["last"]

    second = tmp_path / "second.mcap"
    done = live.hierax("record", "-o", str(second), "--epochs", "20", "--format", "json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["last"] - told["first"] == 19
    assert is_repeated(Recording.open(second)) == told["last"]
    live.goes_on()
