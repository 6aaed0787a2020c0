"""Pipes in an event loop: more is written than one holds, and read as it comes."""

from __future__ import annotations

import os

import anyio
import pytest

from hierax.runtime.launch.pipes import read_some, write_whole


def test_more_than_a_pipe_holds_is_written_whole() -> None:
    data = bytes(range(256)) * (1 << 12)

    async def run() -> bytes:
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        came = b""

        async def write() -> None:
            await write_whole(writing, data)
            os.close(writing)

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(write)
            while some := await read_some(reading):
                came += some
        os.close(reading)
        return came

    assert anyio.run(run) == data


def test_what_nobody_reads_is_an_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    os.set_blocking(writing, False)
    with pytest.raises(BrokenPipeError):
        anyio.run(write_whole, writing, b"x")
    os.close(writing)
