"""A `hierax launch` under way, watched from outside: its words, its nodes' processes, its commits."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar
from unittest.mock import patch

import msgpack

from hierax.runtime.commands.main import main
from hierax.runtime.launch.fork_server import FORKING
from support import faults

HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
TESTS = Path(__file__).parents[1]
TIMEOUT_S = 60.0

C = TypeVar("C", bound="Command")


def environment(folder: Path | None = None) -> dict[str, str]:
    """In which the tests' own nodes are found; and, with a folder, no launches but those of this folder."""
    here = {} if folder is None else {"XDG_RUNTIME_DIR": str(folder)}
    path = [TESTS, TESTS / "support" / "planted"] if faults.FOLDER in os.environ else [TESTS]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path)), **here}


def hierax(*arguments: str) -> dict[str, Any]:
    """What a command prints as JSON.

    Raises:
        RuntimeError: it failed.
    """
    command = [*HIERAX, *arguments, "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment(), check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {done.stderr}")
    return dict(json.loads(done.stdout))


def run_here(*arguments: str) -> dict[str, Any]:
    """What ``hierax run`` prints as JSON, in this process, as another one's start takes longer than most runs.

    Raises:
        RuntimeError: it failed.
    """
    done = said_here("run", *arguments, "--format", "json")
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {done.stderr}")
    return dict(json.loads(done.stdout))


def said_here(*arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """What a command says that is done in this process; with a folder, it knows the launches of this folder alone."""
    out, err = io.StringIO(), io.StringIO()
    with patch.dict(os.environ, environment(folder)), redirect_stdout(out), redirect_stderr(err):
        code = main(arguments)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def is_alive(pid: int) -> bool:
    """Whether there is such a process, and it has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def processes_of(parent: int) -> list[int]:
    """The children of a process, if it lives, and, in place of what nodes are forked from, those."""
    own = command_of(parent)
    children = [pid for pid in processes_below(parent) if command_of(pid) not in (own, [])]  # their program has begun
    return [pid for child in children for pid in (processes_below(child) if FORKING in command_of(child) else [child])]


def processes_below(parent: int) -> list[int]:
    """The children of a process, if it lives."""
    try:
        return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []


def command_of(pid: int) -> list[str]:
    """A process's arguments, if it lives."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().split("\0")[:-1]
    except (FileNotFoundError, ProcessLookupError):
        return []


def until(condition: Callable[[], bool], what: str, timeout_s: float = TIMEOUT_S) -> float:
    """Seconds until a condition holds."""
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < timeout_s, f"not within {timeout_s:g} s: {what}"
        time.sleep(0.002)
    return time.monotonic() - begun


class Command:
    """A command under way; at the block's end nothing of it is left.

    Args:
        folder: whose launches it knows.
        arguments: of ``hierax``.

    Attributes:
        printed: the lines that it has written to standard output.
        said: those that it has written to standard error, and when.
    """

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [*HIERAX, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(folder),
            start_new_session=True,
        )
        self.said: list[tuple[float, str]] = []
        self.printed: list[str] = []
        self._readers = [threading.Thread(target=read, daemon=True) for read in (self._read_out, self._read_err)]
        for reader in self._readers:
            reader.start()

    @property
    def err(self) -> str:
        """All that it has written to standard error."""
        return "\n".join(line for _, line in self.said)

    def until_said(self, words: str, timeout_s: float = TIMEOUT_S) -> float:
        """When it has first written a line with these words, by the monotonic clock."""
        patience = time.monotonic() + timeout_s
        while self._when(words) is None and self.running and time.monotonic() < patience:
            time.sleep(0.002)
        when = self._when(words)
        assert when is not None, f"there is no {words!r} in\n{self.err}"
        return when

    @property
    def running(self) -> bool:
        """Whether it goes on, or its last words are not read yet."""
        return any(reader.is_alive() for reader in self._readers)

    def end(self, timeout_s: float = TIMEOUT_S) -> str:
        """Wait for its end; what it has written to standard output."""
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"it does not end; it said\n{self.err}") from error
        for reader in self._readers:
            reader.join(TIMEOUT_S)
        return "".join(self.printed)

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pid in processes_of(self.process.pid):
            os.kill(pid, signal.SIGKILL)
        self.process.kill()
        self.end()

    def _when(self, words: str) -> float | None:
        return next((when for when, line in list(self.said) if words in line), None)

    def _read_out(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self.printed.append(line)

    def _read_err(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in lines:
                self.said.append((time.monotonic(), line.rstrip("\n")))


class Launched(Command):
    """A launch with an output folder and checkpoints that stay.

    Args:
        folder: for both.
        arguments: of ``hierax launch``.
    """

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.state = folder / "state"
        self.output = folder / "output"
        self._killed: dict[str, int] = {}
        places = () if "--resume" in arguments else ("--state", str(self.state))
        super().__init__(folder, "launch", *arguments, *places, "--output", str(self.output), "--format", "json")

    def pid(self, node: str) -> int:
        """The process of a node, if it lives; else 0."""
        try:
            pid = int((self.state / f"{node}.lock").read_text())
        except (FileNotFoundError, ValueError):
            return 0
        return pid if is_alive(pid) else 0

    def until_pid(self, node: str, other_than: int = 0) -> int:
        """The process of a node, when there is one."""
        found = other_than

        def is_there() -> bool:
            nonlocal found
            found = self.pid(node)
            return found not in (0, other_than) or not self.running

        until(is_there, f"a process of {node}")
        assert self.running, f"it has ended; it said\n{self.err}"
        return found

    def kill(self, node: str) -> None:
        """Kill a node's process; one that was killed here and is still about is not killed for the next one."""
        pid = self._killed[node] = self.until_pid(node, other_than=self._killed.get(node, 0))
        os.kill(pid, signal.SIGKILL)

    @property
    def epoch(self) -> int:
        """The last one whose digest is written."""
        return max(self.written, default=0)

    @property
    def written(self) -> dict[int, bytes]:
        """The digests that are written, by epoch."""
        try:
            content = (self.output / "digests.msgpack").read_bytes()
        except FileNotFoundError:
            return {}
        entries = msgpack.Unpacker()
        entries.feed(content)
        return dict(entry for entry in entries if isinstance(entry, list))  # what is being written may read as zeros

    def until_epoch(self, epoch: int, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until an epoch is committed, or for the launch's end."""
        until(lambda: self.epoch >= epoch or not self.running, f"epoch {epoch}", timeout_s)

    def report(self, timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
        """What it prints at its end."""
        out = self.end(timeout_s)
        assert self.process.returncode == 0, (self.process.returncode, self.err)
        return dict(json.loads(out))
