"""Where a stream of Rerun's goes: a web viewer on this machine, a window, or a file."""

import ctypes
import importlib.util
import re
import signal
import socket
import subprocess
import time
import webbrowser
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from threading import Thread
from urllib.parse import quote

import rerun as rr

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.private_files import errors_named

HOST = "127.0.0.1"
WEB_PORT = 9090
UP_TIMEOUT_S = 20.0
_TRY_AGAIN_S, _LOOK_S = 0.02, 0.2
_PR_SET_PDEATHSIG = 1
_RRD = b"RRF"  # what Rerun's files begin with
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")

Stream = rr.RecordingStream


def stream_of(hierarchy: str) -> Stream:
    """A stream for what is shown of a run."""
    return rr.RecordingStream(f"hierax {hierarchy}")


@dataclass(frozen=True)
class Place:
    """Where a stream is seen; `until_closed` returns when the user has seen enough, None if nobody looks; `ended` tells
    whether what shows it has ended."""

    name: str
    until_closed: Callable[[], object] | None
    ended: Callable[[], bool] = lambda: False


@contextmanager
def web_viewer(stream: Stream, port: int | None, memory: str, opens: bool) -> Iterator[Place]:
    """A web viewer that shows a stream, on this machine's loopback alone; its place is the page's address. Rerun's own
    server listens on all addresses where it runs inside of a Python process, so it is started as a process, which is
    told where to. It ends with this one, and keeps so much memory, as ``1GiB``, for pages that are opened later.
    Without a port the page's is `WEB_PORT`, or a free one where that is taken; where it `opens`, it does so in a
    browser. Raises `HieraxError` if the port is taken, or the server does not start."""
    web_port, data_port = _free_port(WEB_PORT if port is None else port), _free_port()
    if port not in (None, web_port):
        raise HieraxError(f"--port {port}: another process listens there")
    options = ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", memory]
    with _viewer(stream, options, data_port, web_port) as process:
        address = f"http://{HOST}:{web_port}/?url={quote(_data_address(data_port), safe='')}"
        if opens:
            webbrowser.open(address)
        yield _seen(address, process)


def _seen(name: str, process: subprocess.Popen[bytes]) -> Place:
    """A place that a process shows, until that ends, or Ctrl-C; which is looked for again and again, as one that
    another thread takes wakes nobody who only waits."""

    def ended() -> bool:
        return process.poll() is not None

    def until_closed() -> None:
        while not ended():
            time.sleep(_LOOK_S)

    return Place(name, until_closed, ended)


@contextmanager
def window(stream: Stream, memory: str) -> Iterator[Place]:
    """Rerun's window, which keeps so much in memory and ends with this process; `HieraxError` if it does not open."""
    options = ["--hide-welcome-screen", "--memory-limit", memory]
    with _viewer(stream, options, _free_port()) as process:
        yield _seen("Rerun's window", process)


@contextmanager
def file(stream: Stream, path: Path, overwrite: bool = False) -> Iterator[Place]:
    """A file for Rerun, ``.rrd``, which is there, whole, after the block; where that raises, what was there stays.
    Raises `HieraxError` if it cannot be written, or is there already."""
    _check_replaceable(path, overwrite)
    whole = path.resolve()  # a link stays one
    unfinished = whole.with_name(f".{whole.name}.{token_hex(4)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.touch()
        stream.save(unfinished)
    except Exception as error:  # Rerun's own have no common class
        with suppress(OSError):
            unfinished.unlink()
        raise HieraxError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    try:
        yield Place(str(path), None)
        stream.flush()
        stream.disconnect()
        with errors_named(path):
            unfinished.replace(whole)
    finally:
        stream.disconnect()
        unfinished.unlink(missing_ok=True)


def _check_replaceable(path: Path, overwrite: bool) -> None:
    if path.exists() and not path.is_file():
        raise HieraxError(f"{path}: cannot be written: it is no regular file")
    try:
        with path.open("rb") as there:
            begin = there.read(len(_RRD))
    except OSError:
        return  # there is none, or it is told when it is written
    if begin and begin != _RRD:
        raise HieraxError(f"{path}: is no file of Rerun's, so it is not overwritten; name another file")
    if begin and not overwrite:
        raise HieraxError(f"{path}: is there already; --overwrite replaces it, or name another file")


class _Program:
    """Rerun's program, and what it says."""

    def __init__(self, command: Sequence[str]) -> None:
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for who looks, who ends it then
            preexec_fn=lambda: ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL),
        )
        self._said: deque[str] = deque(maxlen=20)
        self._listener = Thread(target=self._listen, daemon=True)
        self._listener.start()

    @property
    def last_words(self) -> str:
        """The line with the error, where there is one."""
        if self.process.poll() is not None:
            self._listener.join()
        lines = [_COLOURS.sub("", line).strip() for line in list(self._said)]
        return next((line for line in reversed(lines) if "error" in line.lower()), lines[-1] if lines else "")[:400]

    def close(self) -> None:
        self.process.terminate()
        self.process.wait()
        self._listener.join()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in lines:
                self._said.append(line.decode(errors="replace"))


@contextmanager
def _viewer(stream: Stream, options: Sequence[str], data_port: int, *ports: int) -> Iterator[subprocess.Popen[bytes]]:
    """Rerun's program, joined to a stream, until the block ends."""
    program = _Program([str(_path()), "--bind", HOST, "--port", str(data_port), *options])
    try:
        for port in (data_port, *ports):
            _wait_for(port, program)
        stream.connect_grpc(_data_address(data_port))
        yield program.process
        _flush(stream, program)
    finally:
        stream.disconnect()
        program.close()


def _flush(stream: Stream, program: _Program) -> None:
    """Have everything arrive, unless the window was closed."""
    ended = program.process.poll()
    reason = f"exit code {ended}" if ended else ""
    try:
        if ended is None:
            stream.flush()
    except Exception as error:  # Rerun's own have no common class
        reason = str(error) or type(error).__name__
    if reason:
        raise HieraxError(f"Rerun's viewer has ended: {program.last_words or reason}")


def _data_address(port: int) -> str:
    return f"rerun+http://{HOST}:{port}/proxy"


def _path() -> Path:
    """Rerun's program, which comes with the library."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec and spec.submodule_search_locations) or ():
        program = Path(folder) / "rerun"
        if program.exists():
            return program
    raise HieraxError("the installed rerun-sdk has no viewer: expected the program rerun_cli/rerun in it")


def _free_port(wanted: int = 0) -> int:
    """The wanted port, if it is free, or else any that is."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, wanted))
        except OSError:
            probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _wait_for(port: int, program: _Program) -> None:
    deadline = time.monotonic() + UP_TIMEOUT_S
    while True:
        with suppress(OSError):
            return socket.create_connection((HOST, port), timeout=1.0).close()
        if program.process.poll() is not None or time.monotonic() > deadline:
            raise HieraxError(f"Rerun's viewer does not listen on port {port}: {program.last_words}")
        time.sleep(_TRY_AGAIN_S)
