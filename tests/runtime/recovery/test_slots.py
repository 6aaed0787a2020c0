"""Whatever part of a write reaches the slots: one of the last two records is read whole, and damage is named."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.recovery.disk import SLOTS, Storage
from hierax.runtime.recovery.slots import Read, Slots

BLOCK_BYTES = 64
MAX_BLOCKS = 8
FIRST_BYTES = 128
patient = settings(max_examples=400)


class TornError(HieraxError):
    """The crash."""


class Write(NamedTuple):
    """A record, and how much of it reaches the disk.

    Attributes:
        data: the record.
        reaches: a number of bytes from its start, or the numbers of blocks; None: all.
    """

    data: bytes
    reaches: int | frozenset[int] | None = None


class TornDisk(Storage):
    """Slots in memory; a write reaches them as far as `reaches` says, and if not wholly, the process dies."""

    def __init__(self) -> None:
        self.slots = [bytearray(FIRST_BYTES) for _ in range(SLOTS)]
        self.reaches: int | frozenset[int] | None = None
        self.written: tuple[int, bytes] = (0, b"")
        self.flushed = True

    def write(self, slot: int, data: bytes) -> None:
        self.written = (slot, data)
        self.flushed = False
        kept = self.slots[slot]
        kept.extend(bytes(max(0, len(data) - len(kept))))
        for start in range(0, len(data), BLOCK_BYTES):
            end = min(start + BLOCK_BYTES, len(data))
            if isinstance(self.reaches, int):
                end = min(end, self.reaches)
            elif self.reaches is not None and start // BLOCK_BYTES not in self.reaches:
                continue
            if end > start:
                kept[start:end] = data[start:end]
        if self.reaches is not None:
            raise TornError("torn")

    def read(self, slot: int) -> bytes:
        return bytes(self.slots[slot])

    def flush(self) -> None:
        self.flushed = True


records = st.one_of(
    st.binary(max_size=200),
    st.builds(lambda byte, size: bytes([byte]) * size, st.integers(0, 2), st.integers(0, MAX_BLOCKS * BLOCK_BYTES)),
    st.builds(lambda word, times: word.to_bytes(8, "big") * times, st.integers(0, 300), st.integers(0, MAX_BLOCKS * 8)),
)
tears = st.one_of(st.integers(0, MAX_BLOCKS * BLOCK_BYTES), st.frozensets(st.integers(0, MAX_BLOCKS)))
writes = st.lists(st.builds(Write, records, st.none() | tears), max_size=8)


def numbered(history: list[Write]) -> list[Write]:
    """Each record with its number, so that no two are the same."""
    return [Write(bytes([index]) + data, reaches) for index, (data, reaches) in enumerate(history)]


@patient
@given(writes)
@example([Write(b"old"), Write(b"older" * 20), Write(b"new" * 40, frozenset())])
@example(
    [Write(bytes(43) + b"\1"), Write(b""), Write(bytes(44), frozenset({1})), Write(bytes(43) + b"\1", frozenset({1}))]
)
@example([Write(bytes(43) + b"\1", frozenset({1})), Write(bytes(44), 21), Write(bytes(44), frozenset({1}))])
@example([Write(b"a" * 100), Write(b"b" * 100, frozenset({1}))])
def test_only_the_last_two_whole_records_are_ever_read(history: list[Write]) -> None:
    disk = TornDisk()
    slots = Slots(disk)
    whole: list[bytes] = []
    frames: dict[int, bytes] = {}  # by slot, the last one that is whole in it
    torn: dict[int, list[tuple[bytes, bytes]]] = {0: [], 1: []}  # by slot, frames and data since then
    for write in numbered(history):
        disk.reaches = write.reaches
        if write.reaches is None:
            slots.write(write.data)
            frames[disk.written[0]] = disk.written[1]
            torn[disk.written[0]].clear()
            whole.append(write.data)
            assert disk.flushed
            assert [read.data for read in slots.read() if not read.empty] == whole[:-3:-1]
            continue
        with pytest.raises(TornError):
            slots.write(write.data)
        slot, frame = disk.written
        reads = Slots(disk).read()
        torn[slot].append((frame, write.data))
        # the newest one, or an earlier one that a later one has completed: it says itself which it is
        completed = [each for each in reversed(torn[slot]) if disk.slots[slot].startswith(each[0])]
        if completed:
            frames[slot], data = completed[0]
            whole.append(data)
            torn[slot].clear()
            expected: list[bytes | None] = list(whole[:-3:-1])
        elif slot in frames and disk.slots[slot].startswith(frames[slot]):
            expected = list(whole[:-3:-1])
        elif slot not in frames and not any(disk.slots[slot]):
            expected = list(whole[-1:])
        else:  # the frame before stays in mind: a torn write may put back what an earlier one had torn from it
            expected = [None, *whole[-1:]]
        assert [read.data for read in reads if not read.empty] == expected
        slots = Slots(disk)


@patient
@given(records, records, st.data())
def test_no_flipped_bit_gives_another_record(first: bytes, second: bytes, data: st.DataObject) -> None:
    disk = TornDisk()
    slots = Slots(disk)
    slots.write(first)
    slots.write(second)
    slot, frame = disk.written
    bit = data.draw(st.integers(0, 8 * len(frame) - 1), "bit")
    disk.slots[slot][bit // 8] ^= 1 << bit % 8
    damaged, older = Slots(disk).read()
    assert (damaged.slot, damaged.data, damaged.sequence) == (slot, None, 0)
    assert damaged.fault
    assert (older.slot, older.data, older.fault) == (1 - slot, first, "")


def test_nothing_written_is_empty_and_not_damaged() -> None:
    assert Slots(TornDisk()).read() == (Read(0), Read(1))
    assert all(read.empty for read in Slots(TornDisk()).read())


def test_an_empty_record_is_a_record() -> None:
    disk = TornDisk()
    Slots(disk).write(b"")
    assert Slots(disk).read() == (Read(1, 1, b""), Read(0))


def filled(count: int) -> TornDisk:
    """A disk with records ``record 1`` to ``record COUNT``."""
    disk = TornDisk()
    slots = Slots(disk)
    for number in range(1, count + 1):
        slots.write(b"record %d" % number)
    return disk


def test_numbers_go_on_in_the_next_process() -> None:
    disk = filled(4)
    Slots(disk).write(b"record 5")
    assert Slots(disk).read() == (Read(1, 5, b"record 5"), Read(0, 4, b"record 4"))


def test_the_newest_is_kept_while_a_damaged_one_is_written_over() -> None:
    disk = filled(4)
    disk.slots[1][30] ^= 1
    Slots(disk).write(b"again 5")
    assert Slots(disk).read() == (Read(1, 5, b"again 5"), Read(0, 4, b"record 4"))


def test_a_write_that_failed_is_done_again_over_the_same_slot() -> None:
    disk = filled(4)
    slots = Slots(disk)
    disk.reaches = 20
    for _ in range(3):
        with pytest.raises(TornError):
            slots.write(b"never there")
        assert Slots(disk).read()[1] == Read(0, 4, b"record 4")
    disk.reaches = None
    slots.write(b"record 5")
    assert Slots(disk).read() == (Read(1, 5, b"record 5"), Read(0, 4, b"record 4"))


def test_two_damaged_slots_give_no_record() -> None:
    disk = filled(4)
    disk.slots[0][0] ^= 1
    disk.slots[1][0] ^= 1
    reads = Slots(disk).read()
    assert [(read.data, read.empty) for read in reads] == [(None, False)] * 2
    assert all("checksum" in read.fault for read in reads)


def test_a_slot_that_lost_a_record_is_named() -> None:
    disk = filled(4)
    before = bytes(disk.slots[1])
    slots = Slots(disk)
    for number in range(5, 9):
        slots.write(b"record %d" % number)
    disk.slots[1][:] = before
    assert Slots(disk).read() == (
        Read(1, fault="holds record 3; record 7 should be there, as 8 is in the other slot"),
        Read(0, 8, b"record 8"),
    )


def test_a_slot_emptied_later_is_not_taken_for_a_new_one() -> None:
    disk = filled(2)
    disk.slots[1][:] = bytes(FIRST_BYTES)
    assert Slots(disk).read() == (
        Read(1, fault="is empty; record 1 should be there, as 2 is in the other slot"),
        Read(0, 2, b"record 2"),
    )


def test_slots_that_changed_places_are_named() -> None:
    disk = filled(2)
    disk.slots.reverse()
    assert Slots(disk).read() == (
        Read(0, fault="holds record 1, which is the other slot's"),
        Read(1, fault="holds record 2, which is the other slot's"),
    )


@pytest.mark.parametrize(
    ("kept", "fault"),
    [
        (0, "cut off: 0 bytes, not even the 20 before the data"),
        (19, "cut off: 19 bytes, not even the 20 before the data"),
        (20, "torn or cut off: its record has 8 bytes, 0 are there"),
        (27, "torn or cut off: its record has 8 bytes, 7 are there"),
    ],
)
def test_a_slot_cut_off_is_named(kept: int, fault: str) -> None:
    disk = filled(2)
    del disk.slots[0][kept:]
    assert Slots(disk).read() == (Read(0, fault=fault), Read(1, 1, b"record 1"))
