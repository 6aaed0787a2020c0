"""The recorder's process beside a launch."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import anyio
import anyio.abc

from hierax.runtime.host.interpreter import python_module
from hierax.runtime.launch.child import END_TIMEOUT_S
from hierax.runtime.recording.info import Ending, RunInfo
from hierax.runtime.recording.live_recording import DONE, FAILED
from hierax.runtime.recording.selection import EVERYTHING, Selection
from hierax.runtime.recording.writing import Target

FINISH_TIMEOUT_S = 60.0
"""How long what was heard may take to be on disk, when the run is over."""


@dataclass
class Wanted:
    """That a launch is recorded, checked or both; and, when it is over, what became of that.

    Attributes:
        target: to be written; None: nothing.
        check: whether the formal order is checked.
        selection: what is written of what is said.
        ending: how the recording ended; None: it did not come to its end.
        violations: what the checker has found.
        failure: why there is no whole recording.
    """

    target: Target | None
    check: bool
    selection: Selection = EVERYTHING
    ending: Ending | None = None
    violations: list[str] = field(default_factory=list)
    failure: str = ""

    @property
    def file(self) -> Path | None:
        """Which is written."""
        return None if self.target is None else self.target.path


class RecorderChild:
    """Starts the recorder's process, listens to it, and has it finish.

    Args:
        wanted: is told what becomes of it.
        say: tells people.
    """

    def __init__(self, wanted: Wanted, say: Callable[[str], None]) -> None:
        self._wanted = wanted
        self._say = say
        self._process: anyio.abc.Process | None = None
        self._ended = anyio.Event()
        self._finishing = False

    @property
    def pid(self) -> int:
        """Of its process; 0: there is none yet."""
        return 0 if self._process is None else self._process.pid

    async def start(self, info: RunInfo, endpoint: str, settings: Any, host: str | None) -> None:
        """Start the process and give it its order; it need not listen yet, as the nodes' processes wait for it."""
        wanted = self._wanted
        self._process = await anyio.open_process(
            python_module("hierax.runtime.recording.live_recording"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None,
            start_new_session=True,
            pass_fds=() if wanted.target is None else (wanted.target.descriptor,),
        )
        order = {
            "info": info.plain(),
            "endpoint": endpoint,
            "file": "" if wanted.file is None else str(wanted.file),
            "descriptor": -1 if wanted.target is None else wanted.target.descriptor,
            "check": wanted.check,
            "selection": wanted.selection.plain(),
            "settings": settings,
            "host": host,
        }
        await self._tell(json.dumps(order))

    async def listen(self) -> None:
        """Take in what it says, until it ends."""
        process = self._process
        assert process is not None
        assert process.stdout is not None
        said = b""
        async for data in process.stdout:
            said += data
            *lines, said = said.split(b"\n")
            for line in lines:
                self._take(json.loads(line))
        with anyio.move_on_after(END_TIMEOUT_S):
            await process.wait()
        if self._wanted.ending is None and not self._wanted.failure:
            code = process.returncode
            how = (
                f"by signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"with exit code {code}"
            )
            self._wanted.failure = f"the recorder's process ended {how}"
            self._say(f"{self._wanted.failure}; the run goes on, and is not recorded any further")
        self._ended.set()

    async def finish(self, last: int | None) -> None:
        """Have it write what it has heard, and end; the nodes' processes are gone.

        Args:
            last: the last epoch of the run; None: not known.
        """
        process = self._process
        if process is None:
            return
        await self._tell("" if last is None else str(last))
        if process.stdin is not None:
            await process.stdin.aclose()
        with anyio.move_on_after(FINISH_TIMEOUT_S):
            await self._ended.wait()
        if not self._ended.is_set():
            self._wanted.failure = f"the recorder did not come to its end within {FINISH_TIMEOUT_S:g} s"
            process.kill()
        if process.stdout is not None:
            await process.stdout.aclose()

    def _take(self, said: dict[str, Any]) -> None:
        if said["status"] == DONE:
            self._wanted.ending = Ending.read(said["ending"])
            self._wanted.violations = said["violations"]
        elif said["status"] == FAILED:
            self._wanted.failure = said["why"]
            self._say(f"{said['why']}; the run goes on, and is not recorded")

    async def _tell(self, line: str) -> None:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        try:
            await process.stdin.send(line.encode() + b"\n")
        except (anyio.BrokenResourceError, anyio.ClosedResourceError, OSError):
            return  # it has ended: that is noticed by itself
