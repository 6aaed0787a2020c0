"""What libraries in C and programs print that a node starts: named, and in a log.

A node's process has a pipe at its descriptors 1 and 2, which its supervisor reads.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress

import anyio

from hierax.runtime.watch.logs import OUTPUT, LaunchLog, log_of_run
from hierax.runtime.watch.prints import Console, Lines

CHANNEL = "output"  # the logger's name in such entries
PIPE_BYTES = 1 << 20  # what is printed waits for a supervisor that is stopped, up to here; where there may be so much

READ_BYTES = 1 << 16


class Overhearing:
    """Takes in what the processes of one supervisor print."""

    def __init__(self, run: str, epoch: Callable[[], int]) -> None:
        self._run = run  # its identification
        self._epoch = epoch  # asked at every line
        self._log: LaunchLog | None = None
        self.console = os.dup(2)  # a descriptor for what the processes say themselves; they inherit it
        self._out = Console(self.console)

    def of(self, name: str) -> Overheard:
        """A pipe for a node's process."""
        return Overheard(Lines(name, self._out, lambda line: self._write(name, line)))

    def close(self) -> None:
        self._out.close()
        os.close(self.console)
        if self._log is not None:
            self._log.close()

    def _write(self, name: str, line: str) -> None:
        if self._log is None:  # most nodes say nothing in this way
            self._log = log_of_run(self._run, f"{OUTPUT}{os.getpid()}", self._epoch)
        self._log.write(line, name, CHANNEL)


class Overheard:
    """Takes in what one process prints."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines  # take it
        self._is_heard = False
        self._reading, self.writing = os.pipe()
        os.set_blocking(self._reading, False)
        with suppress(OSError):
            fcntl.fcntl(self.writing, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    async def listen(self) -> None:
        """Take in what comes, until nobody has the pipe any more; at last, what is there."""
        self._is_heard = True
        try:
            while self._take():
                await anyio.wait_readable(self._reading)
        finally:
            self._is_heard = False
            self.close()

    def close(self) -> None:
        """Take in the last words of a process that has ended."""
        if self._reading < 0:
            return
        for _ in range(PIPE_BYTES // READ_BYTES):  # what a program that is still there says further is its own matter
            if not self._take():
                break
        if not self._is_heard:  # else who waits for the pipe closes it
            self._lines.end()
            os.close(self._reading)
            self._reading = -1

    def _take(self) -> bool:
        """Take in what is there; whether more may come."""
        try:
            data = os.read(self._reading, READ_BYTES)
        except BlockingIOError:
            return True
        self._lines.write(data)
        return bool(data)
