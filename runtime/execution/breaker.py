"""Signals that end a run in this process in good order."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from hierax.runtime.core.binding import CALLS, Call
from hierax.runtime.execution.pacemaker import Pacemaker

PATIENCE_S = 0.7  # how long the epoch under way may take to come to its end
OVERDUE_S = 1.2  # how long, if no operator can be broken off before

LOOK_S = 0.02
AGAIN_S = 0.3  # after which an operator that catches everything is broken off once more
INTERRUPTED = 130  # exit code of a command that Ctrl-C has ended


class Breaker:
    """Ends a run at the end of the epoch under way; an epoch that does not end is broken off."""

    def __init__(self) -> None:
        self.came = False  # whether a signal came while the run was under way
        self._pacemaker: Pacemaker | None = None
        self._came_s = 0.0

    @contextmanager
    def guarding(self, pacemaker: Pacemaker) -> Iterator[None]:
        """While the block runs, a signal ends what the pacemaker is of, and then the block. Not in a thread."""
        self._pacemaker = pacemaker
        before = {number: signal.signal(number, self._on_signal) for number in ending_signals()}
        try:
            yield
        except KeyboardInterrupt:
            if not self.came:
                raise
        finally:
            if self.came:  # the next one ends the process at once
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            else:
                for number, handler in before.items():
                    signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            leave_at_once()
        self.came = True
        self._came_s = time.monotonic()
        if self._pacemaker is not None:
            self._pacemaker.asked = True
        signal.signal(signal.SIGALRM, self._on_alarm)
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S, LOOK_S)

    def _on_alarm(self, number: int, frame: FrameType | None) -> None:
        """The epoch takes too long: break off the operator that it is in."""
        if called(frame) or time.monotonic() - self._came_s > OVERDUE_S:
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S, LOOK_S)
            raise KeyboardInterrupt


def ending_signals() -> list[signal.Signals]:
    """Those that end a run."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # as nohup has it
    return [signal.SIGINT, signal.SIGTERM, *(() if ignored else (signal.SIGHUP,))]


def leave_at_once() -> NoReturn:
    """End the process; a progress bar may have hidden the cursor."""
    if sys.stderr.isatty():
        os.write(sys.stderr.fileno(), b"\x1b[?25h")
    os._exit(INTERRUPTED)


def called(frame: FrameType | None) -> str:
    """The node, or edge, whose operator is under way in a frame; empty: none."""
    call = call_in(frame)
    return "" if call is None else call.subject


def call_in(frame: FrameType | None) -> Call | None:
    """The call of an operator that is under way in a frame."""
    while frame is not None:
        if frame.f_code in CALLS:
            call: Call = frame.f_locals["self"]
            return call
        frame = frame.f_back
    return None
