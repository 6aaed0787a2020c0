"""The recorder's process beside a launch."""

import json
import subprocess
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import anyio
import anyio.abc

from hierax.runtime.host.streams import python_module, started_deaf
from hierax.runtime.launch.child import END_TIMEOUT_S, how_ended
from hierax.runtime.recording.info import Ending, RunInfo
from hierax.runtime.recording.live_recording import DONE, FAILED, LAST, LISTENING, RENEW, RENEWED
from hierax.runtime.recording.topics import EVERYTHING, Selection
from hierax.runtime.recording.writing import Target

FINISH_TIMEOUT_S = 60.0  # how long what was heard may take to be on disk, when the run is over


@dataclass
class RecordingRequest:
    """Whether a launch is recorded, checked or both; and, when it is over, what became of that."""

    target: Target | None  # to be written; None: nothing
    check: bool  # whether the formal order is checked
    selection: Selection = EVERYTHING  # what is written of what is said
    ending: Ending | None = None  # how the recording ended; None: it did not come to its end
    violations: list[str] = field(default_factory=list)  # what the checker has found
    failure: str = ""  # why there is no whole recording

    @property
    def file(self) -> Path | None:
        return None if self.target is None else self.target.path


class RecorderChild:
    """Starts the recorder's process, listens to it, and has it finish."""

    name = "recorder"

    def __init__(
        self, request: RecordingRequest, renewed_secret: Callable[[], str], notify: Callable[[str], None]
    ) -> None:
        self._request = request  # what is to be recorded; told what becomes of it
        self.renewed_secret = renewed_secret  # gives what it is to go on with: a certificate that is new
        self.renewals = 0  # how often it has gone on with a new one
        self.is_up = False  # whether it listens
        self._notify = notify  # tells people what happens
        self._process: anyio.abc.Process | None = None
        self._settled = anyio.Event()
        self._ended = anyio.Event()

    @property
    def pid(self) -> int:
        """The number of its process; 0: there is none yet."""
        return 0 if self._process is None else self._process.pid

    async def renew(self, secret: str) -> None:
        """Tell it to go on with another certificate, which is in this secret."""
        await self._send(json.dumps({RENEW: secret}))

    async def start(self, info: RunInfo, endpoint: str, zenoh_config: Any, secret: str, access: Any) -> None:
        """Start the process and give it its order; it does not listen yet."""
        request = self._request
        with started_deaf():
            self._process = await anyio.open_process(
                python_module("hierax.runtime.recording.live_recording"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None,
                start_new_session=True,
                pass_fds=() if request.target is None else (request.target.descriptor,),
            )
        order = {
            "info": info.plain(),
            "endpoint": endpoint,
            "file": "" if request.file is None else str(request.file),
            "descriptor": -1 if request.target is None else request.target.descriptor,
            "check": request.check,
            "selection": vars(request.selection),
            "settings": zenoh_config,
            "secret": secret,
            "access": access,
        }
        await self._send(json.dumps(order))

    async def settle(self) -> None:
        """Wait until it listens, or has ended."""
        await self._settled.wait()

    async def listen(self) -> None:
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
        self.is_up = False
        if self._request.ending is None and not self._request.failure:
            self._request.failure = f"the recorder's process ended {how_ended(process.returncode)}"
            self._notify(f"{self._request.failure}; the run goes on, and is not recorded any further")
        self._settled.set()
        self._ended.set()

    async def finish(self, last: int | None) -> None:
        """Have it write what it has heard up to the last epoch (None: not known), and end."""
        process = self._process
        if process is None:
            return
        await self._send(json.dumps({LAST: last}))
        if process.stdin is not None:
            await process.stdin.aclose()
        with anyio.move_on_after(FINISH_TIMEOUT_S if self.is_up else 0.0):  # else it has heard nothing
            await self._ended.wait()
        if not self._ended.is_set():
            self._request.failure = f"the recorder did not come to its end within {FINISH_TIMEOUT_S:g} s"
            process.kill()
            await process.wait()
        if process.stdout is not None:
            await process.stdout.aclose()

    def _take(self, said: dict[str, Any]) -> None:
        if said["status"] == LISTENING:
            self.is_up = True
            self._settled.set()
        elif said["status"] == RENEWED:
            self.renewals += 1
        elif said["status"] == DONE:
            self._request.ending = Ending.read(said["ending"])
            self._request.violations = said["violations"]
        elif said["status"] == FAILED:
            self._request.failure = said["why"]
            self._notify(f"{said['why']}; the run goes on, and is not recorded")

    async def _send(self, line: str) -> None:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        # where it has ended, that is noticed by itself
        with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError, OSError):
            await process.stdin.send(line.encode() + b"\n")
