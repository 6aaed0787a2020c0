from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

import msgpack
import pytest

from hierax.runtime.execution import output_folder
from hierax.runtime.execution.output_folder import (
    DIGESTS,
    ROSTER,
    STATES,
    SUMMARY,
    Log,
    OutputError,
    claimed_output,
    state_log,
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
        (tmp_path / "out" / DIGESTS).write_bytes(msgpack.packb((1, b"")))
    left = sorted(path.name for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert left == [DIGESTS, "notes.txt", "notes.txt", ROSTER]


def begin_in(output: Path, *epochs: int) -> None:
    """What a run writes that ends in its next epoch, killed before the digests are on disk."""
    (output / ROSTER).write_bytes(b"of now")
    (output / DIGESTS).touch()
    (output / STATES).mkdir(exist_ok=True)
    (output / STATES / "leg.msgpack").write_bytes(b"".join(msgpack.packb((epoch, 0)) for epoch in epochs))


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_run_without_an_epoch_does_not_replace_another_one(tmp_path: Path, is_killed: bool) -> None:
    files = run_in(tmp_path / "out")
    everything = sorted((tmp_path / "out").rglob("*"))
    with suppress(OutputError), claimed_output(tmp_path / "out", overwrite=True):
        begin_in(tmp_path / "out", 1)
        if is_killed:  # it is the next one that finds what it has left
            shutil.copytree(tmp_path / "out", tmp_path / "killed")
        raise OutputError
    if is_killed:
        shutil.rmtree(tmp_path / "out")
        (tmp_path / "killed").rename(tmp_path / "out")
        with pytest.raises(OutputError, match="there is a run in it already"), claimed_output(tmp_path / "out"):
            pass
    assert all(file.read_bytes() == b"of before" for file in files)
    assert sorted((tmp_path / "out").rglob("*")) == everything


def test_a_run_with_an_epoch_replaces_another_one_however_it_ends(tmp_path: Path) -> None:
    run_in(tmp_path)
    with suppress(OutputError), claimed_output(tmp_path, overwrite=True):
        begin_in(tmp_path, 1, 2)
        raise OutputError
    left = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert left == [DIGESTS, "leg.msgpack", "notes.txt", "notes.txt", ROSTER]
    assert (tmp_path / ROSTER).read_bytes() == b"of now"


def test_a_run_without_an_epoch_leaves_nothing_and_one_that_goes_on_everything(tmp_path: Path) -> None:
    for goes_on in (False, True):
        with suppress(OutputError), claimed_output(tmp_path / "out", goes_on=goes_on):
            begin_in(tmp_path / "out", 1)
            raise OutputError
        assert (tmp_path / "out").exists() == goes_on


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


def test_who_is_refused_leaves_the_other_ones_folder_to_it(tmp_path: Path) -> None:
    with claimed_output(tmp_path):
        for _ in range(2):
            with pytest.raises(HeldError), claimed_output(tmp_path):
                pass
        assert (tmp_path / ROSTER).exists()


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


def test_of_a_long_log_only_the_end_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_folder, "MARKED_BYTES", 1000)
    log = state_log(tmp_path, "arm")
    assert log is not None
    for epoch in range(1, 30):
        log.write(epoch, 0, bytes(90), bytes([epoch] * 32))
    log.close()
    whole = (tmp_path / "states" / "arm.msgpack").stat().st_size
    assert 0 < output_folder._marked_bytes(tmp_path / "states" / "arm.msgpack") < whole
    with (tmp_path / "states" / "arm.msgpack").open("r+b") as file:
        file.write(b"\xc1" * 100)  # no msgpack: nothing before the mark would be found whole
        file.seek(0, os.SEEK_END)
        file.write(b"\x94\x1e")
    log = state_log(tmp_path, "arm", append=True)
    assert log is not None
    log.write(30, 0, b"", b"")
    log.close()
    assert (tmp_path / "states" / "arm.msgpack").read_bytes()[whole:] == msgpack.packb((30, 0, b"", b""))


def test_a_mark_of_another_log_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_folder, "MARKED_BYTES", 100)
    path = tmp_path / "states" / "arm.msgpack"
    for turn in (1, 2):
        log = state_log(tmp_path, "arm")
        assert log is not None
        mark = path.with_name(".arm.whole")
        assert not mark.exists(), "one that begins anew has none"
        for epoch in range(1, 9):
            log.write(epoch, 0, bytes(90), bytes([16 * turn + epoch] * 32))
        log.close()
        if turn == 1:
            first = mark.read_bytes()
    assert output_folder._marked_bytes(path)
    mark.write_bytes(first)
    assert not output_folder._marked_bytes(path)
    mark.write_bytes(b"torn")
    assert not output_folder._marked_bytes(path)
