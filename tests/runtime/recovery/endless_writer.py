"""A process that writes records until it is killed: ``endless_writer.py PATH DURABILITY WORDS ALARM_US``.

A record is one word over and over: its number and how many words it has, from half of WORDS up to it. The number
goes to the standard output when the record is written. With an alarm that is not 0 the kernel kills the process so
many microseconds after a write has begun, if that is not done by then; the first two are spared.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from random import Random

from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots

WORD_BYTES = 8
SPARED_WRITES = 2
_COUNT_BITS = 32


class AlarmedFile(MappedFile):
    """Slots whose writing is cut short by a signal that nobody handles."""

    alarm_us = 0

    def write(self, slot: int, data: bytes) -> None:
        signal.setitimer(signal.ITIMER_REAL, self.alarm_us / 1e6)
        super().write(slot, data)
        signal.setitimer(signal.ITIMER_REAL, 0)


def record(number: int, words: int) -> bytes:
    """A record with its own check."""
    return (number << _COUNT_BITS | words).to_bytes(WORD_BYTES, "big") * words


def number_of(data: bytes) -> int:
    """The number of a record; asserts that it is whole."""
    number, words = divmod(int.from_bytes(data[:WORD_BYTES], "big"), 1 << _COUNT_BITS)
    assert data == record(number, words), f"a record that begins like {number} is not it"
    return number


def main() -> None:
    """Write until killed."""
    storage = AlarmedFile(Path(sys.argv[1]), sys.argv[2])  # type: ignore[arg-type]
    most, alarm_us = int(sys.argv[3]), int(sys.argv[4])
    slots = Slots(storage)
    first = 1 + max(number_of(read.data) if read.data else 0 for read in slots.read())
    number = first
    while True:
        storage.alarm_us = alarm_us if number >= first + SPARED_WRITES else 0
        slots.write(record(number, Random(number).randint(most // 2, most)))
        os.write(sys.stdout.fileno(), number.to_bytes(WORD_BYTES, "big"))
        number += 1


if __name__ == "__main__":
    main()
