from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.tools.leftovers import NODE_PROCESS, Orphan, end_process, orphaned_processes, unused_folders


def process(proc: Path, pid: int, parent: int, *command: str, state: str = "S") -> None:
    """What the kernel tells of a process."""
    folder = proc / str(pid)
    folder.mkdir()
    (folder / "cmdline").write_bytes(b"".join(part.encode() + b"\0" for part in command))
    rest = " ".join(["0"] * 17)
    (folder / "stat").write_text(f"{pid} (a (strange) name) {state} {parent} {rest} 7777 0")


def test_only_nodes_without_a_supervisor_are_orphans(tmp_path: Path) -> None:
    node = ("/usr/bin/python3", "-m", NODE_PROCESS)
    process(tmp_path, 1, 0, "/sbin/init")
    process(tmp_path, 20, 1, "/usr/bin/python3", "/usr/bin/hierax", "launch", "letters")
    process(tmp_path, 21, 20, *node)
    process(tmp_path, 22, 1, *node)
    process(tmp_path, 23, 1, *node, state="Z")
    process(tmp_path, 24, 999, *node)  # its parent has just ended
    process(tmp_path, 25, 1, "/usr/bin/python3", "-m", "another.program")
    (tmp_path / "26").mkdir()  # has just ended itself
    assert list(orphaned_processes(tmp_path)) == [Orphan(22, "7777"), Orphan(24, "7777")]


def test_a_process_is_ended_only_if_it_is_still_the_same() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE)
    try:
        began = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()[19]
        end_process(Orphan(child.pid, "another"))
        assert child.poll() is None
        end_process(Orphan(child.pid, began))
        assert child.wait(10) < 0
        end_process(Orphan(child.pid, began))  # is gone
    finally:
        child.kill()
        child.wait()
        assert child.stdin
        child.stdin.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A launch's folder of checkpoints."""
    made = tmp_path / "hierax-0c18adfc"
    MappedFile(made.parent / "x", "process").close()
    made.mkdir()
    for name in ("run.json", "arm.budget", "arm.times", "world.overruns"):
        (made / name).write_text("{}")
    return made


def test_folders_whose_checkpoints_are_in_use_stay(tmp_path: Path, folder: Path) -> None:
    with MappedFile(folder / "arm", "process"):
        assert list(unused_folders(tmp_path)) == []
    assert list(unused_folders(tmp_path)) == [folder]


def test_what_is_no_folder_of_checkpoints_stays(tmp_path: Path, folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")
    (tmp_path / "hierax-empty_00").mkdir()
    (tmp_path / f"hierax-{os.getuid()}").mkdir()
    assert list(unused_folders(tmp_path)) == []
