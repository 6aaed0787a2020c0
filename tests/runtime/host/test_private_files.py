from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host import private_files
from hierax.runtime.host.private_files import (
    HeldError,
    UnsafeFileError,
    close_held,
    errors_named,
    hold,
    open_held,
    open_private,
    open_result,
    private_folder,
    read_private,
    write_private,
    write_result,
)

NOBODY = 65534
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_made_is_for_this_user_alone(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "file"
    write_private(path, b"one")
    assert read_private(path) == b"one"
    assert [mode(each) for each in (path, path.parent, path.parent.parent)] == [0o600, 0o700, 0o700]
    assert os.listdir(path.parent) == ["file"]


def test_a_file_that_others_can_read_is_theirs_no_more(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("x")
    (tmp_path / "old").chmod(0o644)
    with private_folder(tmp_path) as folder:
        os.close(open_private(folder, "old", os.O_RDWR, tmp_path / "old"))
    assert mode(tmp_path / "old") == 0o600


def test_what_is_written_for_a_user_is_for_others_too_unless_it_is_private(tmp_path: Path) -> None:
    path = tmp_path / "old"
    path.write_text("x")
    path.chmod(0o644)
    os.close(open_result(path))
    assert mode(path) == 0o644
    os.close(open_result(path, private=True))
    assert mode(path) == 0o600


@pytest.mark.parametrize("open_", [0o777, 0o770, 0o1777])
def test_a_folder_that_others_may_write_is_refused(tmp_path: Path, open_: int) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    folder.chmod(open_)
    with pytest.raises(UnsafeFileError, match=rf"folder: others may write there \(mode {open_:04o}\); .* chmod 700"):
        write_private(folder / "file", b"x")
    assert not any(folder.iterdir())


@root_only
def test_a_folder_of_another_user_is_refused_wherever_it_is_on_the_way(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    (foreign / "mine").mkdir(parents=True)
    os.chown(foreign, NOBODY, NOBODY)
    with pytest.raises(UnsafeFileError, match="foreign belongs to another user"):
        write_private(foreign / "file", b"x")
    with pytest.raises(UnsafeFileError, match="'foreign' on the way there belongs to another user"):
        write_private(foreign / "mine" / "file", b"x")
    (tmp_path / "link").symlink_to(foreign / "mine")
    with pytest.raises(UnsafeFileError, match="'foreign' on the way there"):
        write_private(tmp_path / "link" / "file", b"x")
    os.lchown(tmp_path / "link", NOBODY, NOBODY)
    with pytest.raises(UnsafeFileError, match="'link' on the way there"):
        write_private(tmp_path / "link" / "file", b"x")


def test_a_way_that_anybody_can_change_is_refused(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    (shared / "mine").mkdir(parents=True, mode=0o700)
    shared.chmod(0o777)
    with pytest.raises(UnsafeFileError, match="anybody may exchange what is in 'shared'"):
        write_private(shared / "mine" / "file", b"x")
    shared.chmod(0o1777)  # as in the system's temporary folder, nobody can there
    write_private(shared / "mine" / "file", b"x")


def test_links_of_ones_own_lead_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "real" / "in").mkdir(parents=True, mode=0o700)
    (tmp_path / "real" / "beside").symlink_to("../real/in")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    monkeypatch.chdir(tmp_path)
    write_private(Path("link/beside/file"), b"x")
    assert (tmp_path / "real" / "in" / "file").read_bytes() == b"x"
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OSError, match="Too many levels"):
        write_private(Path("loop/file"), b"x")


@pytest.mark.parametrize("kind", ["link", "fifo", "folder"])
def test_what_is_no_file_is_not_opened(tmp_path: Path, kind: str) -> None:
    victim, path = tmp_path / "victim", tmp_path / "file"
    victim.write_text("precious")
    if kind == "link":
        path.symlink_to(victim)
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        path.mkdir()
    for open_it in (read_private, lambda path: write_result(path, b"x"), lambda path: open_result(path, append=True)):
        with pytest.raises((UnsafeFileError, IsADirectoryError)):
            open_it(path)
    assert victim.read_text() == "precious"


@root_only
def test_a_file_of_another_user_is_neither_believed_nor_written(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("theirs")
    os.chown(path, NOBODY, NOBODY)
    for open_it in (read_private, lambda path: write_result(path, b"x")):
        with pytest.raises(UnsafeFileError, match="file belongs to another user"):
            open_it(path)
    assert path.read_text() == "theirs"


HOLDS = """
import sys
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import hold, open_result
hold(open_result(sys.argv[1]), HieraxError)
print("held", flush=True)
sys.stdin.read()
"""


def test_who_has_a_file_is_named(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLDS, str(tmp_path / "file")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        file = open_result(tmp_path / "file")
        told: list[str] = []

        def error(holder: str) -> HieraxError:
            told.append(holder)
            return HeldError(holder)

        with pytest.raises(HeldError):
            hold(file, error)
        assert told == [f"process {other.pid}"]
        other.communicate()
    hold(file, error)
    os.close(file)


def test_a_file_that_its_holder_removes_just_then_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    before = open_held(path, HeldError)

    def hold_later(file: int, refusal: Callable[[str], HieraxError]) -> None:
        if os.fstat(file).st_nlink:  # it is opened, and then its holder ends
            monkeypatch.undo()
            close_held(path, before)
        hold(file, refusal)

    monkeypatch.setattr(private_files, "hold", hold_later)
    file = open_held(path, HeldError)
    assert os.path.samestat(os.fstat(file), path.stat())
    close_held(path, file)
    assert not path.exists()


def test_what_the_machine_refuses_is_named_with_its_place(tmp_path: Path) -> None:
    lacking = tmp_path / "lacking"
    refused = pytest.raises(HeldError, match=f"^{lacking}: cannot be read: No such file or directory$")
    with refused as caught, errors_named(lacking, "read", HeldError):
        lacking.read_bytes()
    assert isinstance(caught.value.__cause__, FileNotFoundError)
    with pytest.raises(ValueError, match="another"), errors_named(lacking):
        raise ValueError("another")
