"""A recording names code: it is loaded if this user has recorded it here and nobody has changed it, or by --trust."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.commands.main import main
from hierax.runtime.loading.allowance import NotAllowedError
from hierax.runtime.recording.info import Ending, RecordingError, RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of
from hierax.runtime.recording.topics import ROSTER
from hierax.runtime.recording.writing import McapFile
from hierax.runtime.testing.runs import read_recorded
from hierax.schemas.roster import Reference, Roster
from hierax.schemas.values import encode_value

REFUSED = "it names code to run, and nothing shows that this user has written it on this machine"
MARKER = "hierax_test_recorded"


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Recording]:
    file = tmp_path / "flawed.yaml"
    file.write_text(DEPLOYMENT, encoding="utf-8")
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield record_file(tmp_path / "own.mcap", file, epochs=3)[0]
    sys.modules.pop(MARKER, None)


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    """A file that is there once a module beside it was imported."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    text = "from pathlib import Path\nfrom support.flawed import *\nPath(__file__).with_name('imported').touch()\n"
    (folder / f"{MARKER}.py").write_text(f"{text}class Other(Level):\n    pass\n")
    return folder / "imported"


def crafted(
    recording: Recording, info: RunInfo | dict[str, Any], rewrite: Callable[[Roster], Roster] = lambda roster: roster
) -> Recording:
    """The same recording saying other things of itself, or with other rosters."""
    path = recording.path.with_name("crafted.mcap")
    said = info if isinstance(info, RunInfo) else replace(recording.info, **info)
    file = McapFile(path, said)
    for entry in recording.entries():
        data = entry.data
        if entry.topic.what == ROSTER:
            data = encode_value(rewrite(entry.roster()).plain())
        file.add(entry._replace(data=data))
    file.close(recording.ending or Ending(1, 3, 0, (), 0))
    return Recording.open(path)


def with_other(roster: Roster) -> Roster:
    nodes = {**roster.nodes, "high": Reference(f"{MARKER}:Other", roster.nodes["high"].parameters)}
    return replace(roster, nodes=nodes)


def is_refused(recording: Recording) -> None:
    with pytest.raises(RecordingError, match=REFUSED):
        allowance_of(recording)
    with pytest.raises(RecordingError, match=REFUSED):
        read_recorded(recording.path, "low")


def test_ones_own_needs_no_trust(recording: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    assert recording.info.is_ours
    assert list(recording.info.modules) == ["support.flawed"]
    assert main(["replay", str(recording.path), "--verify"]) == 0, capsys.readouterr().err
    assert read_recorded(recording.path, "low").check()


@pytest.mark.parametrize("field", ["import_paths", "modules", "deployment", "deployment_text", "settings", "seal"])
def test_a_changed_one_is_refused(field: str, recording: Recording) -> None:
    texts = field in ("import_paths", "modules", "settings")
    is_refused(crafted(recording, {field: ("/elsewhere",) if texts else "0" * 64}))


def test_one_of_another_user_or_machine_is_refused(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    is_refused(recording)
    assert read_recorded(recording.path, "low", trust=True).check()


def test_one_without_a_seal_is_refused(recording: Recording) -> None:
    old = crafted(recording, {"format": 1, "modules": (), "seal": ""})
    is_refused(old)
    list(Replay(old, allowance_of(old, trust=True)).epochs())


def test_an_own_ones_rosters_are_held_against_what_its_deployment_allowed(recording: Recording, marker: Path) -> None:
    changed = crafted(recording, recording.info, with_other)
    assert changed.info.is_ours
    sys.path.append(str(marker.parent))
    with pytest.raises(NotAllowedError, match=rf"^nodes\.high\.class: '{MARKER}:Other' may not be loaded in this run"):
        list(Replay(changed, allowance_of(changed)).epochs())
    assert not marker.exists()


@pytest.mark.parametrize("command", ["replay", "replay --node high", "replay --verify --world again", "view"])
def test_a_crafted_recording_runs_by_trust_alone(
    command: str, recording: Recording, marker: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = crafted(recording, {"import_paths": (str(marker.parent),), "modules": (MARKER,)}, with_other).path
    first, *options = command.split()
    options += ["--save", str(tmp_path / "seen.rrd")] if first == "view" else []
    assert main([first, str(file), *options]) == 1
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"error: {file}: {err.partition(f'{file}: ')[2]}")
    assert REFUSED in err
    assert "--trust loads and runs what it names" in err
    assert err.count("\n") == 1
    assert not marker.exists()
    assert main([first, str(file), *options, "--trust"]) in (0, 1)
    assert marker.exists(), capsys.readouterr().err


def test_a_difference_to_ones_own_deployment_needs_no_trust(
    recording: Recording, marker: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    own = str(tmp_path / "flawed.yaml")
    same = crafted(recording, {"import_paths": (str(marker.parent),)})
    assert main(["diff", str(same.path), own]) == 0, capsys.readouterr().err
    assert str(marker.parent) not in sys.path
    other = crafted(recording, {"import_paths": (str(marker.parent),)}, with_other)
    assert main(["diff", str(other.path), own]) == 1, capsys.readouterr()
    assert not marker.exists()
