"""A writer is killed at any instant: what it had written is there, whole."""

from __future__ import annotations

import importlib.util
import signal
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

from hierax.runtime.recovery.disk import Durability, MappedFile
from hierax.runtime.recovery.slots import Slots

SEED = 20
MAX_RECORDS = 30
SHORT_WORDS = 1 << 14
LONG_WORDS = 1 << 20
"""8 MB: writing them takes longer than `MAX_ALARM_US`."""

MAX_ALARM_US = 100
WRITER = Path(__file__).with_name("endless_writer.py")

_spec = importlib.util.spec_from_file_location("endless_writer", WRITER)
assert _spec is not None
assert _spec.loader is not None
writer = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(writer)


def killed_after(path: Path, durability: Durability, count: int) -> int:
    """Run a writer and kill it after so many records, or a little later; the last one that it told of."""
    command = [sys.executable, str(WRITER), str(path), durability, str(SHORT_WORDS), "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        told = process.stdout.read(count * writer.WORD_BYTES)
        process.kill()
        told += process.stdout.read()
    assert process.returncode == -signal.SIGKILL
    return last_of(told)


def killed_amid(path: Path, alarm_us: int) -> int:
    """Run a writer that is killed so many microseconds after a write began; the last record that it told of."""
    command = [sys.executable, str(WRITER), str(path), "process", str(LONG_WORDS), str(alarm_us)]
    process = subprocess.run(command, stdout=subprocess.PIPE, timeout=60, check=False)
    assert process.returncode == -signal.SIGALRM
    return last_of(process.stdout)


def last_of(told: bytes) -> int:
    assert told
    assert len(told) % writer.WORD_BYTES == 0
    return int.from_bytes(told[-writer.WORD_BYTES :], "big")


def is_torn(path: Path, last: int) -> bool:
    """Whether a record is damaged; asserts that what the writer told of is there, and nothing else."""
    with MappedFile(path) as storage:
        reads = Slots(storage).read()
    numbers = [writer.number_of(read.data) for read in reads if read.data is not None]
    where = f"seed {SEED}, told of {last}, read {numbers}, {[read.fault for read in reads]}"
    if any(read.fault for read in reads):
        assert numbers == [last], where
        return True
    assert numbers in ([last, last - 1][:last], [last + 1, last]), where
    return False


@pytest.mark.parametrize(("durability", "kills"), [("process", 20), ("host", 5)])
def test_a_killed_writer_leaves_what_it_told_of(tmp_path: Path, durability: Durability, kills: int) -> None:
    random = Random(SEED)
    path = tmp_path / "arm"
    for _ in range(kills):
        is_torn(path, killed_after(path, durability, random.randint(1, MAX_RECORDS)))


def test_a_writer_killed_amid_a_write_leaves_the_record_before(tmp_path: Path) -> None:
    random = Random(SEED)
    path = tmp_path / "arm"
    torn = [is_torn(path, killed_amid(path, random.randint(1, MAX_ALARM_US))) for _ in range(10)]
    print(f"{sum(torn)} of {len(torn)} records torn")
    assert any(torn)
