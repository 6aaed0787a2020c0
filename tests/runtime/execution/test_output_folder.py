from __future__ import annotations

from pathlib import Path

import msgpack
import pytest

from hierax.runtime.execution.output_folder import (
    DIGESTS,
    ROSTER,
    STATES,
    SUMMARY,
    Log,
    OutputError,
    claimed_output,
)
from hierax.runtime.host.private_files import HeldError, UnsafeFileError


def run_in(output: Path) -> list[Path]:
    """What a run leaves there, and what its user has beside it."""
    (output / STATES).mkdir(parents=True)
    files = [output / ROSTER, output / DIGESTS, output / SUMMARY, output / STATES / "arm.msgpack"]
    for file in [*files, output / "notes.txt", output / STATES / "notes.txt"]:
        file.write_bytes(b"of before")
    return files


def test_an_output_of_another_run_is_refused_and_stays(tmp_path: Path) -> None:
    files = run_in(tmp_path / "out")
    what = r"there is a run in it already \(roster.msgpack\); --overwrite replaces it, or name another folder"
    with pytest.raises(OutputError, match=what), claimed_output(tmp_path / "out"):
        pass
    assert all(file.read_bytes() == b"of before" for file in files)


def test_overwriting_removes_what_runs_write_and_nothing_else(tmp_path: Path) -> None:
    run_in(tmp_path / "out")
    with claimed_output(tmp_path / "out", overwrite=True):
        left = sorted(path.name for path in (tmp_path / "out").rglob("*") if path.is_file())
        assert left == ["notes.txt", "notes.txt", ROSTER]


def test_a_run_that_goes_on_keeps_what_it_has_written(tmp_path: Path) -> None:
    files = run_in(tmp_path / "out")
    with claimed_output(tmp_path / "out", goes_on=True):
        assert all(file.read_bytes() == b"of before" for file in files)


def test_a_folder_with_files_of_ones_own_is_no_output_yet(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with claimed_output(tmp_path):
        assert (tmp_path / ROSTER).exists()
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]  # nothing was written


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with (
        claimed_output(tmp_path),
        pytest.raises(HeldError, match=r"process is writing there; name another folder"),
        claimed_output(tmp_path, overwrite=True),
    ):
        pass


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for output in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with (
            pytest.raises(OutputError, match=f"--output {output}: it cannot be made or written"),
            claimed_output(output),
        ):
            pass


def test_links_in_it_are_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / ROSTER).symlink_to(victim)
    with pytest.raises(UnsafeFileError, match="is a symbolic link"), claimed_output(tmp_path, overwrite=True):
        pass
    assert victim.read_text() == "precious"


def test_a_log_that_is_gone_on_with_is_read_when_it_is_opened_and_no_second_time(tmp_path: Path) -> None:
    path = tmp_path / "log.msgpack"
    first, second, third = (msgpack.packb((epoch, bytes(100))) for epoch in (1, 2, 3))
    path.write_bytes(first + second[:50])
    log = Log(path, append=True)
    never_used = b"\xc1"
    with path.open("r+b") as file:  # as the process before may, it goes on; and whoever read the beginning, fails
        file.write(never_used)
        file.seek(len(first))
        file.write(second + third[:50])
    log.write(3, bytes(100))
    log.close()
    assert path.read_bytes() == never_used + first[1:] + second + third


def test_a_log_that_has_become_shorter_meanwhile_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "log.msgpack"
    first, second = (msgpack.packb((epoch, bytes(100))) for epoch in (1, 2))
    path.write_bytes(first + second)
    log = Log(path, append=True)
    path.write_bytes(first + second[:50])
    log.write(2, bytes(100))
    log.close()
    assert path.read_bytes() == first + second
