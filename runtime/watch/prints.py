"""What a node prints: on the console with the node's name, and in its log.

arm: what was printed
"""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Callable
from typing import Any, TextIO

from hierax.runtime.watch.logs import QUIET

LINE_BYTES = 1 << 16
"""A longer line is shown, and logged, in pieces."""

_ERRORS = "backslashreplace"


def name_prints(name: str) -> None:
    """Have what this process writes to `sys.stdout` and `sys.stderr` carry a name, and go to its log, too.

    Args:
        name: of the node.
    """
    console = os.dup(sys.__stderr__.fileno() if sys.__stderr__ is not None else 2)
    sys.stdout = _stream(name, console, "stdout")
    sys.stderr = _stream(name, console, "stderr")


def named_lines(stream: TextIO, name: Callable[[], str]) -> io.TextIOBase:
    """A stream whose lines carry a name, as far as there is one.

    Args:
        stream: where they go.
        name: asked when a line is begun; empty: nobody's.
    """
    return _Named(stream, name)


def _stream(name: str, console: int, channel: str) -> TextIO:
    buffer = io.BufferedWriter(_Lines(name, console, logging.getLogger(channel)))
    return io.TextIOWrapper(buffer, "utf-8", _ERRORS, line_buffering=True, write_through=True)


class _Lines(io.RawIOBase):
    """Takes bytes, gives lines."""

    def __init__(self, name: str, console: int, log: logging.Logger) -> None:
        super().__init__()
        self._prefix = f"{name}: ".encode()
        self._console = console
        self._log = log
        self._begun = bytearray()

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        """For programs that the node starts: what they say has no name."""
        return self._console

    def write(self, data: Any) -> int:
        self._begun += data
        *lines, rest = bytes(self._begun).split(b"\n")
        if len(rest) > LINE_BYTES:
            lines, rest = [*lines, rest], b""
        self._begun[:] = rest
        for line in lines:
            self._tell(line)
        return len(data)

    def _tell(self, line: bytes) -> None:
        told = memoryview(self._prefix + line + b"\n")
        try:
            while told:
                told = told[os.write(self._console, told) :]
        except OSError:
            pass  # nobody reads it any more; the log has it
        self._log.info("%s", line.decode(errors=_ERRORS), extra=QUIET)


class _Named(io.TextIOBase):
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
