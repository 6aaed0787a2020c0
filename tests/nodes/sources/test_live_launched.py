"""A launch before a live camera that stalls and breaks off, whose processes are killed, and that can be repeated."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.cameras import filmed, settings
from support.launched import Launched, said_here, until
from support.streams import Stream, number_of

from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene, read_results
from hierax.runtime.recording.reading import Recording

NO_FRAME = "no frame; nothing is observed until one comes"
STEADY = ("restart.max_restarts=0", "restart.restart_delay=0.0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("filmed")
    filmed(out, 4, objects=1)
    return out


def pictures_of(folder: Path) -> list:  # type: ignore[type-arg]
    return [read_image(frame.image) for frame in BopScene(folder / "test" / "000001").frames]


def launched(folder: Path, tmp_path: Path, stream: Stream, *more: str) -> Launched:
    told = settings(
        folder, stream.url, "reopen=true", "source_timeout=0.5", f"output={tmp_path / 'poses.csv'}", *STEADY
    )
    options = [word for setting in told for word in ("--set", setting)]
    return Launched(tmp_path, "tracking", *options, "--record", str(tmp_path / "live.mcap"), *more)


def check_recording(path: Path, stream: Stream) -> list[int]:
    """Numbers of the pictures that the arm saw, of all epochs: each once, in order; the recording verifies."""
    numbers, frames = [], []
    for epoch in Recording.open(path).epochs():
        for picture in epoch.elements("obs", "world", "arm") or ():
            numbers.append(number_of(picture["image"]))
            frames.append(picture["frame"])
    assert numbers == sorted(set(numbers))
    assert frames == sorted(set(frames))
    assert set(numbers) <= set(range(stream.sent))
    done = said_here("replay", str(path), "--verify")
    assert (done.returncode, "all results are alike" in done.stdout) == (0, True), done.stderr
    return numbers


def test_a_stream_that_stalls_and_breaks_off_is_recovered_and_repeated(folder: Path, tmp_path: Path) -> None:
    with Stream(pictures_of(folder), 100.0) as stream, launched(folder, tmp_path, stream, "--epochs", "40") as run:
        run.until_epoch(4)
        for number, event in enumerate((stream.stalled, stream.refused), start=1):
            event.set()
            told = f"stall {number} is told"
            until(lambda number=number: run.err.count(NO_FRAME) >= number or not run.running, told)  # type: ignore[misc]
            event.clear()
            sent = stream.sent
            until(lambda sent=sent: stream.sent > sent or not run.running, "the stream goes on")  # type: ignore[misc]
            run.until_epoch(run.epoch + 3)
        top = said_here("top", "--once", "--interval", "0.1", folder=tmp_path)
        assert re.search(r"; world: passed_over \d+, reopened \d+, stalls \d+\n", top.stdout), top.stderr
        report = run.report()
        metrics = report["nodes"]["world"]["metrics"]
        assert metrics["stalls"] >= 2
        assert metrics["reopened"] >= 1
        assert metrics["passed_over"] >= 1
        assert report["nodes"]["arm"]["metrics"]["tracked"] in (0.0, 1.0)
        assert NO_FRAME in run.err
        assert "frames come again" in run.err
        numbers = check_recording(tmp_path / "live.mcap", stream)
    assert len(numbers) <= 40 - metrics["stalls"] + 1
    again = said_here(
        *(
            "run",
            "tracking",
            "--set",
            f"camera={tmp_path / 'live.mcap'}",
            "--set",
            f"objects={folder / 'objects.yaml'}",
        ),
        *("--set", f"output={tmp_path / 'again.csv'}"),
    )
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "poses.csv").read_bytes()


def test_processes_that_are_killed_see_no_frame_twice(folder: Path, tmp_path: Path) -> None:
    with Stream(pictures_of(folder), 60.0) as stream, launched(folder, tmp_path, stream, "--epochs", "30") as run:
        for number, node in enumerate(("world", "arm", "world", "spatial"), start=1):
            run.until_epoch(5 * number)
            run.kill(node)
        report = run.report()
        assert report["epochs"] == 30
        assert report["nodes"]["world"]["metrics"]["reopened"] >= 2
        check_recording(tmp_path / "live.mcap", stream)
    frames = [result.im_id for result in read_results(tmp_path / "poses.csv")]
    assert frames == sorted(set(frames))


def test_without_reopening_a_camera_that_ends_ends_the_run_with_one_line(folder: Path, tmp_path: Path) -> None:
    with Stream(pictures_of(folder)) as stream, launched(folder, tmp_path, stream, "--set", "reopen=false") as run:
        run.until_epoch(3)
        stream.refused.set()
        run.end()
        assert run.process.returncode == 1
        (line,) = [line for _, line in run.said if line.startswith("error:")]
        assert f"camera {stream.url}: gives no more frames; it has ended, or was unplugged (reopen: true" in line
