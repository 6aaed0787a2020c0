"""What nodes print, and libraries and programs that they use: on the console with the node's name, and in the logs.

    arm: what was printed

Python's own prints are named in the node's process, which knows the epoch. Whatever else is written to descriptors
1 and 2 there goes through a pipe to the process's supervisor: that one is there when the process was killed, and reads
while a library prints and holds the interpreter's lock."""

from __future__ import annotations

import ctypes
import io
import logging
import os
import select
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TextIO

from hierax.runtime.watch.logs import QUIET

LINE_BYTES = 1 << 16  # A longer line is shown, and logged, in pieces

PATIENCE_S = 0.2
"""How long a line waits for somebody who reads the console; then lines are left out until somebody does."""

_ERRORS = "backslashreplace"
_BY_LINES = 1  # the C library's `_IOLBF`


class Console:
    """Writes to a descriptor that stays open. Who does not read holds nobody up for longer than `PATIENCE_S`."""

    def __init__(self, descriptor: int) -> None:
        self._given = descriptor
        self._descriptor = _unblocking(descriptor)
        self._waiting = b""
        self._left_out = 0

    def write(self, line: bytes) -> None:
        """Write a line, with its end."""
        if self._waiting:
            if not self._is_read(0.0):
                self._left_out += 1
                return
            if self._left_out:
                line = b"%d lines were left out here, as nobody read them\n%b" % (self._left_out, line)
        self._left_out = 0
        self._waiting += line
        with suppress(OSError):  # nobody can read it any more; the log has it
            while self._waiting and self._is_read(PATIENCE_S):
                with suppress(BlockingIOError):  # others have filled it meanwhile
                    self._waiting = self._waiting[os.write(self._descriptor, self._waiting) :]
            return
        self._waiting = b""

    def close(self) -> None:
        """Nothing more is told; the descriptor that was given stays open."""
        if self._descriptor != self._given:
            os.close(self._descriptor)

    def _is_read(self, within_s: float) -> bool:
        look = select.poll()
        look.register(self._descriptor, select.POLLOUT)
        return bool(look.poll(1000 * within_s))


def _unblocking(descriptor: int) -> int:
    """A pipe or terminal opened once more: whether writing waits stays as it is for others."""
    if stat.S_ISFIFO(os.fstat(descriptor).st_mode) or os.isatty(descriptor):
        with suppress(OSError):  # it is another user's
            return os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    return descriptor


class Lines(io.RawIOBase):
    """Takes bytes, gives lines to a log, and to the console with a name before each, if there is one."""

    def __init__(self, name: str, console: Console, log: Callable[[str], None]) -> None:
        super().__init__()
        self._prefix = f"{name}: ".encode() if name else b""
        self._console = console
        self._log = log
        self._begun = bytearray()

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        """The descriptor that programs get which the node starts."""
        return 1

    def write(self, data: Any) -> int:
        self._begun += data
        *lines, rest = bytes(self._begun).split(b"\n")
        if len(rest) > LINE_BYTES:
            lines, rest = [*lines, rest], b""
        self._begun[:] = rest
        for line in lines:
            self._console.write(self._prefix + line + b"\n")
            self._log(line.decode(errors=_ERRORS))
        return len(data)

    def end(self) -> None:
        """Take it that nothing more comes: what was begun is a line."""
        if self._begun:
            self.write(b"\n")


def name_prints(name: str, console: Console) -> None:
    """Have what this process writes to `sys.stdout` and `sys.stderr` carry a node's name, and go to its log, too."""
    sys.stdout = _stream(name, console, "stdout")
    sys.stderr = _stream(name, console, "stderr")
    print_c_by_lines()


def print_c_by_lines() -> None:
    """Have what the C library's `printf` is given go out line by line."""
    with suppress(AttributeError, OSError, ValueError):  # a C library that calls it otherwise
        library = ctypes.CDLL(None)
        library.setvbuf(ctypes.c_void_p.in_dll(library, "stdout"), None, _BY_LINES, 0)


def flush_c() -> None:
    """Have all go out that `printf` was given."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).fflush(None)


def console_stream(console: Console) -> TextIO:
    """A stream whose lines go to the console as they are."""
    return _text(Lines("", console, lambda line: None))


def _stream(name: str, console: Console, channel: str) -> TextIO:
    log = logging.getLogger(channel)
    return _text(Lines(name, console, lambda line: log.info("%s", line, extra=QUIET)))


def _text(lines: Lines) -> TextIO:
    return io.TextIOWrapper(io.BufferedWriter(lines), "utf-8", _ERRORS, line_buffering=True, write_through=True)


class NamedLines(io.TextIOBase):
    """A stream whose lines go to another one with the name of who begins them, as far as there is one."""

    def __init__(self, stream: TextIO, name: Callable[[], str]) -> None:
        super().__init__()
        self._stream = stream
        self._name = name
        self._is_new = True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def flush(self) -> None:
        self._stream.flush()

    def write(self, text: str) -> int:
        name = self._name()
        for line in text.splitlines(keepends=True):
            self._stream.write(f"{name}: {line}" if self._is_new and name else line)
            self._is_new = line.endswith("\n")
        return len(text)
