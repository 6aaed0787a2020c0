"""The world's process: a member, and the owner of the roster beside it."""

import logging
from collections.abc import Callable, Container, Mapping
from typing import Literal

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.errors import HieraxError, OperatorError
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.engine.effects import Committed, Saved
from hierax.runtime.engine.table import Phase
from hierax.runtime.execution.checkpoints import Checkpoints, never_whole, newest_whole
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.runner import NodeRunner, World
from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.members import Tried
from hierax.runtime.owner.owner import Owner
from hierax.runtime.recovery.slots import Slots
from hierax.schemas import checkpoint
from hierax.schemas.control import Control, Failed, Order
from hierax.schemas.roster import Roster
from hierax.schemas.values import encode_value

_log = logging.getLogger("hierax")

OnUncertainAct = Literal["repeat", "skip"]


class Supervision:
    """What the owner needs of whoever supervises the run's processes; where there is nobody it only tells people."""

    def end(self, name: str, process: str, why: str) -> None:
        """Kill a process, and treat it as lost."""

    def stop(self, why: str) -> None:
        """End the run: it cannot go on."""
        raise HieraxError(why)

    def note(self, what: str) -> None:
        """Tell people."""
        _log.warning("%s", what)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        """Tell whoever asked for a change what became of it."""

    def begins(self, owner: Owner, epoch: int, attempt: int, version: int) -> None:
        """An attempt is begun under a version of the roster; nothing of it is recorded yet."""

    def acts(self, epoch: int) -> None:
        """The world is about to act in this epoch; 0: it has acted, and that is recorded."""

    def commits(self) -> None:
        """An epoch is committed; nobody was told yet."""


class WorldMember(World, OwnerEffects):
    """The world's process in a run that may change: its member, its record, and the roster's owner.

    Nothing is sent and nothing is written before `start`. Raises `HieraxError` if there is no whole record, or the
    world cannot be loaded, and `OperatorError` if an operator failed."""

    def __init__(
        self,
        seat: Seat,  # what the process has for its member
        send_order: Callable[[str, Order], None],  # sends an order to another process; it may be lost
        supervision: Supervision,  # of the run's processes
        slots: Slots,  # of the world's record
        pacemaker: Pacemaker,  # of the run; it goes on where the record says
        policy: OwnerPolicy,  # of the owner
        clock: Callable[[], float],  # seconds, for the owner
        processes: Mapping[str, str],  # those that live, by node; where there are two of a node, by any other key, too
        roster: Roster | None,  # with which the run begins; its links are open. None: it goes on by the world's record.
        *,
        on_uncertain_act: OnUncertainAct = "repeat",  # about an act of which nobody knows whether it was done
        # Whether a world without neighbours, which waits for nobody, waits for `resume` between two epochs, so that
        # what is said to it is heard.
        pauses: bool = False,
    ) -> None:
        super().__init__(pacemaker)
        self.member = Member(seat, self._hear_own, Checkpoints(slots), self)  # the process that it is
        self._send_order = send_order
        self._supervision = supervision
        self._slots = slots
        self._on_uncertain_act = on_uncertain_act
        self._intended = 0
        self._acted = 0
        self._roster_bytes = b""
        self._process_bytes = b""
        self._alone_bytes = b""
        self._own_orders: list[Order] = []
        self._own_failures: list[Failed] = []
        self.paused = False  # whether it waits for `resume`
        self._pauses = pauses
        self._resumes = roster is None
        if roster is not None:
            self._runner = self.member.run(seat.wire(roster))
            self.owner = Owner(roster, processes, self, clock, policy)
            return
        record, saved = read_record(slots)
        roster = checkpoint.decode_roster(record.roster)
        self._intended, self._acted = record.intended, record.acted
        recorded = checkpoint.decode_processes(record.processes)
        living = set(processes.values())
        self._runner = self.member.run(seat.wire(roster), saved)
        pacemaker.chain = DigestChain(roster.content_hash(), record.epoch - 1, record.last_digest)
        self.owner = Owner(
            roster,
            {other: each[0] for other, each in recorded.items() if each[0] in living and other != roster.world},
            self,
            clock,
            policy,
            epoch=record.epoch - 1,
            attempt=record.attempt,
            highest=record.highest_version,
            born={other: each[1:] for other, each in recorded.items()},
            settled=self._intended == record.epoch,
            last_attempt=record.last_attempt,
            tried=_living_trial(checkpoint.decode_trial(record.trial), living),
            alone=checkpoint.decode_alone(record.alone),
            drains=record.drains,
        )

    def start(self) -> None:
        """Begin the run, or go on with it."""
        if not self._resumes:
            self.write_record()  # so that nothing was sent yet where the only record turns out to be damaged
            self._proceed()
        elif self.pacemaker.may_begin(self._runner.engine):
            self.owner.take_back(self.member.process)
        else:
            self._finish()
            if not self.owner.progress.over:
                self.owner.take_back(self.member.process)
        self._runner.finish()

    def take_word(self, word: Control) -> None:
        """Do what the owner says to this process, or take in what anybody says to the owner."""
        if isinstance(word, Order):
            self.member.obey(word)
        else:
            self.hear(word)

    def hear(self, word: Control) -> None:
        self.owner.hear(word)
        self._runner.finish()

    def wait_s(self) -> float:
        """In a pause, how long until the next epoch is due."""
        pace = self.pacemaker.pace
        return 0.0 if pace is None else max(pace.wait_s(), 0.0)

    def resume(self) -> None:
        """Begin the next epoch after a pause."""
        self.paused = self.owner.progress.held = False
        self._runner.turned()
        self._proceed()
        self._runner.finish()

    def end_soon(self) -> None:
        """The run was asked to end: where nothing is under way, nothing is waited for."""
        if self._runner.engine.phase is Phase.DONE:
            self._proceed()
            self._runner.finish()

    def tick(self) -> None:
        self.owner.tick()
        self._runner.finish()

    # --- what the owner calls

    def send_order(self, process: str, order: Order) -> None:
        if process == self.member.process:
            self._own_orders.append(order)
        else:
            self._send_order(process, order)

    def write_record(self) -> None:
        self._slots.write(checkpoint.encode_world(self._record()))

    def begin(self, epoch: int, attempt: int, version: int) -> None:
        engine, pacemaker = self._runner.engine, self.pacemaker
        self.paused = False
        self._supervision.begins(self.owner, epoch, attempt, version)
        if engine.phase is Phase.DONE and not pacemaker.done:
            pacemaker.start()
        if version != engine.wiring.roster:
            engine.rewire(version)
            pacemaker.chain.roster_hash = engine.wiring.place.roster_hash
            self._roster_bytes = b""
        if pacemaker.done:  # somebody is back who is behind
            self.write_record()
            engine.begin_again(attempt)
            return
        self._runner.drain(pacemaker.limit == epoch or self.owner.progress.drains)
        self.write_record()
        if pacemaker.pace is not None and engine.phase is Phase.DONE:
            late = pacemaker.pace.begin(epoch)
            if late:
                self.note(late)
        try:
            if engine.phase is Phase.DONE:
                engine.begin(attempt)
            else:
                engine.begin_again(attempt)
        except OperatorError as error:
            self.member.failed(error)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        self._supervision.answer(request, epoch, refusal)

    def end(self, name: str, process: str, why: str) -> None:
        self._supervision.end(name, process, why)

    def stop(self, why: str) -> None:
        self._supervision.stop(why)

    def note(self, what: str) -> None:
        self._supervision.note(what)

    # --- what the runner calls

    def may_begin(self, runner: NodeRunner) -> bool:
        return False  # the owner decides

    def go_on(self, runner: NodeRunner, committed: Committed | None) -> None:
        if committed is None:
            return
        self.owner.committed(committed.epoch)
        pace = self.pacemaker.pace
        if pace is not None:
            pace.ended()
        if (pace is not None and pace.wait_s() > 0.0) or (self._pauses and not runner.engine.waited):
            self.paused = self.owner.progress.held = True
            self.write_record()  # nobody hears of a commit that a crash could undo
        else:
            self._proceed()

    def begin_next(self, runner: NodeRunner) -> None:
        self._proceed(its_turn=True)

    def act(self, runner: NodeRunner, epoch: int, actions: Elements) -> None:
        if runner.engine.node.act is None or not self._should_act(epoch):
            return
        self._supervision.acts(epoch)
        self._intended = epoch
        self.write_record()
        runner.move(epoch, actions)
        self._acted = epoch
        self.write_record()
        self._supervision.acts(0)

    def committed(self, committed: Committed) -> None:
        self._supervision.commits()
        super().committed(committed)

    def settle(self) -> bool:
        if not self._own_orders and not self._own_failures:
            return False
        orders, self._own_orders = self._own_orders, []
        failures, self._own_failures = self._own_failures, []
        for order in orders:
            self.member.do(order)
        for failure in failures:
            self.owner.hear(failure)
        return True

    # --- within

    def _should_act(self, epoch: int) -> bool:
        if epoch > self._intended:
            return True
        if epoch == self._acted:
            return False  # done, in an attempt that did not come to its end
        repeats = self._on_uncertain_act == "repeat"
        done = "it is repeated" if repeats else "it is skipped"
        what = f"nobody knows whether the act of epoch {epoch} was done; {done} (on_uncertain_act)"
        self.note(f"{self.member.name}: {what}")
        return repeats

    def _hear_own(self, word: Control) -> None:
        if isinstance(word, Failed):  # it may be the owner that has just begun the epoch
            self._own_failures.append(word)
        else:
            self.owner.hear(word)

    def _record(self) -> checkpoint.WorldRecord:
        owner, engine = self.owner, self._runner.engine
        begun = engine.epoch > owner.progress.epoch  # and not committed
        trial = owner.members.trial
        if not self._roster_bytes:
            self._roster_bytes = encode_value(owner.members.roster.plain())
            self._alone_bytes = encode_value(tuple(sorted(owner.members.alone)))
            self._process_bytes = encode_value(
                {name: (token, *owner.members.born[name]) for name, token in sorted(owner.members.processes.items())}
            )
        return checkpoint.WorldRecord(
            epoch=owner.progress.epoch + 1,
            attempt=max(owner.progress.attempt, 0),
            instance=owner.members.roster.instance(self.member.name),
            roster=self._roster_bytes,
            highest_version=owner.planning.highest,
            last_digest=self.pacemaker.chain.digest,
            state=engine.encoded_start if begun else engine.encoded,
            intended=self._intended,
            acted=self._acted,
            processes=self._process_bytes,
            last_attempt=owner.progress.last_attempt,
            trial=b""
            if trial is None
            else checkpoint.encode_trial(trial.name, trial.before, (trial.process, *trial.born), trial.alone),
            alone=self._alone_bytes,
            under_way=engine.under_way,
            drains=owner.progress.drains,
        )

    def _proceed(self, its_turn: bool = False) -> None:
        """Begin the next epoch, or let what was committed count, before anybody hears of it."""
        if self.pacemaker.may_begin(self._runner.engine):
            if its_turn or not self._runner.staleness.free:
                self.owner.proceed()
        elif self.pacemaker.done:
            self.write_record()
            self._finish()

    def _finish(self) -> None:
        self.owner.finish(drained=self.pacemaker.limit == self._runner.engine.epoch)


def _living_trial(recorded: tuple[str, Roster, checkpoint.Place, bool] | None, living: Container[str]) -> Tried | None:
    """What is tried, by the record; what it has replaced may have died meanwhile."""
    if recorded is None:
        return None
    name, before, (token, version, epoch, request), alone = recorded
    return name, before, token if token in living else "", (version, epoch, request), alone


def has_record(slots: Slots) -> bool:
    """Whether a run was begun: else none of its messages was ever sent, and it begins anew."""
    return not never_whole(slots.read())


def read_record(slots: Slots) -> tuple[checkpoint.WorldRecord, Saved]:
    """What a new process of the world's goes on with. Raises `HieraxError` if there is no whole record."""
    data, faults = newest_whole(slots.read())
    if data is None:
        raise HieraxError(f"the world's record cannot be used: {faults or 'nothing was ever written'}")
    record = checkpoint.decode_world(data)
    if faults:
        _log.warning("record: %s; using that of epoch %d", faults, record.epoch)
        record = _safest(record)
    state = ActiveNode(*checkpoint.decode_state(record.state))
    return record, Saved(record.epoch - 1, record.last_attempt, state, state, record.under_way)


def _safest(record: checkpoint.WorldRecord) -> checkpoint.WorldRecord:
    """A record after which another one was written, which is damaged.

    That one may have taken the next attempt and version, and intended the act: none is used again."""
    intended = max(record.intended, record.epoch)
    return record._replace(attempt=record.attempt + 1, highest_version=record.highest_version + 1, intended=intended)
