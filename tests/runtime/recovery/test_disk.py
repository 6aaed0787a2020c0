"""Memory-mapped slots: growth, the lock, and files that are not what they should be."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recovery.disk import MAGIC, CheckpointError, Durability, MappedFile, kept_at
from hierax.runtime.recovery.slots import Read, Slots, without_padding

PAGE_BYTES = 4096


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "arm.checkpoint"


def slot_file(path: Path, slot: int) -> Path:
    return path.with_name(f"{path.name}.{slot}")


def written(path: Path, *records: bytes, durability: Durability = "process") -> None:
    with MappedFile(path, durability) as storage:
        slots = Slots(storage)
        for record in records:
            slots.write(record)


def read(path: Path) -> tuple[Read, ...]:
    with MappedFile(path) as storage:
        return Slots(storage).read()


@pytest.mark.parametrize("durability", ["process", "host"])
def test_records_are_read_by_the_next_one_who_opens(path: Path, durability: Durability) -> None:
    written(path, b"one", b"two", b"three", durability=durability)
    assert read(path) == (Read(1, 3, b"three"), Read(0, 2, b"two"))


def test_what_was_never_written_is_not_made(path: Path) -> None:
    assert kept_at(path, "process") is None
    assert list(path.parent.iterdir()) == []
    written(path, b"one")
    storage = kept_at(path, "process")
    assert storage is not None
    with storage:
        assert Slots(storage).read()[0] == Read(1, 1, b"one")


def test_a_slot_grows_alone_and_keeps_growing(path: Path) -> None:
    small, large, huge = b"small", os.urandom(3 * PAGE_BYTES), os.urandom(300_000)
    written(path, small, small)
    other = slot_file(path, 0).read_bytes()
    with MappedFile(path) as storage:
        slots = Slots(storage)
        slots.write(large)
        assert slot_file(path, 0).read_bytes() == other
        assert slots.read() == (Read(1, 3, large), Read(0, 2, small))
        slots.write(huge)
        slots.write(small)
        slots.write(huge)
    assert read(path) == (Read(0, 6, huge), Read(1, 5, small))
    assert (slot_file(path, 0).stat().st_size, slot_file(path, 1).stat().st_size) == (1 << 19, 1 << 14)


@pytest.mark.parametrize("size", [PAGE_BYTES - 29, PAGE_BYTES - 28, PAGE_BYTES - 27])
def test_a_record_may_fill_its_file_to_the_last_byte(path: Path, size: int) -> None:
    record = os.urandom(size)
    written(path, record)
    assert read(path)[0] == Read(1, 1, record)
    assert slot_file(path, 1).stat().st_size == (PAGE_BYTES if size <= PAGE_BYTES - 28 else 2 * PAGE_BYTES)


def test_a_full_disk_is_an_error_and_costs_no_record(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: int, offset: int, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with MappedFile(path) as storage:
        slots = Slots(storage)
        slots.write(b"one")
        slots.write(b"two")
        with monkeypatch.context() as patch:
            patch.setattr(os, "posix_fallocate", full)
            with pytest.raises(CheckpointError, match=r"checkpoint\.1: cannot be grown to 16384 bytes: No space left"):
                slots.write(bytes(10_000))
        assert slots.read() == (Read(0, 2, b"two"), Read(1, 1, b"one"))
        slots.write(b"three")
        assert slots.read() == (Read(1, 3, b"three"), Read(0, 2, b"two"))


def test_a_second_process_is_told_who_has_it(path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from hierax.runtime.recovery.disk import MappedFile;"
        "MappedFile(Path(sys.argv[1])); print('open', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        with pytest.raises(HieraxError) as raised:
            MappedFile(path)
        assert str(raised.value) == f"{path}: this checkpoint is in use by process {process.pid}"
        process.kill()
    written(path, b"mine")


def test_a_second_one_in_the_same_process_is_refused_too(path: Path) -> None:
    with MappedFile(path) as first:
        with pytest.raises(CheckpointError, match=f"in use by process {os.getpid()}$"):
            MappedFile(path)
        Slots(first).write(b"one")
    first.close()
    assert read(path)[0].data == b"one"


@pytest.mark.parametrize("slot", [0, 1])
@pytest.mark.parametrize("content", [b"# notes\n" * 100, b"hieraxC\x02" + bytes(4088), b"no"])
def test_a_foreign_file_is_refused_and_left_as_it_is(path: Path, slot: int, content: bytes) -> None:
    slot_file(path, slot).write_bytes(content)
    with pytest.raises(CheckpointError) as raised:
        MappedFile(path)
    assert str(slot_file(path, slot)) in str(raised.value)
    assert "is no checkpoint that this version can read" in str(raised.value)
    assert slot_file(path, slot).read_bytes() == content
    slot_file(path, slot).unlink()
    written(path, b"the lock is free again")


@pytest.mark.parametrize(
    ("kept", "fault"),
    [
        (0, "cut off: 0 bytes"),
        (3, "cut off: 0 bytes"),
        (len(MAGIC), "cut off: 0 bytes"),
        (len(MAGIC) + 19, "cut off: 19 bytes"),
        (len(MAGIC) + 100, "torn or cut off: its record has 5000 bytes, 80 are there"),
        (PAGE_BYTES, "torn or cut off: its record has 5000 bytes, 4068 are there"),
    ],
)
def test_a_file_cut_off_is_named_and_written_anew(path: Path, kept: int, fault: str) -> None:
    written(path, b"one", bytes(5000))
    os.truncate(slot_file(path, 0), kept)
    damaged, older = read(path)
    assert (damaged.slot, damaged.data, damaged.empty) == (0, None, False)
    assert damaged.fault.startswith(fault)
    assert older == Read(1, 1, b"one")
    written(path, b"two")
    assert read(path) == (Read(0, 2, b"two"), Read(1, 1, b"one"))


def test_a_file_that_lost_its_beginning_is_damaged_and_its_rest_stays_uncounted(path: Path) -> None:
    written(path, b"one", b"two", b"three")
    with slot_file(path, 1).open("r+b") as file:
        file.write(bytes(len(MAGIC)))
    damaged, older = read(path)
    assert (damaged.slot, damaged.data, damaged.empty) == (1, None, False)
    assert older == Read(0, 2, b"two")
    written(path, b"another three")
    assert read(path)[0] == Read(1, 3, b"another three")


def test_one_file_removed_is_damage_and_no_beginning(path: Path) -> None:
    written(path, b"one", b"two")
    slot_file(path, 0).unlink()
    assert read(path) == (Read(1, 1, b"one"), Read(0))
    written(path, b"two", b"three")
    slot_file(path, 0).unlink()
    damaged, whole = read(path)
    assert damaged.fault == "is empty; record 2 should be there, as 3 is in the other slot"
    assert whole == Read(1, 3, b"three")


def test_an_unfinished_file_of_a_process_that_died_is_no_obstacle(path: Path) -> None:
    path.with_name(f"{path.name}.0.new").write_bytes(b"half")
    written(path, b"one")
    assert read(path)[0].data == b"one"
    assert sorted(file.name for file in path.parent.iterdir()) == [f"{path.name}.{end}" for end in ("0", "1", "lock")]


def test_host_durability_waits_for_the_disk_after_each_write(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[tuple[str, bytes]] = []
    plain = os.fdatasync

    def fdatasync(file: int) -> None:
        plain(file)
        name = os.readlink(f"/proc/self/fd/{file}")
        synced.append((name, Path(name).read_bytes()[len(MAGIC) + 20 :][:3]))

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    written(path, b"one", b"two", durability="host")
    first, second = str(slot_file(path, 1)), str(slot_file(path, 0))
    assert synced == [(first, b"one"), (second, b"two")]
    written(path, b"six", durability="process")
    assert len(synced) == 2


def test_a_new_file_of_host_durability_is_on_disk_with_its_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.readlink(f"/proc/self/fd/{file}")))
    MappedFile(path, "host").close()
    first, second, folder = f"{path}.0.new", f"{path}.1.new", str(path.parent)
    assert synced == [first, second, folder]
    MappedFile(path, "host").close()
    assert synced[3:] == [folder]
    MappedFile(path, "process").close()
    assert len(synced) == 4


def test_a_disk_that_fails_to_flush_is_an_error(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(file: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", broken)
    with pytest.raises(CheckpointError, match=r"checkpoint\.1: cannot be flushed to disk: Input/output error"):
        written(path, b"one", durability="host")


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"none/arm\.lock: cannot be opened: No such file or directory"):
        MappedFile(tmp_path / "none" / "arm")


def test_an_unknown_durability_is_refused(path: Path) -> None:
    durability: Any = "forever"
    with pytest.raises(ValueError, match="durability 'forever'; expected one of process, host"):
        MappedFile(path, durability)


def test_a_slot_is_sent_on_without_what_its_file_has_behind_the_record(path: Path) -> None:
    records = bytes(70_000), bytes(70_001)
    written(path, *records)
    with MappedFile(path) as storage:
        raw = [storage.read(slot) for slot in range(2)]
    assert [len(each) for each in raw] == [131_072 - len(MAGIC)] * 2
    sent = [without_padding(each) for each in raw]
    assert [len(each) - 70_000 for each in sent] == [20 + 1, 20]
    with MappedFile(path.with_name("there")) as storage:
        for slot, each in enumerate(sent):
            storage.write(slot, each)
        assert [found.data for found in Slots(storage).read()] == [records[1], records[0]]


def test_a_slot_without_a_record_is_sent_on_as_it_is(path: Path) -> None:
    torn = bytes(12) + (1 << 40).to_bytes(8, "little") + bytes(100)
    for raw in (b"", bytes(10), bytes(4088), torn):
        assert without_padding(raw) == raw
