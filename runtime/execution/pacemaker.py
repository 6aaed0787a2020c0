"""When the world's epochs begin, how long they take, and their digests; and signals that end them in good order."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import NoReturn

from hierax.runtime.core.binding import CALLS, Call
from hierax.runtime.core.digest import DigestChain
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.table import Phase
from hierax.runtime.execution.pace import Pace
from hierax.runtime.execution.times import Times

Clock = Callable[[], float]

PATIENCE_S = 0.7  # how long the epoch under way may take to come to its end
OVERDUE_S = 1.2  # how long, if no operator can be broken off before

LOOK_S = 0.02
AGAIN_S = 0.3  # after which an operator that catches everything is broken off once more
INTERRUPTED = 130  # exit code of a command that Ctrl-C has ended

GAP_S = 0.5  # who looks at the clock again and again, and has not for so long, was stopped itself, or had no processor


@dataclass
class Pacemaker:
    """How many epochs a run has, how long they took, and their digests."""

    chain: DigestChain  # of the digests
    limit: int | None  # how many epochs; None: until the world has finished
    on_commit: Callable[[int, bytes], None]  # told each epoch and its digest, after the next one has begun
    clock: Clock = time.perf_counter  # seconds
    pace: Pace | None = None  # of a world with a rate, with the barrier
    times: Times = field(default_factory=Times)  # of its epochs, from beginning to commit
    done: bool = False
    asked: bool = False  # whether the run is to end as soon as may be; any thread, and a signal's handler, may set it
    _started: float = 0.0

    def may_begin(self, engine: Engine) -> bool:
        """Whether the world, when it is idle, has an epoch to begin; else the run is done."""
        if engine.phase is not Phase.DONE or self.done:
            return False
        if self.asked:
            soonest = engine.epoch + engine.overlaps  # where epochs overlap, the last one is drained
            self.limit = soonest if self.limit is None else min(self.limit, soonest)
            self.asked = False
        self.done = (self.limit is not None and engine.epoch >= self.limit) or engine.finished
        return not self.done

    def start(self) -> None:
        self._started = self.clock()
        self.times.begun(self._started)

    def stop(self) -> None:
        now_s = self.clock()
        self.times.ended(now_s, now_s - self._started)


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


class SteadyClock:
    """Gives seconds; it has to be asked again and again, within `GAP_S`.

    Where a process was stopped, or its machine was asleep, it must not blame others for the time that has passed
    meanwhile: they may have said all they had to. Who asks between long pieces of work of its own has some of each
    `counted`, or its time would stand still."""

    def __init__(self, now: Callable[[], float] = time.monotonic, counted_s: float = 0.0) -> None:
        self._now = now  # seconds, never going back
        self._counted_s = counted_s  # how much counts of a longer time in which nobody has asked
        self._lock = threading.Lock()
        self._asked_s = now()
        self._left_out_s = 0.0

    def __call__(self) -> float:
        with self._lock:
            now = self._now()
            gap_s, self._asked_s = now - self._asked_s, now
            if gap_s > GAP_S:
                self._left_out_s += gap_s - self._counted_s
            return now - self._left_out_s
