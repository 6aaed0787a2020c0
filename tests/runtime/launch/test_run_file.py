from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch import run_file
from hierax.runtime.launch.run_file import (
    Run,
    Running,
    has_run,
    held_state,
    is_loopback,
    key_path,
    known_here,
    known_runs,
    make_state,
    outdate_run,
    read_run,
    register,
    warning_of,
    write_run,
)
from hierax.runtime.recovery.disk import MappedFile

NOBODY = 65534
NO_PROCESS = 2**22 - 1
SECRET = "ab12" * 8
RUN = Run("/house.yaml", [], 3, 10, "", {}, {})
HERE = Running("aaaa0000", "house", "tcp/127.0.0.1:1", os.getpid(), "/house.yaml", [])
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine whose temporary folder is this one, for a user without a folder for what runs."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.setattr(run_file, "_TEMPORARY", folder)
    return folder


def test_what_runs_is_registered_for_this_user_alone(temporary: Path) -> None:
    path = register(HERE)
    assert path.is_relative_to(temporary)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert [each.run for each in known_runs()] == ["aaaa0000"]


def test_a_launch_is_known_by_its_lock_and_not_by_the_number_of_its_process(temporary: Path) -> None:
    elsewhere = replace(HERE, run="bbbb0000", pid=NO_PROCESS)  # as one in another container looks
    with known_here(elsewhere, SECRET):
        assert [(each.run, each.secret) for each in known_runs()] == [("bbbb0000", SECRET)]
    path = register(HERE, SECRET)  # killed, and another process has its number
    path.with_suffix(".lock").touch(0o600)
    assert known_runs() == []
    assert list(path.parent.iterdir()) == []


@root_only
def test_a_squatted_folder_neither_blocks_nor_is_believed(temporary: Path) -> None:
    squatted = temporary / f"hierax-{os.getuid()}" / "hierax"
    squatted.mkdir(parents=True)
    false = {**vars(HERE), "run": "ffff0000"}
    (squatted / "ffff0000.json").write_text(json.dumps(false))
    (squatted / "aaaa0000.key").write_text("hierax:cd34\n")
    for path in (squatted.parent, squatted, *squatted.iterdir()):
        os.chown(path, NOBODY, NOBODY)
        path.chmod(0o777)
    path = register(HERE, SECRET)
    assert not path.is_relative_to(temporary)
    assert [(each.run, each.secret) for each in known_runs()] == [("aaaa0000", SECRET)]
    assert (squatted / "ffff0000.json").exists()


@pytest.mark.parametrize(
    ("endpoint", "here"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tls/[::1]:7447", True),
        ("tcp/localhost:7447", True),
        ("tcp/10.0.0.1:7447", False),
        ("tcp/127.example.org:7447", False),
        ("tcp/localhost.example.org:7447", False),
    ],
)
def test_what_only_begins_like_the_loopback_is_another_machine(endpoint: str, here: bool) -> None:
    assert is_loopback(endpoint) == here
    assert ("insecure: true" in warning_of(endpoint, SECRET)) == (endpoint.startswith("tcp/") and not here)


def test_a_link_among_them_is_not_followed(temporary: Path, tmp_path: Path) -> None:
    path = register(HERE)
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    assert known_runs() == []


def test_where_one_may_not_enter_runs_are_found_in_other_places_alone(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", f"/{'x' * 300}")  # raises as such a folder does, for root, too
    register(HERE, SECRET)
    assert [(each.run, each.secret) for each in known_runs()] == [("aaaa0000", SECRET)]
    assert key_path("bbbb0000").name == "bbbb0000.key"


def test_a_run_is_written_for_this_user_alone(tmp_path: Path) -> None:
    write_run(tmp_path / "state", RUN)
    assert read_run(tmp_path / "state") == RUN
    assert stat.S_IMODE((tmp_path / "state" / "run.json").stat().st_mode) == 0o600


def test_what_it_takes_to_resume_a_run_outlives_the_machine_where_its_checkpoints_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are on the disk, the file before it has its name and the folder with it."""
    synced: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(Path(f"/proc/self/fd/{file}").resolve().name))
    write_run(tmp_path / "state", RUN)
    synced.clear()  # of the user's own key
    write_run(tmp_path / "state", RUN)
    assert not synced
    write_run(tmp_path / "state", RUN, durable=True)
    unfinished, folder = synced
    assert unfinished.startswith(".run.json.")
    assert folder == "state"


def test_nobody_goes_on_with_a_run_by_what_was_written_before_a_change(tmp_path: Path) -> None:
    state = tmp_path / "state"
    write_run(state, RUN)
    outdate_run(state)
    assert has_run(state), "else another one would begin in its place"
    with pytest.raises(HieraxError, match=f"{state}: the run cannot be resumed: run.json could not be written after"):
        read_run(state, trust=True)
    outdate_run(state)
    write_run(state, RUN)
    assert read_run(state) == RUN
    assert [path.name for path in state.iterdir()] == ["run.json"]


def damage(**fields: object) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        path.write_text(json.dumps({**vars(RUN), **fields}))

    return write


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (Path.unlink, "there is no run to resume: run.json is missing"),
        (lambda path: path.write_text("{torn"), "expected what a launch of this version with --state wrote"),
        (lambda path: path.write_text("[" * 100_000), "expected what a launch of this version with --state wrote"),
        (lambda path: path.write_bytes(b"\xff\xfe"), "expected what a launch of this version with --state wrote"),
        (lambda path: path.write_text("[]"), "expected what a launch of this version with --state wrote"),
        (damage(extra=1), "unexpected keyword argument 'extra'"),
        (damage(seed="three"), "seed: expected a int, got 'three'"),
        (damage(settings="noise=1"), "settings: expected a list"),
        (damage(coming=["arm"]), "coming: expected a dict"),
        (damage(epochs="ten"), "epochs: expected a number"),
    ],
)
def test_a_damaged_run_is_one_line(tmp_path: Path, spoil: Callable[[Path], object], error: str) -> None:
    write_run(tmp_path / "state", RUN)
    spoil(tmp_path / "state" / "run.json")
    with pytest.raises(HieraxError, match=error):
        read_run(tmp_path / "state", trust=True)


def test_a_state_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for state in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with pytest.raises(HieraxError, match=f"--state {state}: it cannot be written"):
            make_state(state)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(HieraxError, match="others may write there"):
        make_state(tmp_path / "open")


def test_only_what_a_run_has_left_is_removed_for_another_one(tmp_path: Path) -> None:
    (tmp_path / "notes.0").write_text("mine")
    MappedFile(tmp_path / "arm.left").close()
    write_run(tmp_path, RUN)
    with (
        pytest.raises(HieraxError, match=r"there is a run in it already \(run\.json\)"),
        held_state(tmp_path, resumes=False),
    ):
        pass
    with held_state(tmp_path, resumes=True):
        assert read_run(tmp_path) == RUN
    with held_state(tmp_path, resumes=False, overwrite=True):
        assert sorted(path.name for path in tmp_path.iterdir()) == ["_run.lock", "arm.left.lock", "notes.0"]


def test_a_state_is_one_launch_s_at_a_time(tmp_path: Path) -> None:
    for resumes in (False, True):
        in_use = pytest.raises(HieraxError, match="is running with its checkpoints there")
        with held_state(tmp_path, resumes=False), in_use, held_state(tmp_path, resumes, overwrite=True):
            pass
        with held_state(tmp_path, resumes=resumes):  # it is free at once
            pass


@root_only
def test_a_state_in_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    os.chown(foreign, NOBODY, NOBODY)
    for state in (foreign, foreign / "state"):
        with pytest.raises(HieraxError, match="belongs to another user"):
            make_state(state)
        with pytest.raises(HieraxError, match="belongs to another user"):
            read_run(state)
