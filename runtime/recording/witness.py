"""The watcher that tells whoever records what a node does."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from secrets import token_hex

from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.engine import Engine
from hierax.runtime.watch.watcher import Watcher
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import GREETING, Message
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep, Passage, encode_step
from hierax.schemas.values import Value, encode_value

ROSTER_EVERY_S = 0.5  # how often the roster is told again, for those who have begun to record meanwhile
_KEPT = 64  # how many epochs that were begun, and may still be completed, are remembered

_log = logging.getLogger("hierax")

_Used = tuple[tuple[str, str, int, int], ...]


@dataclass(eq=False)
class Witness(Watcher):
    """Tells a step for each epoch that a node completes."""

    name: str  # of the node
    engine: Callable[[], Engine | None]  # gives the node's engine; None: it is not there yet
    tell_step: Callable[[bytes], None]  # takes encoded steps
    tell_roster: Callable[[bytes], None]
    roster: Callable[[], Roster | None] | None = None  # of the world: gives the roster in force, once there is one

    def __post_init__(self) -> None:
        self._stream = token_hex(4)
        self._number = 0
        self._last = 0
        self._fresh = True
        self._is_late = False  # whether the node may have done something that nobody was told of
        self._passages: list[Passage] = []
        self._begun: dict[tuple[int, int], tuple[int, int, bytes, _Used]] = {}  # roster, instance, start and inputs
        self._chain = (0, b"")
        self._told_version = -1
        self._told_s = 0.0

    def resume(self) -> None:
        """Somebody listens, for the first time or again: the epochs that nobody was told of count as steps that lack.

        `look` follows, when it sees all that the node does."""
        self._fresh = True
        self._passages = []
        self._begun = {}
        self._is_late = True

    def look(self) -> None:
        """Where the node has not begun, nothing was missed."""
        engine = self.engine()
        self._is_late = engine is not None and engine.begun

    def received(self, message: Message) -> None:
        header = message.header
        self._passed(Passage(False, header.kind, header.sender, header.epoch, header.attempt))

    def sent(self, message: Message) -> None:
        header = message.header
        if self.roster is not None and header.roster != self._told_version:
            self._publish_roster(self.roster())
        self._passed(Passage(True, header.kind, header.receiver, header.epoch, header.attempt))

    def _passed(self, passage: Passage) -> None:
        if passage.epoch != GREETING:
            self._passages.append(passage)

    def predicted(self, completed: Completed) -> None:
        """Here the engine is still in its epoch; when that is told as completed, no more."""
        engine = self.engine()
        if engine is None:
            return
        wiring, used = engine.wiring, tuple(engine.used)
        start = engine.encoded_start if self._fresh else b""
        self._fresh = False
        self._begun[completed.step.epoch, completed.step.attempt] = (wiring.roster, wiring.instance, start, used)
        while len(self._begun) > _KEPT:
            del self._begun[next(iter(self._begun))]

    def committed(self, epoch: int, digest: bytes) -> None:
        self._chain = (epoch, digest)

    def completed(self, completed: Completed) -> None:
        step = completed.step
        begun = self._begun.pop((step.epoch, step.attempt), None)
        if begun is None:
            return  # the epoch was begun before anybody recorded
        if self.roster is not None:
            self._publish_roster(self.roster())
        lacking = max(step.epoch - self._last, 1) if self._number else 2  # of what lacks before the first, at least one
        self._number += lacking if self._is_late else 1
        self._is_late = False
        self._last = step.epoch
        passages, self._passages = self._passages, []
        roster, instance, start, used = begun
        where = (step.epoch, step.attempt, roster, instance, step.time_s)
        states = (completed.state, b"" if self.roster is not None else _encoded(step.sensed), start)
        heard = (used, tuple(passages), self._chain[1] if self._chain[0] == step.epoch else b"")
        told = NodeStep(self.name, self._stream, self._number, *where, completed.digest, *states, *heard)
        self._tell(told)

    def _tell(self, step: NodeStep) -> None:
        """What is larger than a message may be goes without the belief in the epoch's middle, then without the start,
        which are not needed to know what the node believes. Of a step that cannot be told the next one's number tells.
        """
        error: SchemaError | None = None
        for small in (step, step._replace(sensed=b""), step._replace(sensed=b"", start=b"")):
            try:
                data = encode_step(small)
            except SchemaError as too_large:
                error = too_large
                continue
            self.tell_step(data)
            return
        _log.warning("epoch %d of %s is not recorded: its step %s", step.epoch, self.name, error and error.what)

    def _publish_roster(self, roster: Roster | None) -> None:
        now_s = time.monotonic()
        if roster is None:
            return
        if roster.version == self._told_version and now_s - self._told_s < ROSTER_EVERY_S:
            return
        self._told_version, self._told_s = roster.version, now_s
        self.tell_roster(encode_value(roster.plain()))


def _encoded(belief: Value) -> bytes:
    """A belief in the middle of an epoch: unlike a state it need not be a value, and is left out then."""
    try:
        return encode_value(belief)
    except SchemaError:
        return b""
