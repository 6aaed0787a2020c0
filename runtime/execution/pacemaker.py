"""When the world's epochs begin, how long they take, and their digests."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.stale import StaleEngine
from hierax.runtime.engine.table import Phase

Clock = Callable[[], float]

EPOCHS_TIMED = 1_000_000  # of how many epochs, the last ones, the times are kept


@dataclass
class Pacemaker:
    """How many epochs a run has, how long they took, and their digests."""

    chain: DigestChain  # of the digests
    limit: int | None  # how many epochs; None: until the world has finished
    on_commit: Callable[[int, bytes], None]  # told each epoch and its digest, after the next one has begun
    clock: Clock = time.perf_counter  # seconds
    epochs_s: deque[float] = field(default_factory=lambda: deque(maxlen=EPOCHS_TIMED))  # from beginning to commit
    first_s: float | None = None
    last_s: float = 0.0
    done: bool = False
    asked: bool = False  # whether the run is to end as soon as may be; any thread, and a signal's handler, may set it
    _started: float = 0.0

    def may_begin(self, engine: Engine) -> bool:
        """Whether the world, when it is idle, has an epoch to begin; else the run is done."""
        if engine.phase is not Phase.DONE or self.done:
            return False
        if self.asked:
            soonest = engine.epoch + isinstance(engine, StaleEngine)  # where epochs overlap, the last one is drained
            self.limit = soonest if self.limit is None else min(self.limit, soonest)
            self.asked = False
        self.done = (self.limit is not None and engine.epoch >= self.limit) or engine.finished
        return not self.done

    def start(self) -> None:
        self._started = self.clock()
        if self.first_s is None:
            self.first_s = self._started

    def stop(self) -> None:
        self.last_s = self.clock()
        self.epochs_s.append(self.last_s - self._started)

    @property
    def wall_s(self) -> float:
        """The time from the beginning of the first epoch to the commit of the last."""
        return 0.0 if self.first_s is None else self.last_s - self.first_s
