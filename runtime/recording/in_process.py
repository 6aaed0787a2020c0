"""Recording a run whose nodes are all in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from secrets import token_hex

from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.recording.check import Checker
from hierax.runtime.recording.info import Ending, RunInfo
from hierax.runtime.recording.recorder import Recorder
from hierax.runtime.recording.selection import EVERYTHING, Selection
from hierax.runtime.recording.witness import Witness
from hierax.runtime.recording.writing import McapFile, Target
from hierax.runtime.transport.steps import Sample
from hierax.schemas.keys import Keys
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value


class InProcess:
    """Hands what is said between the nodes of one process to a recorder.

    Args:
        deployment: what is run.
        seed: of the run.
        settings: with which the deployment was read.
        file: to be written; None: none.
        check: whether the formal order is checked.
        selection: what is written of what is said.

    Attributes:
        checker: what checks it; None: nothing.
        ending: how the recording ended; None: it goes on.

    Raises:
        RecordingError: the file cannot be written.
    """

    def __init__(
        self,
        deployment: Deployment,
        seed: int,
        settings: Sequence[str],
        file: Path | Target | None,
        check: bool = False,
        selection: Selection = EVERYTHING,
    ) -> None:
        run = token_hex(4)
        info = RunInfo.of(deployment, run, "run", seed, settings, from_start=True)
        info = replace(info, left_out=tuple(selection.exclude))
        self.checker = Checker(deployment.staleness) if check else None
        self.ending: Ending | None = None
        written = None if file is None else McapFile(file, info)
        self._recorder = Recorder(
            written,
            () if self.checker is None else (self.checker,),
            barrier=deployment.staleness.barrier,
            selection=selection,
        )
        self._keys = Keys(deployment.name, run)
        self._last = 0

    def message(self, header: Header, data: bytes) -> None:
        """A message is on its way."""
        self._take(self._keys.edge(header.kind, header.sender, header.receiver), data)

    def committed(self, epoch: int, digest: bytes) -> None:
        """An epoch is committed."""
        self._last = epoch
        self._take(self._keys.epochs, encode_value((epoch, digest)))
        self._recorder.flush()

    def watch(self, name: str, runner: NodeRunner, roster: Callable[[], Roster] | None) -> None:
        """Have a node tell its steps.

        Args:
            name: of the node.
            runner: of the node.
            roster: of the world: gives the roster in force; None for other nodes.
        """
        runner.watch(Witness(name, lambda: runner.engine, _Told(self, name), roster))

    def finish(self) -> None:
        """The run is over. Raises `RecordingError` if the file cannot be written."""
        self.ending = self._recorder.finish(self._last)

    def told(self, key: str, data: bytes) -> None:
        """A node has told something."""
        self._take(key, data)

    def step_key(self, name: str) -> str:
        """Where a node tells its steps."""
        return self._keys.steps(name)

    @property
    def roster_key(self) -> str:
        """Where the world tells the roster."""
        return self._keys.roster

    def _take(self, key: str, data: bytes) -> None:
        self._recorder.take(Sample(time.time_ns(), key, data))


class _Told:
    """Where one node's steps go."""

    def __init__(self, recording: InProcess, name: str) -> None:
        self._recording = recording
        self._key = recording.step_key(name)

    def step(self, data: bytes) -> None:
        self._recording.told(self._key, data)

    def roster(self, data: bytes) -> None:
        self._recording.told(self._recording.roster_key, data)
