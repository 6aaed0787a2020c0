"""A process's standard streams, and how further Python processes are started: without modules of the current folder,
and ignoring Ctrl-C, which is for who has started them, who ends them.

Zenoh prints its log to descriptor 1, as do libraries that nodes use. A process that calls `own_streams` or `own_output`
has descriptor 1 lead to standard error, and keeps the real standard output for what it says itself."""

import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from hierax.runtime.core.errors import HieraxError

_BEGIN = (
    "import sys; sys.path[:1] == [''] and sys.path.pop(0); del sys.argv[0]; "
    "import _signal; _signal.signal(2, _signal.SIG_IGN); _signal.pthread_sigmask(_signal.SIG_UNBLOCK, {2}); "
)
"""With `-c` the current folder stands first; until it is gone, nothing is imported that is not built in. (`-P` is there
from 3.11 on.)"""

_AS_MODULE = f"{_BEGIN}import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
_NAME_BYTES = 15  # of a process, as Linux keeps it
_REPLACED = "backslashreplace"  # what becomes of characters that the stream's encoding does not have


def python_module(module: str, *arguments: str) -> Sequence[str]:
    """The command that runs a module as ``python -m`` does, but for the current folder. Python looks there before
    anywhere else, so that a user's ``queue.py`` would stand in the place of the standard library's. Modules of a
    deployment's own are found behind all others (`loader.extend_import_path`)."""
    return [sys.executable, "-c", _AS_MODULE, module, *arguments]


def python_code(code: str, *arguments: str) -> Sequence[str]:
    """The command that runs code, as `python_module` does, with ``sys`` imported, and ``sys.argv`` the arguments."""
    return [sys.executable, "-c", f"{_BEGIN}{code}", *arguments]


@contextmanager
def started_deaf() -> Iterator[None]:
    """Around the start of processes by `python_module` or `python_code`: Ctrl-C waits until they ignore it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which they inherit
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def name_process(name: str) -> None:
    """Have lists of processes show a name for this one; of what is long, its beginning."""
    with suppress(OSError):
        Path("/proc/self/comm").write_bytes(name.encode()[:_NAME_BYTES])


class StandardOutputError(HieraxError):
    """Standard output cannot be written."""


def own_output() -> int:
    """Have all that others write to descriptor 1 go to standard error; a descriptor for standard output."""
    for descriptor, stream in enumerate((sys.__stdin__, sys.__stdout__, sys.__stderr__)):
        if stream is None:  # closed: what is opened next must not take its place
            nothing = os.open(os.devnull, os.O_WRONLY if descriptor == 2 else os.O_RDONLY)
            if nothing != descriptor:
                os.dup2(nothing, descriptor)
                os.close(nothing)
    output = os.dup(1)
    os.dup2(2, 1)
    return output


def own_input() -> int:
    """Have nobody else read what comes to descriptor 0; a descriptor for it."""
    given = os.dup(0)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    return given


def own_streams() -> None:
    """The same, with `sys.stdout` and `sys.stderr` for what this process says itself. What cannot be encoded is
    escaped; `StandardOutputError` is raised where standard output cannot be written; what cannot be written to standard
    error is left out."""
    encodings = [stream.encoding if stream is not None else "utf-8" for stream in (sys.stdout, sys.stderr)]
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    output = own_output()
    terminal = os.isatty(output)
    sys.stdout = _text(io.BufferedWriter(_Output(output, "w")), encodings[0], line_buffering=terminal)
    # a descriptor of its own: that of what others write may lead elsewhere for a while
    sys.stderr = _text(io.BufferedWriter(_Errors(os.dup(2), "w")), encodings[1], write_through=True)


def printable(text: str, kept: str = "\n\t") -> str:
    """A text of foreign make for a terminal: what would move the cursor, or do more, is written out, but for the
    characters of `kept`; without them it stays in its line."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() or each in kept else repr(each)[1:-1] for each in text)


def own_errors() -> int | None:
    """The descriptor to which this process writes its own errors; None: it has no streams of its own."""
    raw = getattr(getattr(sys.stderr, "buffer", None), "raw", None)
    return raw.fileno() if isinstance(raw, _Errors) else None


def drop_output() -> None:
    """Let what was not written yet, and what follows, go nowhere: it cannot be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _text(buffer: io.BufferedWriter, encoding: str, **options: bool) -> TextIO:
    options.setdefault("line_buffering", True)
    return io.TextIOWrapper(buffer, encoding, _REPLACED, **options)  # type: ignore[arg-type]


class _Output(io.FileIO):
    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise StandardOutputError(f"standard output: cannot be written: {error.strerror or error}") from error


class _Errors(io.FileIO):
    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(data)
