"""Where a node's time goes: in its operators, or waiting, and for whom."""

import time
from collections import deque
from collections.abc import Callable

from hierax.runtime.engine.effects import Called, Completed
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.messages import Message
from hierax.schemas.values import Value

Clock = Callable[[], int]

OBSERVE, POLICY, PREDICT, EDGES, ACT, OTHER = "observe", "policy", "predict", "edges", "act", "other"
WORK = (OBSERVE, POLICY, PREDICT, EDGES, ACT, OTHER)
"""What a node works at: τ; λ and π; γ; φ, ψ and ϱ; a world's actuators; encoding, sending, checkpoints, probes."""

EPOCHS_KEPT = 512  # how many durations, of the last epochs, are kept

_KINDS = {kind: kind for kind in WORK} | {"select_policy": POLICY, **dict.fromkeys(("sense", "task", "context"), EDGES)}


def kind_of(operator: str) -> str:
    """Say which of `WORK` an operator or edge function is."""
    return _KINDS.get(operator.partition(" ")[0], OTHER)  # there may be any number of policies


class Meter(Watcher):
    """Takes times, from one event to the next; some microseconds an epoch while it watches. The time from the end of
    all work to the message that makes the node work again is waiting for that message's sender: messages that only add
    to what is in hand end no wait. The clock gives nanoseconds, of any origin. `read` may be called by another thread:
    numbers may then be of one event more than others."""

    def __init__(self, clock: Clock = time.perf_counter_ns) -> None:
        self._clock = clock
        self._begun = self._mark = self._idle = self._arrived = clock()
        self._sender = ""
        self._works = False
        self._work = dict.fromkeys(WORK, 0)
        self._waiting: dict[str, int] = {}
        self._epochs = 0
        self._completed = 0
        self._durations: deque[int] = deque(maxlen=EPOCHS_KEPT)

    def received(self, message: Message) -> None:
        self._arrived = self._clock()
        self._sender = message.header.sender

    def turned(self) -> None:
        self._arrived = self._clock()
        self._sender = ""

    def called(self, called: Called) -> None:
        self._charge(kind_of(called.operator))

    def sending(self, message: Message) -> Message:
        self._charge(OTHER)
        return message

    def sent(self, message: Message) -> None:
        self._charge(OTHER)

    def acted(self, epoch: int) -> None:
        self._charge(ACT)

    def completed(self, completed: Completed) -> None:
        self._charge(OTHER)
        self._epochs += 1
        if self._completed:
            self._durations.append(self._mark - self._completed)
        self._completed = self._mark

    def served(self) -> None:
        if self._works:
            self._charge(OTHER)
            self._works = False
            self._idle = self._arrived = self._mark
            self._sender = ""

    def read(self, busy: str = "", waits_for: str = "") -> Value:
        """What was measured, up to now, in nanoseconds. `busy` is the operator that the node is in, which has not
        returned yet, or empty; `waits_for` is who sends the message that it waits for, which has not come yet. Where
        it is empty, that of whom a message has just come was waited for, from which nothing has followed yet."""
        now = self._clock()
        work, waiting = dict(self._work), dict(self._waiting)
        if self._works or busy:
            kind = kind_of(busy) if busy else OTHER
            work[kind] += max(now - (self._mark if self._works else self._arrived), 0)
        else:
            sender = waits_for or self._sender
            waiting[sender] = waiting.get(sender, 0) + max(now - self._idle, 0)
        return {
            "ns": now - self._begun,
            "epochs": self._epochs,
            "work_ns": work,
            "waiting_ns": waiting,
            "epochs_ns": list(self._durations),
        }

    def _charge(self, kind: str) -> None:
        now = self._clock()
        if not self._works:  # the first thing that followed from what came
            self._works = True
            sender = self._sender
            self._waiting[sender] = self._waiting.get(sender, 0) + self._arrived - self._idle
            self._mark = self._arrived
        self._work[kind] += now - self._mark
        self._mark = now
