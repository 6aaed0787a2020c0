"""Two slots in turn: while one is written, the other holds the record before, whole.

A slot holds, little-endian: checksum (CRC-32, 4 bytes), sequence number and length (8 bytes each), then the data. The
checksum is over all that follows it, so that it does not matter which parts of a torn write reached the slot. Record n
(from 1) goes to slot n modulo 2: a slot that holds another one's, or not the one before the newest, was tampered with
or lost a write, and is damaged too."""

import struct
from typing import NamedTuple
from zlib import crc32

from hierax.runtime.recovery.disk import SLOTS, Storage

_CHECKSUM = struct.Struct("<I")
_HEAD = struct.Struct("<QQ")
_DATA = _CHECKSUM.size + _HEAD.size


class Read(NamedTuple):
    """What a slot holds."""

    slot: int  # 0 or 1
    sequence: int = 0  # the record's number, from 1; 0 where there is no whole one
    data: bytes | None = None  # the record; None where there is no whole one
    fault: str = ""  # what is wrong with the slot; empty where nothing is

    @property
    def empty(self) -> bool:
        return self.data is None and not self.fault


class Slots:
    """The last two records of a storage; not for two threads at once. Raises `HieraxError` if the storage fails."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage  # where they are; the next record goes where the newest whole one is not
        self._sequence = max(read.sequence for read in self.read())

    def write(self, data: bytes) -> None:
        """Write a record over the older of the two; the newer one stays as it is, whatever happens."""
        sequence = self._sequence + 1
        record = _HEAD.pack(sequence, len(data)) + data
        self._storage.write(sequence % SLOTS, _CHECKSUM.pack(crc32(record)) + record)
        self._storage.flush()
        self._sequence = sequence

    def read(self) -> tuple[Read, ...]:
        """What both slots hold, newest first.

        A damaged slot stands before a whole one, as its record may have been the newer; an empty one comes last."""
        reads = [_read(slot, self._storage.read(slot)) for slot in range(SLOTS)]
        newest = max(read.sequence for read in reads)
        reads = [_compared(read, newest) for read in reads]
        return tuple(sorted(reads, key=lambda read: (read.empty, not read.fault, -read.sequence)))


def without_padding(raw: bytes) -> bytes:
    """A slot's bytes without those behind its record, as files grow by powers of two; of one that is torn, all."""
    if len(raw) < _DATA:
        return raw
    _, length = _HEAD.unpack_from(raw, _CHECKSUM.size)
    return raw[: _DATA + length] if length else raw


def _read(slot: int, raw: bytes) -> Read:
    if len(raw) < _DATA:
        return Read(slot, fault=f"cut off: {len(raw)} bytes, not even the {_DATA} before the data")
    sequence, length = _HEAD.unpack_from(raw, _CHECKSUM.size)
    if not sequence and not any(raw):
        return Read(slot)
    if _DATA + length > len(raw):
        return Read(slot, fault=f"torn or cut off: its record has {length} bytes, {len(raw) - _DATA} are there")
    end = _DATA + length
    if _CHECKSUM.unpack_from(raw)[0] != crc32(memoryview(raw)[_CHECKSUM.size : end]):
        return Read(slot, fault="torn or damaged: the checksum does not fit its record")
    if not sequence or sequence % SLOTS != slot:
        return Read(slot, fault=f"holds record {sequence}, which is the other slot's")
    return Read(slot, sequence, raw[_DATA:end])


def _compared(read: Read, newest: int) -> Read:
    """A slot beside the newest whole record: the other must hold the one before."""
    before = newest - 1
    if read.fault or read.sequence in (newest, before):
        return read
    held = f"holds record {read.sequence}" if read.sequence else "is empty"
    return Read(read.slot, fault=f"{held}; record {before} should be there, as {newest} is in the other slot")
