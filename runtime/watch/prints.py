"""What nodes print, and libraries and programs that they use: on the console with the node's name, and in the logs.

    arm: what was printed

Python's own prints are named in the node's process, which knows the epoch. Whatever else is written to descriptors
1 and 2 there goes through a pipe to the process's supervisor: that one is there when the process was killed, and reads
while a library prints and holds the interpreter's lock. In `hierax run` nodes take turns in one process; see `_Turns`.
"""

import ctypes
import io
import json
import logging
import mmap
import os
import select
import stat
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from hierax.runtime.host.streams import own_errors, python_module, started_deaf
from hierax.runtime.watch.logs import NODE, QUIET

LINE_BYTES = 1 << 16  # A longer line is shown, and logged, in pieces

PATIENCE_S = 0.2
"""How long a line waits for somebody who reads the console; then lines are left out until somebody does."""

_ERRORS = "backslashreplace"
_BY_LINES = 1  # the C library's `_IOLBF`
TURNS = 5_000  # after so many in which nobody has printed, descriptors stay where they are
READ_BYTES = 1 << 16
END_S = 1.0  # how long what was printed may take to be read; programs that are left running keep the reader

Turn = Callable[[str], None]  # told the node whose turn it is


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
    """Takes bytes, gives lines to a log, and to the console with a name before each, if there is one; not those that
    are somebody else's to tell, who is given them first."""

    def __init__(
        self, name: str, console: Console, log: Callable[[str], None], tells: Callable[[str], bool] = lambda line: False
    ) -> None:
        super().__init__()
        self._tells = tells  # whether somebody else tells of a line
        self._is_told = False  # whether it was so of the beginning of what comes
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
        whole = len(lines)
        if len(rest) > LINE_BYTES:
            lines, rest = [*lines, rest], b""
        self._begun[:] = rest
        for number, line in enumerate(lines):
            self._take(line, ends=number < whole)
        return len(data)

    def _take(self, line: bytes, ends: bool) -> None:
        """Take a line, or a piece of one that does not end there."""
        told = line.decode(errors=_ERRORS)
        is_told = self._is_told or self._tells(told)
        self._is_told = is_told and not ends
        if not is_told:
            self._console.write(self._prefix + line + b"\n")
            self._log(told)

    def end(self) -> None:
        """Take it that nothing more comes: what was begun is a line."""
        if self._begun:
            self.write(b"\n")


def name_prints(name: str, console: Console, nodes: Collection[str] = ()) -> None:
    """Have what this process writes to `sys.stdout` and `sys.stderr` carry a node's name, and go to its log, too; where
    several nodes share the process, that of whose work it is, or else the process's."""
    names = dict.fromkeys((*nodes, name))
    for channel in ("stdout", "stderr"):
        streams = {each: _stream(each, console, channel) for each in names}
        setattr(sys, channel, streams[name] if len(names) == 1 else _ByNode(streams, streams[name]))
    print_c_by_lines()


class _ByNode(io.TextIOBase):
    """A stream that leads to that of the node whose work is being done."""

    def __init__(self, streams: Mapping[str, TextIO], otherwise: TextIO) -> None:
        super().__init__()
        self._streams = streams
        self._otherwise = otherwise

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._otherwise.encoding

    @property
    def buffer(self) -> Any:
        return self._now.buffer

    @property
    def _now(self) -> TextIO:
        return self._streams.get(NODE.get(), self._otherwise)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._otherwise.fileno()

    def flush(self) -> None:
        self._now.flush()

    def write(self, text: str) -> int:
        return self._now.write(text)


def print_c_by_lines() -> None:
    """Have what the C library's `printf` is given go out line by line."""
    with suppress(AttributeError, OSError, ValueError):  # a C library that calls it otherwise
        library = ctypes.CDLL(None)
        library.setvbuf(ctypes.c_void_p.in_dll(library, "stdout"), None, _BY_LINES, 0)


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


class _Turns:
    """At a node's turn descriptors 1 and 2 lead to a pipe of that node; what it starts keeps it. Another process reads
    all of them. As a change of descriptors takes a while, they stay where they are when nobody has printed for long;
    what is printed first after that carries the deployment's name."""

    def __init__(self, names: Collection[str], otherwise: str, console: int) -> None:
        self._given = [os.dup(1), os.dup(2)]
        pipes = {name: os.pipe() for name in ("", *sorted(names))}  # no node has an empty name
        self._writing = {name: writing for name, (_, writing) in pipes.items()}
        shared = os.memfd_create("printed")
        os.ftruncate(shared, 1)
        self._printed = mmap.mmap(shared, 1)  # not zero when somebody has printed
        reading = {reading: name or otherwise for name, (reading, _) in pipes.items()}
        command = python_module("hierax.runtime.watch.prints", str(console), str(shared), json.dumps(reading))
        with started_deaf():
            self._reader = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=(console, shared, *reading), start_new_session=True
            )
        for descriptor in (shared, *reading):
            os.close(descriptor)
        print_c_by_lines()
        self._left = TURNS
        self._lead_to("")

    def __call__(self, name: str) -> None:
        if self._left:
            if name != self._now:
                self._lead_to(name if name in self._writing else "")
            self._left -= 1
            if not self._left:
                self._lead_to("")
        elif self._printed[0]:
            self._printed[0] = 0
            self._left = TURNS

    def close(self) -> None:
        """Lead them back, when all was read."""
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).fflush(None)  # what `printf` was given
        for number, descriptor in enumerate(self._given, 1):
            os.dup2(descriptor, number)
        for descriptor in (*self._given, *self._writing.values()):
            os.close(descriptor)
        with suppress(subprocess.TimeoutExpired):
            self._reader.wait(END_S)
        self._reader.returncode = self._reader.returncode or 0  # it is left to itself

    def _lead_to(self, name: str) -> None:
        self._now = name
        for number in (1, 2):
            os.dup2(self._writing[name], number)


@contextmanager
def named_turns(names: Collection[str], otherwise: str) -> Iterator[Turn | None]:
    """While the block runs, what nodes print carries their names, or else another; None: streams are not our own."""
    console = own_errors()
    if console is None:
        yield None
        return
    turns = _Turns(names, otherwise, console)
    try:
        yield turns
    finally:
        turns.close()


def main() -> None:
    """Read what is printed, and show it, until nobody has the pipes any more."""
    console, shared, names = Console(int(sys.argv[1])), int(sys.argv[2]), json.loads(sys.argv[3])
    printed = mmap.mmap(shared, 1)
    lines = {int(reading): Lines(name, console, lambda line: None) for reading, name in names.items()}
    look = select.poll()
    for reading in lines:
        look.register(reading, select.POLLIN)
    while lines:
        for reading, _ in look.poll():
            data = os.read(reading, READ_BYTES)
            printed[0] = 1
            lines[reading].write(data)
            if not data:
                look.unregister(reading)
                lines.pop(reading).end()


if __name__ == "__main__":
    main()
