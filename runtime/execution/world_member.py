"""The world's process: a member that owns the roster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Container, Mapping, Sequence
from typing import Literal

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.errors import HieraxError, OperatorError
from hierax.runtime.core.probe import Probe
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Committed, Saved
from hierax.runtime.engine.table import Phase
from hierax.runtime.engine.wiring import Wiring
from hierax.runtime.execution.member import Member, never_whole
from hierax.runtime.execution.runner import Log, Pacemaker
from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.members import Tried
from hierax.runtime.owner.owner import Owner
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.transport.port import Port
from hierax.schemas.checkpoint import (
    Place,
    WorldRecord,
    decode_alone,
    decode_processes,
    decode_roster,
    decode_state,
    decode_trial,
    decode_world,
    encode_trial,
    encode_world,
)
from hierax.schemas.control import Control, Failed, Order
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value

_log = logging.getLogger("hierax")

OnUncertainAct = Literal["repeat", "skip"]


class Supervision:
    """What the owner needs of whoever keeps processes; does nothing where there is nobody."""

    def end(self, name: str, process: str, why: str) -> None:
        """Kill a process, and treat it as lost."""
        return

    def stop(self, why: str) -> None:
        """End the run: it cannot go on."""
        raise HieraxError(why)

    def note(self, what: str) -> None:
        """Tell people."""
        _log.warning("%s", what)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        """Tell whoever asked for a change what became of it."""
        return


class WorldMember(Member, OwnerEffects):
    """The world's node, its record, and the roster's owner.

    Args:
        name, process, wire, port, slots, probes, states, pacemaker: as `Member` has them.
        tell: sends an order to another process; it may be lost.
        keeper: of the run's processes.
        settings: of the owner.
        clock: seconds, for the owner.
        on_uncertain_act: what is done about an act of which nobody knows whether it was done.

    Attributes:
        pauses: whether a world without neighbours, which waits for nobody, waits for `go_on` between two epochs, so
            that what is said to it is heard.
        paused: whether it does.
    """

    def __init__(
        self,
        name: str,
        process: str,
        wire: Callable[[Roster], Wiring],
        port: Port,
        tell: Callable[[str, Order], None],
        keeper: Supervision,
        slots: Slots | None,
        pacemaker: Pacemaker,
        settings: OwnerPolicy,
        clock: Callable[[], float],
        *,
        on_uncertain_act: OnUncertainAct = "repeat",
        probes: Sequence[Probe] = (),
        states: Log | None = None,
    ) -> None:
        super().__init__(name, process, wire, port, self._hear, slots, probes, states, pacemaker)
        self._pacemaker = pacemaker
        self._tell = tell
        self._keeper = keeper
        self._settings = settings
        self._clock = clock
        self._on_uncertain_act = on_uncertain_act
        self._intended = 0
        self._acted = 0
        self._roster_bytes = b""
        self._process_bytes = b""
        self._alone_bytes = b""
        self._own_orders: list[Order] = []
        self._own_failures: list[Failed] = []
        self.pauses = False
        self.paused = False
        self.owner: Owner

    def begin_run(self, roster: Roster, processes: Mapping[str, str]) -> None:
        """Begin a run at its first epoch, under a roster whose links are open."""
        self.wire(self._wire_roster(roster))
        self.owner = Owner(roster, processes, self, self._clock, self._settings)
        self.keep()  # so that nothing was sent yet where the only record turns out to be damaged
        self._proceed()
        self._finish()

    def resume_run(self, processes: Mapping[str, str]) -> tuple[int, bytes]:
        """Go on with a run by the world's record.

        Args:
            processes: those that live, by node; where there are two of a node, by any other key, too.

        Returns:
            The last committed epoch and its digest, which the process before may not have told.

        Raises:
            HieraxError: there is no whole record.
        """
        record, saved = read_record(self._slots)
        roster = decode_roster(record.roster)
        self._intended, self._acted = record.intended, record.acted
        recorded = decode_processes(record.processes)
        living = set(processes.values())
        self.wire(self._wire_roster(roster), saved)
        chain = DigestChain(roster.content_hash(), record.epoch - 1, record.last_digest)
        self._pacemaker.chain = chain
        self.owner = Owner(
            roster,
            {name: each[0] for name, each in recorded.items() if each[0] in living and name != roster.world},
            self,
            self._clock,
            self._settings,
            epoch=record.epoch - 1,
            attempt=record.attempt,
            highest=record.highest_version,
            born={name: each[1:] for name, each in recorded.items()},
            settled=self._intended == record.epoch,
            last_attempt=record.last_attempt,
            tried=_living_trial(decode_trial(record.trial), living),
            alone=decode_alone(record.alone),
        )
        if self._pacemaker.may_begin(self.engine):
            self.owner.take_back(self.process)
            self._finish()
        else:
            self.owner.finish()
        return record.epoch - 1, record.last_digest

    def take_word(self, word: Control) -> None:
        if isinstance(word, Order):
            self.obey(word)
        else:
            self.hear(word)

    def hear(self, word: Control) -> None:
        """Take in what anybody says to the owner.

        Raises:
            OperatorError: an operator failed.
        """
        self.owner.hear(word)
        self._finish()

    def go_on(self) -> None:
        """Begin the next epoch after a pause.

        Raises:
            OperatorError: an operator failed.
        """
        self.paused = False
        self._proceed()
        self._finish()

    def end_soon(self) -> None:
        """The run was asked to end: where nothing is under way, nothing is waited for.

        Raises:
            OperatorError: an operator failed.
        """
        if self.engine.phase is Phase.DONE:
            self._proceed()
            self._finish()

    def tick(self) -> None:
        """Time has passed.

        Raises:
            OperatorError: an operator failed.
        """
        self.owner.tick()
        self._finish()

    # --- what the owner calls

    def tell(self, process: str, order: Order) -> None:
        if process == self.process:
            self._own_orders.append(order)
        else:
            self._tell(process, order)

    def keep(self) -> None:
        if self._slots is not None:
            self._slots.write(encode_world(self._record()))

    def begin(self, epoch: int, attempt: int, version: int) -> None:
        engine = self.engine
        pacemaker = self._pacemaker
        if engine.phase is Phase.DONE:
            pacemaker.start()
        if version != engine.wiring.roster:
            engine.rewire(version)
            pacemaker.chain.roster_hash = engine.wiring.place.roster_hash
            self._roster_bytes = b""
        self.drain(pacemaker.limit == epoch or self.owner.drains)
        self.keep()
        try:
            if engine.phase is Phase.DONE:
                engine.begin(attempt)
            else:
                engine.begin_again(attempt)
        except OperatorError as error:
            self.failed(error)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        self._keeper.answer(request, epoch, refusal)

    def end(self, name: str, process: str, why: str) -> None:
        self._keeper.end(name, process, why)

    def stop(self, why: str) -> None:
        self._keeper.stop(why)

    def note(self, what: str) -> None:
        self._keeper.note(what)

    # --- what the engine calls

    def act(self, epoch: int, actions: Elements) -> None:
        if self.engine.node.act is None or not self._should_act(epoch):
            return
        self._intended = epoch
        self.keep()
        super().act(epoch, actions)
        self._acted = epoch
        self.keep()

    def _should_act(self, epoch: int) -> bool:
        if epoch > self._intended:
            return True
        if epoch == self._acted:
            return False  # done, in an attempt that did not come to its end
        repeats = self._on_uncertain_act == "repeat"
        done = "it is repeated" if repeats else "it is skipped"
        self.note(f"{self.name}: nobody knows whether the act of epoch {epoch} was done; {done} (on_uncertain_act)")
        return repeats

    # --- within

    def _hear(self, word: Control) -> None:
        if isinstance(word, Failed):  # it may be the owner that has just begun the epoch
            self._own_failures.append(word)
        else:
            self.owner.hear(word)

    def _record(self) -> WorldRecord:
        owner, engine = self.owner, self.engine
        begun = engine.epoch > owner.epoch  # and not committed
        trial = owner.trial
        if not self._roster_bytes:
            self._roster_bytes = encode_value(owner.roster.plain())
            self._alone_bytes = encode_value(tuple(sorted(owner.alone)))
            self._process_bytes = encode_value(
                {name: (token, *owner.born(name)) for name, token in sorted(owner.processes.items())}
            )
        return WorldRecord(
            epoch=owner.epoch + 1,
            attempt=max(owner.attempt, 0),
            instance=owner.roster.instance(self.name),
            roster=self._roster_bytes,
            highest_version=owner.highest,
            last_digest=self._pacemaker.chain.digest,
            state=engine.encoded_start if begun else engine.encoded,
            intended=self._intended,
            acted=self._acted,
            processes=self._process_bytes,
            last_attempt=owner.last_attempt,
            trial=b""
            if trial is None
            else encode_trial(trial.name, trial.before, (trial.process, *trial.born), trial.alone),
            alone=self._alone_bytes,
        )

    def _finish(self) -> None:
        super()._finish()
        while self._own_orders or self._own_failures:
            orders, self._own_orders = self._own_orders, []
            failures, self._own_failures = self._own_failures, []
            for order in orders:
                self._do(order)
            for failure in failures:
                self.owner.hear(failure)
            super()._finish()

    def _may_begin(self) -> bool:
        return False  # the owner decides

    def _go_on(self, committed: Committed | None) -> None:
        if committed is None:
            return
        self.owner.committed(committed.epoch)
        if self.pauses and not self.engine.node.above:
            self.paused = True
            self.keep()  # nobody hears of a commit that a crash could undo
        else:
            self._proceed()

    def _begin_next(self, pacemaker: Pacemaker) -> None:
        self._proceed(its_turn=True)

    def _proceed(self, its_turn: bool = False) -> None:
        """Begin the next epoch, or let what was committed count, before anybody hears of it."""
        pacemaker = self._pacemaker
        if pacemaker.may_begin(self.engine):
            if its_turn or not self.staleness.free:
                self.owner.proceed()
        elif pacemaker.done:
            self.keep()
            self.owner.finish()


def _living_trial(recorded: tuple[str, Roster, Place, bool] | None, living: Container[str]) -> Tried | None:
    """What is tried, by the record; what it has replaced may have died meanwhile."""
    if recorded is None:
        return None
    name, before, (token, version, epoch, request), alone = recorded
    return name, before, token if token in living else "", (version, epoch, request), alone


def has_record(slots: Slots) -> bool:
    """Whether a run was begun: else none of its messages was ever sent, and it begins anew."""
    return not never_whole(slots.read())


def read_record(slots: Slots | None) -> tuple[WorldRecord, Saved]:
    """What a new process of the world's goes on with.

    Raises:
        HieraxError: there is no whole record.
    """
    if slots is None:
        raise HieraxError("the world keeps no record")
    reads = slots.read()
    faults = [f"slot {read.slot} {read.fault}" for read in reads if read.fault]
    for read in reads:
        if read.data is not None:
            record = decode_world(read.data)
            if faults:
                _log.warning("record: %s; using that of epoch %d", "; ".join(faults), record.epoch)
                record = _safest(record)
            state = ActiveNode(*decode_state(record.state))
            return record, Saved(record.epoch - 1, 0, state, state)
    raise HieraxError(f"the world's record cannot be used: {'; '.join(faults) or 'nothing was ever written'}")


def _safest(record: WorldRecord) -> WorldRecord:
    """A record after which another one was written, which is damaged.

    That one may have taken the next attempt and version, and intended the act: none is used again.
    """
    intended = max(record.intended, record.epoch)
    return record._replace(attempt=record.attempt + 1, highest_version=record.highest_version + 1, intended=intended)
