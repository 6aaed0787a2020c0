"""What a record costs, beside writing a file and putting it in place of the last one."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import pytest

from hierax.runtime.recovery.disk import Durability, MappedFile
from hierax.runtime.recovery.slots import Slots

SMALL_BYTES = 150
LARGE_BYTES = 100_000


def cost_us(write: Callable[[bytes], None], data: bytes, times: int) -> float:
    """The median, in microseconds."""
    costs = []
    for _ in range(times):
        begun_ns = time.perf_counter_ns()
        write(data)
        costs.append((time.perf_counter_ns() - begun_ns) / 1000)
    return median(costs)


def slots_cost_us(path: Path, durability: Durability, data: bytes, times: int) -> float:
    with MappedFile(path, durability) as storage:
        slots = Slots(storage)
        slots.write(data)
        slots.write(data)
        return cost_us(slots.write, data, times)


@pytest.mark.parametrize("size", [SMALL_BYTES, LARGE_BYTES])
def test_a_record_costs_less_than_a_file_put_in_place(tmp_path: Path, size: int) -> None:
    def replace(data: bytes) -> None:
        (tmp_path / "new").write_bytes(data)
        os.replace(tmp_path / "new", tmp_path / "there")

    data = os.urandom(size)
    process = slots_cost_us(tmp_path / "process", "process", data, 1000)
    host = slots_cost_us(tmp_path / "host", "host", data, 100)
    replaced = cost_us(replace, data, 200)
    print(f"{size} bytes: process {process:.2f} µs, host {host:.1f} µs, replaced file {replaced:.1f} µs")
    if size == SMALL_BYTES:  # a large one costs mostly its checksum, and a replaced file in memory as much
        assert process < replaced / 2
