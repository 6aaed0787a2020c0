"""What a node's thread does while the run goes on: message by message, and what others say beside them."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from hierax.runtime.execution.member import Member
from hierax.runtime.execution.pacemaker import SteadyClock
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.frames import NodeOrder, SupervisorPipe
from hierax.runtime.transport.zenoh_port import ZenohPort
from hierax.schemas.control import Control
from hierax.schemas.errors import SchemaError
from hierax.schemas.limits import MAX_STATE_BYTES
from hierax.schemas.messages import Message

IDLE_S = 0.5  # how long a node may get no further before it asks whether it is still part of the hierarchy
AGAIN = 0.25
"""A process that has no part yet offers itself again when it has waited longer by this part of that time, or after
`IDLE_S`: the first offers may be lost as links open, and those of many at once would keep their owner from all else."""
AT_ONCE = 256  # how many messages are taken in before anything else is looked at
REST = 10_000  # how many messages are looked at when the run is over
NAP_S = 0.001  # how long the world's thread sleeps at once while its next epoch is not due
BEAT_S = 0.2  # how often the world's process says that it lives

_log = logging.getLogger("hierax")

MAX_WORDS = 1024  # how many control messages wait at most; what is more is lost, and said again by who means it
MAX_BYTES = MAX_STATE_BYTES + (1 << 20)  # how many bytes they had on the wire, together
WORDS_AT_ONCE = 64  # how many of them are taken in between two messages of an epoch


class ControlQueue:
    """Control messages in the order in which they came; any thread may put and take."""

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        self.wake = wake  # called where somebody who waits has to look
        self._posted: deque[Control] = deque()
        self._words: deque[tuple[Control, int]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._woken = False

    def __len__(self) -> int:
        return len(self._posted) + len(self._words)

    def post(self, word: Control) -> None:
        """One more from the process's own supervisor; there is room for it in any case."""
        self._posted.append(word)
        self.wake()

    def put(self, word: Control, size: int) -> bool:
        """One more from anybody, of so many bytes; whether there was room for it."""
        with self._lock:
            if len(self._words) >= MAX_WORDS or self._bytes + size > MAX_BYTES:
                return False
            self._words.append((word, size))
            self._bytes += size
        if not self._woken:
            self._woken = True
            self.wake()
        return True

    def taken(self) -> Iterator[Control]:
        """All that the supervisor has said, then what others have; of that not more than `WORDS_AT_ONCE`."""
        self._woken = False
        while self._posted:
            yield self._posted.popleft()
        for _ in range(WORDS_AT_ONCE):
            word = self.take()
            if word is None:
                return
            yield word

    def take(self) -> Control | None:
        """The next one of what others have said, if there is one."""
        with self._lock:
            if not self._words:
                return None
            word, size = self._words.popleft()
            self._bytes -= size
        return word


@dataclass
class WorldWatch:
    """Says that the world's process lives and whom the roster names; and when it hangs, as nobody else watches that."""

    order: NodeOrder  # of the process
    pipe: SupervisorPipe  # to its supervisor
    world: WorldMember  # its member
    busy: Callable[[], str]  # the operator that the node's thread is in; empty: in none
    _clock: SteadyClock = field(default_factory=SteadyClock)
    _beaten_s: float = 0.0
    _version: int = -1
    _stuck: tuple[int, str] = (0, "")
    _stuck_s: float = 0.0

    def tick(self, now_s: float) -> None:
        """Time has passed; called by another thread than the node's."""
        owner = self.world.owner
        if now_s - self._beaten_s >= BEAT_S:
            self._beaten_s = now_s
            self.pipe.beat(owner)
        state, steady_s = (owner.progress.epoch, self.busy()), self._clock()
        if not state[1] or state != self._stuck:
            self._stuck, self._stuck_s = state, steady_s
            return
        deadline_s = None if self.order.owner is None else self.order.owner.epoch_deadline_s
        if deadline_s is not None and steady_s - self._stuck_s > deadline_s:
            self._stuck_s = steady_s
            why = f"it is in {state[1]} in epoch {state[0] + 1}, past the deadline"
            self.pipe.end(self.order.name, self.order.process, why)

    def serve(self) -> float | None:
        """Between two messages, called by the node's thread: say what has come of the last one; how long the
        world waits until the next epoch is due, None: it does not."""
        world, owner = self.world, self.world.owner
        if owner.members.roster.version != self._version:
            self._version = owner.members.roster.version
            self.pipe.beat(owner)
        if world.pacemaker.asked:
            world.end_soon()
        if owner.progress.over:
            self.pipe.finish(owner)
        if world.paused and world.wait_s() == 0.0:
            world.resume()
        return world.wait_s() if world.paused else None


@dataclass
class NodeLoop:
    """Takes messages in until the node's process is to stop, or its member is dismissed."""

    order: NodeOrder  # of the process
    member: Member  # of the run
    watch: WorldWatch | None  # of the world, if this is its process
    port: ZenohPort  # of the node
    words: ControlQueue  # what others say to the member, or to the owner
    stopping: threading.Event  # set when it is to stop
    errand: Callable[[], None] | None = None  # what the node's thread does once, between two messages
    _ticks: bool = False
    _ticked_s: float = field(default_factory=time.monotonic)
    _moved_s: float = field(default_factory=time.monotonic)
    _place: tuple[object, ...] = ()
    _due: bool = True

    # --- called by another thread

    def tick(self) -> None:
        now = time.monotonic()
        if self.watch is not None:
            self.watch.tick(now)
        elif now - self._ticked_s < self._pause_s(now):
            return
        if not self._ticks:
            self._ticked_s = now
            self._ticks = True
            self.words.wake()

    def send_on(self, errand: Callable[[], None]) -> None:
        """Have the node's thread do something once."""
        self.errand = errand
        self.words.wake()

    def take_turn(self) -> None:
        """In free running: the node's next turn is due."""
        self._due = True
        self.words.wake()

    def _pause_s(self, now: float) -> float:
        """How long after it has asked last the member asks whether it is wanted."""
        moved_s = self._when_moved(now)
        if self.member.active:
            return IDLE_S + max(moved_s - self._ticked_s, 0.0)
        return min(IDLE_S, AGAIN * (now - moved_s))

    def _when_moved(self, now: float) -> float:
        """When the node has got further in its epochs; what others send it may be of no use."""
        engine = self.member.engine
        place = () if engine is None else (engine.epoch, engine.attempt, engine.phase)
        if place != self._place:
            self._place, self._moved_s = place, now
        return self._moved_s

    # --- the node's thread

    def run(self) -> None:
        if self.order.staleness is None:
            self._run_freely()
        else:
            self._run_in_step()

    def _run_in_step(self) -> None:
        watch, wait_s = self.watch, None
        while not self.stopping.is_set():
            if self.words or self._ticks or self.errand is not None:
                self._serve()
            if self.member.dismissed:
                return
            if watch is not None:
                wait_s = watch.serve()
            took = self._take_next(self.port.poll if self.words or wait_s is not None else self.port.receive)
            if wait_s and not took:
                time.sleep(min(wait_s, NAP_S))

    def _run_freely(self) -> None:
        """Do the same as in step, but the node takes its turns when they are due, on the newest of what has come."""
        while not self.stopping.is_set():
            self._serve()
            if self.member.dismissed:
                return
            if self.watch is not None:
                self.watch.serve()
            for _ in range(AT_ONCE):
                if not self._take_next(self.port.poll):
                    break
            if self._due and self.member.runner is not None:
                self._due = self.order.rate_hz is None  # the next turn may be due before this one is over
                if self.member.runner.poll():
                    continue
                self._due = True
            self._take_next(self.port.poll if self.words else self.port.receive)

    def _take_next(self, receive: Callable[[], Message | None]) -> bool:
        try:
            message = receive()
        except SchemaError as error:
            _log.warning("%s: dropped what is no message of ours: %s", self.order.name, error)
            return True
        if message is None:
            return False
        if self.member.runner is not None:
            self.member.runner.step(message)
        return True

    def compare_rest(self) -> None:
        """The run is over: what is still there is taken in no more, but may show that something was forged."""
        engine = self.member.engine
        if engine is None or not self.member.staleness.barrier:
            return
        for _ in range(REST):
            try:
                message = self.port.poll()
            except SchemaError:
                continue
            if message is None:
                return
            engine.compare(message)

    def _serve(self) -> None:
        errand, self.errand = self.errand, None
        if errand is not None:
            errand()
        if self.member.runner is not None and (self.words or self._ticks):
            self.member.runner.turned()  # what follows from a word is work since then, not since the last message
        take_word = self.member.take_word if self.watch is None else self.watch.world.take_word
        for word in self.words.taken():
            take_word(word)
        if not self._ticks:
            return
        self._ticks = False
        if self.watch is not None:
            self.watch.world.tick()
        else:
            self.member.join(self.order.request)
            self.member.fetch_again()
