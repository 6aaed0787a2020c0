"""What a recorder has no room for, or cannot read, is named and not lost in silence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.recording.reading import Entry, Recording
from hierax.runtime.recording.recorder import Recorder
from hierax.runtime.recording.topics import MESSAGE, STEP, Selection
from hierax.runtime.transport.port import Sample


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(folder / "run.mcap", path)[0]


def heard(entry: Entry) -> Sample:
    return Sample(entry.time_ns, entry.key, entry.data)


def test_what_there_is_no_room_for_is_named(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        what, kind, names = entry.topic
        is_picture = what == MESSAGE and kind == "obs" and names == ("world", "low") and entry.epoch == 4
        is_step = what == STEP and names == ("high",) and entry.epoch == 6
        if is_picture or is_step:
            recorder.drop(entry.key, entry.data[:256])
        else:
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert [str(gap) for gap in ending.gaps] == [
        "epoch 4: obs message world -> low: the recorder could not keep up",
        "epoch 6: step of high: the recorder could not keep up",
    ]
    assert ending.lost == 2


def test_what_is_left_out_is_named_by_those_who_said_and_heard_it(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        if not (entry.topic.what == MESSAGE and entry.topic.kind == "task" and entry.epoch == 9):
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert ending.lost == 2
    assert {str(gap) for gap in ending.gaps} == {
        "epoch 9: task message high -> low of attempt 0",
        "epoch 9: task message low -> world of attempt 0",
    }


def test_a_run_that_went_on_without_its_recorder_is_known(recording: Recording) -> None:
    recorder = Recorder(recording.info, None)
    for entry in recording.entries():
        if entry.epoch <= 10:
            recorder.take(heard(entry))
    ending = recorder.finish(12)
    assert ending.last == 10
    assert ending.lost >= 6
    assert "epoch 11: steps of high from here on" in {str(gap) for gap in ending.gaps}


def test_bytes_of_another_kind_are_named(recording: Recording, caplog: pytest.LogCaptureFixture) -> None:
    recorder = Recorder(recording.info, None)
    for key, data in (("obs/a/b", b"\x01"), ("steps/a", b"\x90"), ("epochs", b"\x05"), ("roster", b"\x80")):
        recorder.take(Sample(0, f"hierax/flawed/r/{key}", data))
    assert recorder.finish().lost == 4
    assert caplog.text.count("not recorded, as it is not of this kind") == 4


def test_so_many_epochs_are_recorded_and_no_more(recording: Recording) -> None:
    recorder = Recorder(replace(recording.info, from_start=False), None, epochs=3)
    for entry in recording.entries():
        recorder.take(heard(entry))
        if recorder.ledger.ended:
            break
    assert recorder.ledger.complete or recorder.ledger.ended
    ending = recorder.finish()
    assert ending.last - ending.first == 2


def test_what_comes_before_the_first_whole_epoch_takes_no_room(recording: Recording, tmp_path: Path) -> None:
    """A node may be told late that somebody records; until then the others fill no file."""
    late, most = 7, 72_000
    info = replace(recording.info, from_start=False)
    recorder = Recorder(info, tmp_path / "part.mcap", selection=Selection(max_bytes=most))
    for entry in recording.entries():
        if entry.topic.what != STEP or entry.topic.names != ("high",) or entry.epoch >= late:
            recorder.take(heard(entry))
    ending = recorder.finish()
    assert (ending.first, ending.lost) == (late + 1, 0)
    assert recorder.cut
    assert late < ending.last < 12
    part = Recording.open(tmp_path / "part.mcap")
    assert part.path.stat().st_size <= most
    assert min(entry.epoch for entry in part.entries(MESSAGE)) == late
    assert [epoch.lacking for epoch in part.epochs(ending.first)] == [()] * (ending.last - late)
