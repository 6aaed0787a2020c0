from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hierax.runtime.host.run_folder import begin_run
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.tools import doctor, leftovers
from hierax.runtime.tools.doctor import (
    FINE,
    NOTE,
    WRONG,
    Finding,
    check_folders,
    check_limits,
    check_machine,
    check_python,
    examine,
)
from hierax.runtime.tools.leftovers import Orphan
from hierax.runtime.transport import zenoh_session


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def states(findings: Iterator[Finding]) -> list[str]:
    found = list(findings)
    assert all(finding.mend for finding in found if finding.state == WRONG), "what is wrong can be mended"
    return [finding.state for finding in found]


@pytest.mark.parametrize(("version", "state"), [((3, 9), WRONG), ((3, 10), FINE), ((3, 11), FINE), ((3, 13), NOTE)])
def test_pythons(version: tuple[int, int], state: str) -> None:
    assert states(check_python(version))[0] == state


def test_a_system_that_does_not_let_processes_be_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(pid: int) -> int:
        raise OSError(1, "Operation not permitted")

    assert states(check_python())[1] == FINE
    monkeypatch.setattr(os, "pidfd_open", refuse)
    assert states(check_python())[1] == WRONG
    monkeypatch.setattr(doctor.sys, "platform", "darwin")
    assert states(check_python())[1] == WRONG


@pytest.mark.parametrize(("load", "cores", "state"), [(0.5, 4, FINE), (9.0, 4, NOTE), (0.5, 1, NOTE)])
def test_cores(load: float, cores: int, state: str) -> None:
    assert states(check_machine(load, cores))[0] == state


def test_limits() -> None:
    assert states(check_limits(256, 100)) == [WRONG, WRONG]
    assert states(check_limits(4096, -1)) == [FINE, FINE]


def test_shared_memory(tmp_path: Path) -> None:
    assert states(doctor.check_shared_memory(tmp_path)) == [FINE]
    (tmp_path / "7_0.zenoh").write_bytes(b"left behind")  # nobody holds its lock
    findings = list(doctor.check_shared_memory(tmp_path))
    assert [finding.state for finding in findings] == [FINE, WRONG]
    assert "1 segments (11 bytes)" in findings[1].what
    assert states(doctor.check_shared_memory(tmp_path / "missing")) == [WRONG]


def test_processes_find_each_other(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("ZENOH_CONFIG", raising=False)
    assert states(doctor.check_loopback()) == [FINE]
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / "missing.json5"))
    (finding,) = doctor.check_loopback()
    assert finding.state == WRONG
    assert "ZENOH_CONFIG" in finding.mend


def test_folders_of_launches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begin_run("aa", {"pid": 1})
    found = list(check_folders())
    assert [finding.state for finding in found] == [FINE, FINE]
    assert "logs of 1 launches" in found[1].what
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    assert states(check_folders()) == [WRONG]


def test_what_cannot_be_looked_at_is_a_note_and_all_is_json() -> None:
    def fails() -> Iterator[Finding]:
        yield Finding("a", FINE, "one")
        raise OSError("no such device")

    found = list(examine({"first": fails, "second": lambda: iter([Finding("b", WRONG, "two", "do this")])}))
    assert [finding.state for finding in found] == [FINE, NOTE, WRONG]
    plain = json.loads(json.dumps([each._asdict() for each in found]))
    assert plain[2] == {"check": "b", "state": WRONG, "what": "two", "mend": "do this"}


def test_mending_removes_what_nobody_uses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = tmp_path / "temporary"
    used, unused = base / "hierax-0c18adfc", base / "hierax-1442e90a"
    for folder in (used, unused):
        folder.mkdir(parents=True)
        MappedFile(folder / "arm", "process").close()
    monkeypatch.setattr(leftovers.tempfile, "gettempdir", lambda: str(base))
    monkeypatch.setattr(leftovers, "orphaned_processes", lambda: iter([Orphan(7, "7777")]))
    ended: list[Orphan] = []
    monkeypatch.setattr(leftovers, "end_process", ended.append)
    monkeypatch.setattr(zenoh_session, "remove_orphaned_segments", lambda: 2)
    with MappedFile(used / "arm", "process"):
        assert doctor.mend() == [
            "ended process 7",
            "removed 2 segments of shared memory",
            f"removed {unused}",
        ]
    assert (ended, used.exists(), unused.exists()) == ([Orphan(7, "7777")], True, False)


def test_a_log_folder_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    found = list(check_folders())
    assert [finding.state for finding in found] == [FINE, WRONG]
    assert "cannot be written: Not a directory: launches leave no logs" in found[1].what
    open_ = tmp_path / "open" / "hierax" / "runs"
    open_.mkdir(parents=True)
    open_.chmod(0o777)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "open"))
    assert "others may write there" in list(check_folders())[1].what


def test_little_memory_that_may_be_locked(tmp_path: Path) -> None:
    (first, second) = doctor.check_shared_memory(tmp_path, 65536)
    assert (first.state, second.state) == (NOTE, FINE)
    assert "a process may lock 64 KiB of memory" in first.what
