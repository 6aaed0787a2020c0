"""What a process that runs on another host than its supervisor gives into that one's keeping: checkpoint, log, states.

A host may be lost with all that is on it. So nothing of the run is there alone: the checkpoint of each epoch is with
the supervisor before anything that follows from it is said, and another host can go on from it. A process that was
taken for lost can commit nothing more, as nobody keeps its records.
"""

import logging
import threading
from collections.abc import Sequence

from hierax.runtime.launch.frames import APPEND, KEEP, LOG, SupervisorPipe
from hierax.runtime.recovery.disk import Storage
from hierax.runtime.watch.logs import JsonLine


class KeptElsewhere(Storage):
    """Two slots that the supervisor has. `slots`: what they hold at first; `pipe`: leads to the supervisor."""

    def __init__(self, slots: Sequence[bytes], pipe: SupervisorPipe) -> None:
        self._slots = list(slots)
        self._pipe = pipe
        self._said = 0
        self._kept = 0
        self._is_kept = threading.Condition()

    def write(self, slot: int, data: bytes) -> None:
        self._slots[slot] = data
        self._said += 1
        self._pipe.say(KEEP, number=self._said, slot=slot, data=data)

    def read(self, slot: int) -> bytes:
        return self._slots[slot]

    def flush(self) -> None:
        """Return when the supervisor has all; where it is out of reach, never, and the process is ended in time."""
        with self._is_kept:
            self._is_kept.wait_for(lambda: self._kept >= self._said)

    def kept(self, number: int) -> None:
        """The supervisor has all records up to this number."""
        with self._is_kept:
            self._kept = number
            self._is_kept.notify_all()


class ToldLog:
    """Entries of epochs for the supervisor's output folder. `kind`: `STATES` or `DIGESTS` of `frames`."""

    def __init__(self, pipe: SupervisorPipe, kind: str) -> None:
        self._pipe = pipe
        self._kind = kind

    def write(self, *fields: int | bytes) -> None:
        self._pipe.say(APPEND, kind=self._kind, fields=list(fields))

    def flush(self) -> None:
        return  # it is said already

    def close(self) -> None:
        return


class ToldRecords(logging.Handler):
    """Tells the supervisor each record, as a line for the node's log."""

    def __init__(self, pipe: SupervisorPipe) -> None:
        super().__init__()
        self.setFormatter(JsonLine())
        self._pipe = pipe

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = self.format(record)
        except Exception:
            self.handleError(record)
            return
        self._pipe.say(LOG, line=line.encode(errors="backslashreplace").decode())
