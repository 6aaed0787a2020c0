"""Recording a run whose nodes are all in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from secrets import token_hex

from hierax.runtime.deployment import Deployment
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.recording.info import Ending, RunInfo
from hierax.runtime.recording.recorder import open_recorder
from hierax.runtime.recording.selection import EVERYTHING, Selection
from hierax.runtime.recording.witness import Witness
from hierax.runtime.recording.writing import Target
from hierax.runtime.transport.bus_tap import Sample
from hierax.schemas.keys import Keys
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value


@dataclass(frozen=True)
class _Sink:
    """Takes one node's steps and rosters."""

    step: Callable[[bytes], None]
    roster: Callable[[bytes], None]


class InProcess:
    """Hands what is said between the nodes of one process to a recorder, as `open_recorder` opens it."""

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
        self._recorder = open_recorder(info, file, check, selection)
        self.checker = self._recorder.checker
        self.ending: Ending | None = None  # it goes on
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
        """Have a node tell its steps; `roster` is given for the world alone, and gives the roster in force."""
        tell_step, tell_roster = partial(self._take, self._keys.steps(name)), partial(self._take, self._keys.roster)
        runner.watch(Witness(name, lambda: runner.engine, _Sink(tell_step, tell_roster), roster))

    def finish(self) -> None:
        """The run is over. Raises `RecordingError` if the file cannot be written."""
        self.ending = self._recorder.finish(self._last)

    def _take(self, key: str, data: bytes) -> None:
        self._recorder.take(Sample(time.time_ns(), key, data))
