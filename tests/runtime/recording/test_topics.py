from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hierax.runtime.commands.main import main
from hierax.runtime.recording.check import check_recording
from hierax.runtime.recording.info import Ending, RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.topics import MESSAGE, Entry, Selection, Topic, check_pattern, read_duration, read_size
from hierax.runtime.recording.writing import McapFile

EPOCHS = 300
Capture = pytest.CaptureFixture[str]


def recorded(file: Path, *options: str, epochs: int = EPOCHS) -> Recording:
    assert main(["run", "servo", "--epochs", str(epochs), "--record", str(file), *options]) == 0
    return Recording.open(file)


@pytest.mark.parametrize(
    ("pattern", "key", "left_out"),
    [
        ("obs/world/arm", "obs/world/arm", True),
        ("obs/*/arm", "obs/world/arm", True),
        ("obs/world/*", "ctx/world/arm", False),
        ("obs/**", "obs/world/arm", True),
        ("**", "alive/arm/2af", True),
        ("**", "roster", False),
        ("**", "epochs", False),
        ("steps/arm", "steps/arm", True),
        ("steps/arm", "steps/arm2", False),
        ("notes", "notes", True),
        ("obs/world", "obs/world/arm", False),
    ],
)
def test_which_keys_a_pattern_leaves_out(pattern: str, key: str, left_out: bool) -> None:
    selection = Selection((check_pattern(pattern),))
    assert selection.leaves_out(f"hierax/house/run/{key}") == (pattern if left_out else "")


@pytest.mark.parametrize("pattern", ["", "x/y/z", "roster", "obs//arm", "epochs"])
def test_a_pattern_that_fits_no_key_is_refused(pattern: str) -> None:
    with pytest.raises(RecordingError, match=r"--exclude .*: expected a pattern of keys, such as obs/camera/\*"):
        check_pattern(pattern)


def test_sizes_and_times() -> None:
    assert [read_size(text) for text in ("500", "1.5 kB", "500MB", "2GiB")] == [500, 1500, 500_000_000, 2 << 30]
    assert [read_duration(text) for text in ("90", "1.5s", "15m", "2h")] == [90.0, 1.5, 900.0, 7200.0]
    for text in ("", "0", "-1", "ten", "3 parsec", "1e9", "9" * 400):
        with pytest.raises(RecordingError, match=r"--max-size .*: expected a size"):
            read_size(text)
        with pytest.raises(RecordingError, match=r"--max-duration .*: expected a time"):
            read_duration(text)


def test_what_is_left_out_is_said_and_the_rest_is_used(tmp_path: Path, capsys: Capture) -> None:
    recording = recorded(tmp_path / "part.mcap", "--exclude", "obs/world/*", "--exclude", "obs/nobody/*", "--check")
    assert "--exclude obs/nobody/*: nothing came on such a key" in capsys.readouterr().err
    assert recording.ending is not None
    assert dict(recording.ending.left_out) == {"obs/world/*": EPOCHS, "obs/nobody/*": 0}
    assert not list(recording.messages(node="world", kind="obs"))
    assert len(recording.digests()) == EPOCHS
    checker = check_recording(recording)
    assert (checker.close(), checker.epochs) == ([], EPOCHS)
    said = f"hierax: {tmp_path}/part.mcap: obs/world/*, obs/nobody/* was left out (--exclude)\n"
    for arguments in (["check"], ["diff", "servo"], ["replay", "--world", "again", "--verify"]):
        command = [arguments[0], f"{tmp_path}/part.mcap", *arguments[1:]]
        assert main(command) == 0, command
        assert capsys.readouterr().err == said
    assert main(["replay", f"{tmp_path}/part.mcap"]) == 1
    assert capsys.readouterr().err.splitlines() == [
        said.rstrip(),
        f"error: {tmp_path}/part.mcap: epoch 1 cannot be done again: the obs message world -> camera of epoch 1, "
        "attempt 0, is not recorded",
    ]


def test_a_recording_ends_before_it_is_too_large(tmp_path: Path, capsys: Capture) -> None:
    most = 200_000
    recording = recorded(tmp_path / "first.mcap", "--max-size", "200kB", "--check", epochs=2000)
    assert recording.ending is not None
    last = recording.ending.last
    assert f"it ends with epoch {last} (--max-size {most} bytes)" in capsys.readouterr().err
    assert most / 3 < recording.path.stat().st_size <= most
    assert 10 < last < 2000
    epochs = list(recording.epochs())
    assert [epoch.epoch for epoch in epochs] == list(range(1, last + 1))
    assert all(not epoch.lacking for epoch in epochs)
    assert main(["replay", str(recording.path), "--verify"]) == 0


def test_an_index_of_many_chunks_counts_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hierax.runtime.recording.writing.CHUNK_S", 0.0)  # a chunk for each epoch
    most = 1_000_000
    recording = recorded(tmp_path / "first.mcap", "--max-size", "1MB", epochs=5000)
    assert recording.ending is not None
    assert 10 < recording.ending.last < 5000
    assert most / 2 < recording.path.stat().st_size <= most
    assert len(recording.digests()) == recording.ending.last


def test_what_is_no_finite_size_is_one_line(capsys: Capture, tmp_path: Path) -> None:
    for size in ("9" * 400, f"{'9' * 300}TB"):
        assert main(["run", "servo", "--record", str(tmp_path / "x.mcap"), "--max-size", size]) == 1
        said = capsys.readouterr().err
        assert said.startswith("error: --max-size 9999")
        assert said.endswith(": expected a size, such as 500MB or 2GiB\n")
        assert len(said) < 200


def test_a_recording_ends_in_time(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "first.mcap", "--max-duration", "0.001s", epochs=2000)
    assert recording.ending is not None
    assert 0 < recording.ending.last < 2000
    assert "(--max-duration 0.001 s)" in recording.loss
    assert [epoch.epoch for epoch in recording.epochs()] == list(range(1, recording.ending.last + 1))


def test_nothing_is_left_out_of_no_recording(capsys: Capture) -> None:
    assert main(["run", "servo", "--max-size", "1MB"]) == 1
    assert capsys.readouterr().err == "error: --max-size: only with --record, of which it leaves something out\n"


def test_an_array_that_is_told_of_twice_takes_its_room_once(tmp_path: Path) -> None:
    picture = np.random.default_rng(7).integers(0, 256, 320 * 240 * 3, np.uint8).tobytes()
    info = recorded(tmp_path / "x.mcap", epochs=1).info
    file = McapFile(tmp_path / "y.mcap", info)
    for number in range(4):
        key = f"hierax/servo/run/obs/world/{number}"
        file.add(Entry(key, Topic(MESSAGE, "obs", ("world", str(number))), 1, 1, picture))
    file.flush(at_once=True)
    size = file.size
    file.close(Ending(1, 1, 4, (), 0))
    assert size < 1.2 * len(picture)


def test_a_recording_that_is_there_is_replaced_only_when_asked(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "x.mcap"
    recorded(file, epochs=3)
    before = file.read_bytes()
    assert main(["run", "servo", "--epochs", "2", "--record", str(file)]) == 1
    assert (
        capsys.readouterr().err == f"error: {file}: is there already; --overwrite replaces it, or name another file\n"
    )
    assert file.read_bytes() == before
    assert len(recorded(file, "--overwrite", epochs=2).digests()) == 2
    (tmp_path / "notes").write_text("precious")
    assert main(["run", "servo", "--epochs", "2", "--record", str(tmp_path / "notes"), "--overwrite"]) == 1
    assert "notes: is no recording, so it is not overwritten" in capsys.readouterr().err
    assert (tmp_path / "notes").read_text() == "precious"
