"""The engine without the barrier: inputs from above may be of an earlier epoch.

With a staleness of n, observations are always of the node's own epoch k, and inputs from above of epoch k − n or later:
the newest in hand. Free running is without bound: a node takes
the newest of everything, and leaves out epochs that were overtaken.

A *drained* epoch is done with a staleness of 0: at its end every node is done with it. The world says so with its
observations, and who gets them passes it on. The roster changes after a drained epoch, and the first epoch under a
roster is one: so in free running, too, there is something in hand of everybody above."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from hierax.runtime.core.elements import Value
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.engine.effects import EngineEffects, Saved
from hierax.runtime.engine.engine import SLOT_FIELDS, Engine
from hierax.runtime.engine.table import ACTIONS, Action, Phase, Verdict
from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.messages import DRAIN, OBSERVATIONS, Header, Message

_UNTIMELY = (Verdict.LATE, Verdict.EARLY, Verdict.DOUBLE, Verdict.CURRENT)


@dataclass
class Ages:
    """How old the inputs from above were that a node has used, in epochs."""

    inputs: int = 0  # how many there were
    total: int = 0  # of their ages
    largest: int = 0  # likewise
    left_out: int = 0  # epochs that the node has not done, or not to their end

    def add(self, age: int) -> None:
        self.inputs += 1
        self.total += age
        self.largest = max(self.largest, age)

    def metrics(self) -> dict[str, float]:
        return {
            "staleness_mean": self.total / self.inputs if self.inputs else 0.0,
            "staleness_max": float(self.largest),
            "epochs_left_out": float(self.left_out),
        }


class StaleEngine(Engine):
    """One node's part in epochs that overlap; in free running only when `poll` is called."""

    overlaps = True

    def __init__(
        self,
        wiring: Wiring,
        effects: EngineEffects,
        *,
        staleness: Staleness,
        saved: Saved | None = None,
        joins: bool = False,
    ) -> None:
        self._staleness = staleness  # of the deployment; the other arguments are as `Engine` has them
        self._above: dict[Slot, dict[int, Message]] = {}
        self._below: dict[Slot, Message] = {}
        self._lacking: set[Slot] = set()  # while it waits to predict: what there is no input of that may be used
        self._first = 1
        self._is_rewired = True
        self.drains = False
        self.ages = Ages()
        self._used: dict[Slot, tuple[int, int]] = {}  # by slot, the epoch and attempt of the input that was used last
        self._sent_in: dict[int, dict[Slot, Message]] = {}
        if staleness.free:
            self._epochs_ahead = inf  # nobody waits for a node that is slow
        super().__init__(wiring, effects, saved=saved, joins=joins)

    @property
    def used(self) -> tuple[tuple[str, str, int, int], ...]:
        return tuple((*slot, *when) for slot, when in sorted(self._used.items()))

    @property
    def waits_for(self) -> tuple[Slot, ...]:
        if self.phase is Phase.PREDICT:
            return tuple(sorted(self._lacking))
        return super().waits_for

    def receive(self, message: Message) -> None:
        header = message.header
        if header.roster != self._roster or (header.kind == OBSERVATIONS and not self._staleness.free):
            super().receive(message)
            return
        verdict = self.judge(header)
        if verdict not in (*_UNTIMELY, Verdict.NEXT, Verdict.AGAIN):
            if ACTIONS[verdict] is Action.REFUSE:
                self._effects.refused(header, verdict)
        elif header.kind == OBSERVATIONS:
            self._keep_newest(message)
        else:
            self._keep(message)

    def poll(self) -> bool:
        """In free running: take part in the newest epoch, if there is one that was not; whether there was."""
        messages = self._below
        waits = self.phase is Phase.PREDICT and not self._is_rewired  # for what a drained epoch wants
        if self._world is not None or waits or len(messages) < len(self.wiring.below):
            return False
        headers = [message.header for message in messages.values()]
        newest = max(header.when for header in headers)
        if newest <= (self.epoch, self.attempt):
            return False
        late = [header for header in headers if header.when < newest]
        if late and any(DRAIN in header.extensions for header in headers if header not in late):
            return False  # a drained epoch has all its observations
        epoch, attempt = newest
        if epoch > self.epoch:
            self._turn(epoch, attempt)
        else:
            self._undo(attempt)
        self.inbox = dict(messages)
        self._sense()
        return True

    def rewire(self, version: int) -> None:
        super().rewire(version)
        self._is_rewired = True
        self._above.clear()
        self._below.clear()
        self._lacking.update(self.wiring.above if self.phase is Phase.PREDICT else ())
        self._sent_in.clear()
        self._sent.clear()

    def say_again(self, neighbour: str) -> None:
        """Also of earlier epochs, in their order: a neighbour above may be as many behind as inputs may be old."""
        for epoch in sorted(self._sent_in):
            for receiver, kind in sorted(self._sent_in[epoch]):
                if receiver == neighbour:
                    self._effects.send(self._sent_in[epoch][receiver, kind])
        super().say_again(neighbour)

    def _keep(self, message: Message) -> None:
        """An input from above: kept as long as it may be wanted."""
        header = message.header
        slot = (header.sender, header.kind)
        kept = self._above.setdefault(slot, {})
        known = kept.get(header.epoch)
        if known is not None and known.header.attempt >= header.attempt:
            if known.header[:SLOT_FIELDS] == header[:SLOT_FIELDS]:
                self._check_same(known, message)
            return
        kept[header.epoch] = message
        self._forget(kept)
        if self.phase is Phase.PREDICT:
            self._look_for(slot)
            if not self._lacking:
                self._predict()

    def _keep_newest(self, message: Message) -> None:
        header = message.header
        slot = (header.sender, header.kind)
        known = self._below.get(slot)
        if known is None or known.header.when < header.when:
            self._below[slot] = message
        elif known.header[:SLOT_FIELDS] == header[:SLOT_FIELDS]:
            self._check_same(known, message)

    def _forget(self, kept: dict[int, Message]) -> None:
        """Of what is kept of one neighbour above, what is not wanted any more."""
        # not the oldest of this epoch alone: a drained one may be followed by one that is none
        oldest = max(kept) if self._staleness.free else self._oldest()
        for epoch in [epoch for epoch in kept if epoch < oldest]:
            del kept[epoch]

    def _oldest(self) -> int:
        """The oldest epoch whose inputs may be used in one that is not drained."""
        if self._staleness.epochs is None:
            return self._first
        return max(self.epoch - self._staleness.epochs, self._first)

    def _choose(self, slot: Slot) -> Message | None:
        """The input from above that is used in this epoch; None: it has not come."""
        kept = self._above.get(slot, {})
        if self.drains:
            return kept.get(self.epoch)
        newest = max(kept, default=-1)
        return kept[newest] if newest >= self._oldest() else None

    def _enter(self, phase: Phase) -> None:
        super()._enter(phase)
        self._lacking.clear()
        if phase is Phase.PREDICT:
            for slot in self.awaited:
                self._look_for(slot)

    def _look_for(self, slot: Slot) -> None:
        """Whether there is an input that may be used, now that something has come of it, or the half has begun."""
        if self._choose(slot) is None:
            self._lacking.add(slot)
        else:
            self._lacking.discard(slot)

    def moves_on(self, epoch: int) -> bool:
        # where a process was lost, epochs may have gone on without this node
        if self._is_rewired:
            return epoch > self.epoch
        return super().moves_on(epoch)

    def _is_later(self, header: Header) -> bool:
        # in the middle of an epoch, too: what it waits for may have been lost with a process
        return header.when > (self.epoch, self.attempt)

    def _turn(self, epoch: int, attempt: int) -> None:
        if not self._joins:
            is_unfinished = self.phase is not Phase.DONE
            self.ages.left_out += epoch - self.epoch - 1 + is_unfinished
        if self._staleness.epochs:  # a neighbour below may be in that epoch still, and lack what is as old as it may be
            oldest = self.epoch - self._staleness.epochs
            self._sent_in[self.epoch] = dict(self._sent)
            self._sent_in = {earlier: sent for earlier, sent in self._sent_in.items() if earlier >= oldest}
        self._settle(epoch)
        super()._turn(epoch, attempt)

    def _undo(self, attempt: int) -> None:
        self._settle(self.epoch)
        super()._undo(attempt)

    def _settle(self, epoch: int) -> None:
        """The first epoch under a roster is a drained one, and nothing older is used after it."""
        if self._world is None:
            self.drains = False  # until its observations say so
        elif self._is_rewired:
            self.drains = True
        if self._is_rewired:
            self._first = epoch
            self._is_rewired = False

    def _sense(self) -> None:
        headers = [message.header for message in self.inbox.values()]
        self._used = {(header.sender, header.kind): header.when for header in headers}
        self.drains = any(DRAIN in header.extensions for header in headers if header.epoch == self.epoch)
        super()._sense()

    def _send_up(self) -> None:
        super()._send_up()
        if self.phase is Phase.PREDICT and not self._lacking:
            self._predict()

    def _predict(self) -> None:
        if self.wiring.above:
            self.inbox = self._chosen()
        super()._predict()

    def _chosen(self) -> dict[Slot, Message]:
        chosen: dict[Slot, Message] = {}
        for slot in self.wiring.above:
            message = self._choose(slot)
            if message is not None:
                chosen[slot] = message
                self._used[slot] = message.header.when
                self.ages.add(self.epoch - message.header.epoch)
        return chosen

    _extends = True

    def _said(self, message: Message) -> bytes:
        return super()._said(message) + bytes([DRAIN in message.header.extensions])

    def go_back_to(self, attempt: int) -> None:
        """Epochs overlap: a node may be done with one that is begun again."""
        return

    def _extensions(self, kind: str) -> Mapping[str, Value]:
        return {DRAIN: True} if self.drains and kind == OBSERVATIONS else {}
