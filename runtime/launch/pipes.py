"""Reading and writing pipes in an event loop. Zenoh is not imported: what processes are forked from needs this, too."""

import os
from contextlib import suppress

import anyio

READ_BYTES = 1 << 16  # at once


async def read_some(descriptor: int) -> bytes:
    """What comes next of a pipe, whether that blocks or not; nothing at its end."""
    while True:
        await anyio.wait_readable(descriptor)
        with suppress(BlockingIOError):
            return os.read(descriptor, READ_BYTES)


async def write_whole(descriptor: int, data: bytes) -> None:
    """Write all of it to a pipe that does not block. Raises OSError: nobody reads it any more."""
    left = memoryview(data)
    while left:
        try:
            left = left[os.write(descriptor, left) :]
        except BlockingIOError:  # noqa: PERF203 - it is full now and then
            await anyio.wait_writable(descriptor)
