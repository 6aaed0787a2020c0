"""Junk in recordings: every command that reads them ends with one clear line."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest
from support.junk_recordings import TRUST, Contents, Said, Subject, fault_of, faults, spoilt

from hierax.runtime.commands.main import main
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.writing import INFO

SEED = 12
TIMES = 24


RATED = ("--set", "nodes.motion.every=3", "--set", "edges.camera -> motion.delay=2", "--epochs", "9")


def recorded(folder: Path, *options: str) -> Subject:
    file = folder / "servo.mcap"
    assert main(["run", "servo", *options, "--record", str(file)]) == 0
    return Subject("servo", (), file, Contents.read(file), "camera")


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return recorded(tmp_path_factory.mktemp("junk"), "--epochs", "4")


def test_no_junk_ends_a_command_with_a_traceback(subject: Subject, tmp_path: Path) -> None:
    for number in range(TIMES):
        random_ = random.Random(f"{SEED} {number}")
        path = tmp_path / "spoilt.mcap"
        what = spoilt(random_, subject.contents, path)
        assert list(faults(subject, path, random_, some=3)) == [], f"seed {SEED}, recording {number}, {what}"


def test_nor_does_junk_where_nodes_have_rates(tmp_path: Path) -> None:
    test_no_junk_ends_a_command_with_a_traceback(recorded(tmp_path, *RATED), tmp_path)


def changed(subject: Subject, path: Path, segment: str, change: Callable[[Any], Any], first: int = 0) -> Path:
    """With the first thing on a topic changed."""
    said = list(subject.contents.said)
    found = [index for index, each in enumerate(said) if f"/{segment}" in each.topic]
    index = found[first]
    said[index] = said[index]._replace(data=msgpack.packb(change(msgpack.unpackb(said[index].data))))
    replace(subject.contents, said=tuple(said)).write(path)
    return path


def put(index: int, value: Any) -> Callable[[list[Any]], list[Any]]:
    return lambda fields: [*fields[:index], value, *fields[index + 1 :]]


@pytest.mark.parametrize(
    ("segment", "change", "told"),
    [
        ("obs", put(2, ["world"]), "does not begin like a message"),
        ("obs", put(4, -1), "does not begin like a message"),
        ("epochs", lambda _: 7, "expected an epoch's number and digest"),
        ("epochs", lambda _: [1, b"", 2], "expected an epoch's number and digest"),
        ("steps", put(4, -3), "expected a whole number of 64 bits from 0"),
        ("roster", lambda roster: {**roster, "world": "nobody"}, "nobody"),
        ("roster", lambda roster: {**roster, "edges": roster["edges"] * 2}, "twice"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(
    subject: Subject,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    segment: str,
    change: Callable[[Any], Any],
    told: str,
) -> None:
    path = changed(subject, tmp_path / "changed.mcap", segment, change)
    assert main(["replay", str(path), *TRUST]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {path}: 'hierax/servo/")
    assert told in error
    assert error.count("\n") == 1


def test_an_epoch_far_ahead_is_not_counted_up_to(subject: Subject, tmp_path: Path) -> None:
    world = next(
        index
        for index, each in enumerate(e for e in subject.contents.said if "/steps" in e.topic)
        if msgpack.unpackb(each.data)[1] == "world"
    )
    path = changed(subject, tmp_path / "ahead.mcap", "steps", put(4, 1 << 60), first=world)
    assert fault_of(["replay", str(path), *TRUST]) is None
    assert [epoch.epoch for epoch in Recording.open(path).epochs()][-1] == 1 << 60


@pytest.mark.parametrize(
    ("field", "text", "told"),
    [
        ("seed", '"a"', "seed: expected a whole number from 0, got 'a'"),
        ("seed", "1e400", "seed: expected a whole number"),
        ("staleness", "-1", "staleness: expected a whole number from 0, or null"),
        ("import_paths", '["a\\u0000"]', "import_paths: expected a list of texts"),
        ("settings", "{}", "settings: expected a list of texts"),
        ("hierarchy", "../..", "hierarchy: expected a name"),
        ("from_start", "[" * 5000, "metadata is not what hierax writes"),
    ],
)
def test_what_a_recording_says_of_itself_is_checked(
    subject: Subject, tmp_path: Path, field: str, text: str, told: str
) -> None:
    contents = subject.contents
    info = {**contents.metadata[INFO], field: text}
    replace(contents, metadata={**contents.metadata, INFO: info}).write(tmp_path / "info.mcap")
    with pytest.raises(RecordingError, match=told):
        Recording.open(tmp_path / "info.mcap")


@pytest.mark.parametrize("lacks", ["/", "/steps"])
def test_of_no_epochs_nothing_can_be_checked(
    subject: Subject, tmp_path: Path, capsys: pytest.CaptureFixture[str], lacks: str
) -> None:
    kept: tuple[Said, ...] = tuple(each for each in subject.contents.said if lacks not in each.topic)
    path = tmp_path / "empty.mcap"
    replace(subject.contents, said=kept).write(path)
    assert main(["check", str(path)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert f"error: {path}: there is nothing to check" in err
