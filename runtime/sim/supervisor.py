"""The supervisor of simulated processes: starts them, notices their deaths, and reports these to the owner."""

from collections import Counter
from collections.abc import Mapping
from random import Random

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.world_member import OnUncertainAct, Supervision, WorldMember, has_record, read_record
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.owner.owner import Owner
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.network import SimPort, SimStorage
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.process import TICK_S, SimProcess, Surroundings
from hierax.schemas.control import Census, Control, Lost, Prepare
from hierax.schemas.roster import Roster

NOTICE_S, RESTART_S = 0.02, 0.05  # at most, until a death is noticed, and until another process is there

END_S = 0.01  # until a process that is to be ended is
UNREACHED_S = 0.1  # after which time it is tried again where a process is cut off


def occupy(around: Surroundings, process: SimProcess, supervision: Supervision) -> None:
    """Have a process run what it runs in production."""
    if process.is_world:
        process.world = SimWorld(around, process, supervision)
    else:
        port = SimPort(around.network, process)
        seat = Seat(process.name, process.token, process.wire, port)
        process.member = Member(seat, process.say, Checkpoints(Slots(process.storage)))


def link_first(around: Surroundings, process: SimProcess) -> None:
    """Have a process open its links before the run begins."""
    if process.member is not None:
        process.member.obey(Prepare(around.scenario.roster.plain(), around.scenario.alone))
    elif isinstance(process.world, SimWorld):
        process.world.link()


class SimWorld:
    """What the world's process runs: it waits until its supervisor says who lives, then it has a member."""

    def __init__(self, around: Surroundings, process: SimProcess, supervision: Supervision) -> None:
        self._around = around  # what the process stands in
        self._process = process  # of the world
        self._supervision = supervision  # of all processes
        self._port = SimPort(around.network, process)
        self._running: WorldMember | None = None

    def take_word(self, word: Control) -> None:
        """The supervisor's word, then those of all others; nobody hears anything before."""
        if isinstance(word, Census):
            self._begin(word.processes)
        elif self._running is not None:
            self._running.take_word(word)

    @property
    def over(self) -> bool:
        return self._running is not None and self._running.owner.progress.over

    def tick(self) -> None:
        if self._running is not None:
            self._running.tick()

    def link(self) -> None:
        roster = self._around.scenario.roster
        above = roster.above(self._process.name)
        self._port.link((), above, roster.version, roster.instances, lambda _: None)

    def _begin(self, living: Mapping[str, str]) -> None:
        scenario, checker, process = self._around.scenario, self._around.checker, self._process
        slots = Slots(process.storage)
        roster: Roster | None = None
        if has_record(slots):
            record, _ = read_record(slots)
            checker.resumes(record.epoch, record.last_digest)
            if any(read.fault for read in slots.read()):
                checker.uncertain.update((record.epoch, record.epoch + 1))
        else:
            roster = scenario.roster
            if process.token != f"{process.name}.1" and scenario.together:
                self.link()
            first = [f"{name}.1" for name in roster.nodes] if scenario.together else []
            here = {token.rpartition(".")[0]: token for token in first if token in living}
            living = {**here, process.name: process.token}
        self._running = self._member(slots, living, roster)
        process.member = self._running.member
        self._running.start()

    def _member(self, slots: Slots, living: Mapping[str, str], roster: Roster | None) -> WorldMember:
        process, scenario, clock = self._process, self._around.scenario, self._around.clock
        policy = OwnerPolicy(
            modules=(MODULE,),
            on_loss=scenario.on_loss,
            rejoin_timeout_s=scenario.rejoin_timeout_s,
            alone=scenario.alone,
            epoch_deadline_s=scenario.epoch_deadline_s,
            start_timeout_s=2.0,
            answer_timeout_s=0.8,
            rated=scenario.rated,
            overlaps=scenario.rated,
        )
        limit = None if scenario.ends_itself else scenario.epochs
        pacemaker = Pacemaker(DigestChain(scenario.roster.content_hash()), limit, process.publish, clock)
        seat = Seat(process.name, process.token, process.wire, self._port)
        own = (seat, process.send_order, self._supervision, slots)
        uncertain: OnUncertainAct = "repeat" if scenario.on_uncertain_act == "repeat" else "skip"
        return WorldMember(*own, pacemaker, policy, clock, living, roster, on_uncertain_act=uncertain)


class SimSupervisor(Supervision):
    """Supervises all processes of a simulation."""

    def __init__(self, around: Surroundings) -> None:
        seed = around.scenario.seed
        self.stopped = ""  # why the owner gave the run up; empty: it did not
        self.answers: dict[str, str] = {}  # what became of the changes that were asked for
        self._around = around  # what the processes stand in
        self._rng = Random(f"{seed}/simulation")
        self._disk_rng = Random(f"{seed}/disk")
        self._started: Counter[str] = Counter()
        self._final: set[str] = set()

    # --- what processes need

    def start(self, name: str, request: str = "", storage: SimStorage | None = None) -> SimProcess:
        """A process of a node comes up: for a change, or in the place of another, whose storage it has."""
        around = self._around
        self._started[name] += 1
        token = f"{name}.{self._started[name]}"
        process = SimProcess(around, self, name, token, request, storage or SimStorage(self._disk_rng))
        around.processes[token] = process
        around.network.came(process)
        occupy(around, process, self)
        around.clock.schedule(self._rng.uniform(0.0, TICK_S), self._tick, process)
        around.journal.trace(f"{token} starts" + (f" for {request}" if request else ""))
        return process

    def begin(self, process: SimProcess) -> None:
        try:
            process.take("word", Census({token: token for token in self._around.processes if token != process.token}))
        except HieraxError as error:
            self.stop(str(error))
        kept = {each.name for each in self._around.processes.values() if not self._is_newcomer(each)}
        for name in sorted(self._final - kept):
            self.send_to_owner(Lost(name, "", restarts=False))  # this one has not heard it

    def died(self, process: SimProcess) -> None:
        """A process is dead; its supervisor finds out and starts another one."""
        around = self._around
        self._final.discard(process.name)
        around.journal.trace(f"{process.token} dies at {process.at!r}")
        if not self._gone(process):
            return
        if process.acting:
            around.checker.uncertain.add(process.acting)
        around.clock.schedule(self._rng.uniform(0.0, NOTICE_S), self._notice, process)

    def exited(self, process: SimProcess) -> None:
        self._gone(process)
        self.send_to_owner(Lost(process.name, process.token, restarts=False))
        if not self._is_newcomer(process):
            self._final.add(process.name)

    def miss(self, process: SimProcess) -> None:
        """A process is not heard of, and its supervisor neither."""
        if process.alive and not process.is_world:
            self._around.checker.lost(process.name)
            self.send_to_owner(Lost(process.name, process.token, restarts=True))

    def send_to_owner(self, word: Control) -> None:
        """What a supervisor says is not lost while the world's process lives, and is on their list when it doesn't."""
        world = self._around.world
        if world is not None:
            self._around.clock.schedule(0.0, world.take, "word", word)

    def _is_newcomer(self, process: SimProcess) -> bool:
        """Whether it was started for a change that has not given it a place yet."""
        return bool(process.request) and not self._around.checker.had_place(process.token)

    def _gone(self, process: SimProcess) -> bool:
        self._around.checker.lost(process.name)
        was, process.alive = process.alive, False
        self._around.processes.pop(process.token, None)
        return was

    def _tick(self, process: SimProcess) -> None:
        if process.alive:
            process.take("tick", None)
            self._around.clock.schedule(TICK_S, self._tick, process)

    def _notice(self, process: SimProcess) -> None:
        self._around.journal.trace(f"supervisor: {process.token} is dead")
        restarts = self._restarts(process.name)
        self.send_to_owner(Lost(process.name, process.token, restarts))
        if restarts:
            self._around.clock.schedule(self._rng.uniform(0.0, RESTART_S), self._restart, process)
        else:
            self._final.add(process.name)

    def _restarts(self, name: str) -> bool:
        return name not in self._around.scenario.left_dead

    def _restart(self, process: SimProcess) -> None:
        """Start another process, unless that one never had a place in the roster: then who asked for it knows."""
        if self._is_newcomer(process):
            return
        again = self.start(process.name, storage=process.storage)
        if again.is_world:
            self.begin(again)

    # --- what the world's member calls; the checker looks at what that is told and what it says

    def begins(self, owner: Owner, epoch: int, attempt: int, version: int) -> None:
        turn = Turn(version, epoch, attempt)
        self._around.journal.trace(f"owner begins {turn}")
        members, before = owner.members, self._world.engine.wiring.roster
        self._around.checker.begins(before, turn, members.roster, members.processes)
        self._world.inspector.turn = turn

    def acts(self, epoch: int) -> None:
        self._world.acting = epoch

    def commits(self) -> None:
        turn = self._world.inspector.turn
        self._around.checker.commits(turn, self._around.states(turn))
        self._world.point("commit")

    @property
    def _world(self) -> SimProcess:
        assert self._around.world is not None
        return self._around.world

    def end(self, name: str, process: str, why: str) -> None:
        self._around.journal.trace(f"owner ends {process}: {why}")
        self._around.checker.lost(name)
        self._around.clock.schedule(END_S, self._kill, name, process, why)

    def stop(self, why: str) -> None:
        self._around.journal.trace(f"owner stops the run: {why}")
        checker = self._around.checker
        checker.excused |= checker.foretold and "somebody else" in why
        self.stopped = why

    def note(self, what: str) -> None:
        self._around.journal.trace(f"owner notes: {what}")

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        world = self._around.world
        if world is not None:
            world.point("answer")
        told = self._around.checker.told
        if epoch > told + 1:
            self._around.checker.violate(f"{request} is said to hold from epoch {epoch} on, {told} is the last")
        self._around.journal.trace(f"{request}: {refusal or f'from epoch {epoch} on'}")
        self.answers.setdefault(request, refusal or f"epoch {epoch}")

    def _kill(self, name: str, token: str, why: str) -> None:
        process = self._around.processes.get(token)
        if process is None:  # it was told before, but that may have been to another owner
            self.send_to_owner(Lost(name, token, self._restarts(name)))
        elif token in self._around.network.cut:
            self._around.clock.schedule(UNREACHED_S, self._kill, name, token, why)
        else:
            process.at = f"killed: {why}"
            self.died(process)
