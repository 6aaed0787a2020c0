"""One simulation: a run under the faults of a scenario, and whether all that must hold does."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random
from typing import Any, NamedTuple

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.engine.engine import DigestChain
from hierax.runtime.engine.outlet import Committed
from hierax.runtime.member import Member
from hierax.runtime.owner.outlet import OwnerSettings
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.runner import Pacemaker
from hierax.runtime.sim.checker import Checker, ViolationError
from hierax.runtime.sim.clock import Clock
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.network import Network, SimPort
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.process import TICK_S, SimProcess
from hierax.runtime.sim.scenario import (
    CRASH,
    DAMAGE,
    HANG,
    PARTITION,
    PAUSE,
    SLOW,
    TORN,
    WORLD,
    Fault,
    Proposal,
    Scenario,
)
from hierax.runtime.sim.storage import SimStorage
from hierax.runtime.world_member import Keeper, WorldMember, has_record, read_record
from hierax.schemas.changes import Attach, Replace
from hierax.schemas.control import Control, Lost, Order, Prepare, Propose
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster

AFTER_S = 20.0
"""How long a run may take after its last fault."""

NOTICE_S, RESTART_S = 0.02, 0.05
"""At most, until a death is noticed, and until another process is there."""

UNHEARD_S = 0.1
"""How long until a process that is cut off is missed."""

PROPOSE_AGAIN_S = 0.4
MAX_EVENTS = 400_000


class Result(NamedTuple):
    """How a simulation ended.

    Attributes:
        seed: its scenario's.
        violation: what did not hold; empty: all did.
        epochs: how many were committed.
        faults: how often each kind befell something.
        virtual_s: how long it took in virtual time.
        stopped: why the run gave up, as it may under some faults.
        answers: what became of the changes that were asked for.
    """

    seed: int
    violation: str
    epochs: int
    faults: Mapping[str, int]
    virtual_s: float
    stopped: str
    answers: Mapping[str, str]


def simulate(scenario: Scenario, trace: list[str] | None = None) -> Result:
    """Run a scenario.

    Args:
        scenario: what is to happen.
        trace: where a line for each event goes.
    """
    simulation = Simulation(scenario, trace)
    violation = ""
    try:
        simulation.run()
    except ViolationError as error:
        violation = str(error)
    except (HieraxError, SchemaError, ValueError, KeyError, AttributeError, IndexError, RuntimeError) as error:
        violation = f"{type(error).__name__}: {error}"  # production code must not raise, whatever happens
        if trace is not None:
            import traceback

            trace.extend(traceback.format_exc().splitlines())
    checker = simulation.checker
    return Result(
        scenario.seed,
        violation,
        checker.told,
        dict(sorted(checker.faults.items())),
        simulation.clock.now,
        simulation.stopped,
        simulation.answers,
    )


class Simulation:
    """The processes of a run, their network, keepers and users."""

    def __init__(self, scenario: Scenario, trace: list[str] | None) -> None:
        self.scenario = scenario
        self.clock = Clock()
        self.checker = Checker(scenario, self.trace)
        self.stopped = ""
        self.answers: dict[str, str] = {}
        self.over = False
        self._lines = trace
        self._rng = Random(f"{scenario.seed}/simulation")
        self._disk_rng = Random(f"{scenario.seed}/disk")
        self._processes: dict[str, SimProcess] = {}
        self._requests: dict[str, str] = {}
        self._damaged = False
        self._final: set[str] = set()
        self._started = 0
        self._epochs_at_quiet = 0
        self.network = Network(
            self.clock,
            Random(f"{scenario.seed}/network"),
            self._processes,
            lambda header, sender: self.checker.sends(header, sender.is_world),
            self._unheard,
            self.checker.counted,
        )
        self.keeper = SimKeeper(self)

    def trace(self, what: str) -> None:
        """Note an event."""
        if self._lines is not None:
            self._lines.append(f"{self.clock.now:9.4f} {what}")

    # --- the run

    def run(self) -> None:
        """Let everything happen.

        Raises:
            ViolationError: something that must hold does not.
        """
        scenario = self.scenario
        self._start()
        last_s = 0.0
        for fault in scenario.faults:
            self.clock.schedule(fault.at_s, self._befall, fault)
            last_s = max(last_s, fault.at_s + fault.for_s)
        for proposal in scenario.proposals:
            self.clock.schedule(proposal.at_s, self._propose, proposal)
            last_s = max(last_s, proposal.at_s)
        limit_s = last_s + AFTER_S
        events = 0
        while not self._done():
            events += 1
            if self.stopped:
                return self._check_stop()
            if self.clock.now > limit_s or events > MAX_EVENTS or not self.clock.step():
                self.checker.violate(self._stuck(limit_s))
        self.checker.finishes(self.answers)
        return None

    def _done(self) -> bool:
        return self.checker.told >= self.scenario.epochs and len(self.answers) == len(self.scenario.proposals)

    def _stuck(self, limit_s: float) -> str:
        unanswered = sorted({proposal.key for proposal in self.scenario.proposals} - self.answers.keys())
        asked = f", {', '.join(unanswered)} are not answered" if unanswered else ""
        return f"after {limit_s:.1f} s, all faults long over, epoch {self.checker.told} is the last{asked}"

    def _check_stop(self) -> None:
        if not self._damaged:
            self.checker.violate(f"the run gave up: {self.stopped}")

    def _start(self) -> None:
        names = sorted(self.scenario.roster.nodes)
        for name in names:
            self._new_process(name, "", SimStorage(self._disk_rng))
        if self.scenario.together:
            plain = self.scenario.roster.plain()
            self.network.at_once = True
            for process in list(self._processes.values()):
                self._link_first(process, plain)
            self.network.at_once = False
        for process in list(self._processes.values()):
            if process.is_world:
                self._begin(process)

    def _link_first(self, process: SimProcess, plain: Any) -> None:
        if process.is_world:
            self._link_world(process)
        else:
            process.member.obey(Prepare(plain))

    def _link_world(self, process: SimProcess) -> None:
        roster = self.scenario.roster
        above = tuple(sorted(edge.upper for edge in roster.edges if edge.lower == process.name))
        process.member.port.link((), above, roster, process.member.linked)

    def _begin(self, process: SimProcess) -> None:
        """The world's process begins the run, or goes on with it."""
        try:
            process.run(lambda: self._begin_in(process))
        except HieraxError as error:
            self.keeper.stop(str(error))

    def _begin_in(self, process: SimProcess) -> None:
        member = process.member
        assert isinstance(member, SimWorldMember)
        slots = Slots(process.storage)
        if has_record(slots):
            record, _ = read_record(slots)
            faulty = any(read.fault for read in slots.read())
            self.checker.resumes(record.epoch, record.last_digest, self._damaged)
            if faulty:
                self.checker.uncertain.update((record.epoch, record.epoch + 1))
            for name in sorted(self._final - {each.name for each in self._processes.values()}):
                self._to_owner(Lost(name, "", restarts=False))  # this one has not heard it
            member.resume_run({f"{each.token}": each.token for each in self._processes.values() if not each.is_world})
            return
        roster = self.scenario.roster
        if process.token != f"{process.name}.1" and self.scenario.together:
            self._link_world(process)
        living = {process.name: process.token}
        if self.scenario.together:
            living.update({name: f"{name}.1" for name in roster.nodes if f"{name}.1" in self._processes})
        member.begin_run(roster, living)

    # --- processes

    def _new_process(self, name: str, request: str, storage: SimStorage) -> SimProcess:
        self._started += 1
        number = sum(token.startswith(f"{name}.") for token in self._requests) + 1
        token = f"{name}.{number}"
        self._requests[token] = request
        process = SimProcess(self, name, token, request, storage)
        self._processes[token] = process
        port = SimPort(self.network, process)
        if process.is_world:
            process.member = self._world_member(process, port)
        else:
            process.member = SimMember(
                name, token, process.wire, port, lambda word: self.say(process, word), Slots(storage)
            )
        self.clock.schedule(self._rng.uniform(0.0, TICK_S), self._tick, process)
        self.trace(f"{token} starts" + (f" for {request}" if request else ""))
        return process

    def _world_member(self, process: SimProcess, port: SimPort) -> SimWorldMember:
        pacemaker = Pacemaker(
            DigestChain(self.scenario.roster.content_hash()),
            self.scenario.epochs,
            lambda epoch, digest: self._tell(process, epoch, digest),
            self.clock,
        )
        settings = OwnerSettings(
            modules=(MODULE,),
            on_loss=self.scenario.on_loss,
            rejoin_timeout_s=self.scenario.rejoin_timeout_s,
            epoch_deadline_s=0.3,
            start_timeout_s=2.0,
            answer_timeout_s=0.8,
        )
        uncertain = self.scenario.on_uncertain_act
        return SimWorldMember(
            self,
            process,
            process.name,
            process.token,
            process.wire,
            port,
            lambda token, order: self.tell(process, token, order),
            self.keeper,
            Slots(process.storage),
            pacemaker,
            settings,
            self.clock,
            on_uncertain_act="repeat" if uncertain == "repeat" else "skip",
        )

    def _tick(self, process: SimProcess) -> None:
        if process.alive:
            process.take("tick", None)
            self.clock.schedule(TICK_S, self._tick, process)

    def tick_world(self, process: SimProcess) -> None:
        """The world's process looks after the run."""
        member = process.member
        if isinstance(member, SimWorldMember) and hasattr(member, "owner"):
            member.tick()

    def hear(self, process: SimProcess, word: Control) -> None:
        """Somebody says something to the owner."""
        member = process.member
        if isinstance(member, SimWorldMember) and hasattr(member, "owner"):
            self.trace(f"owner hears {_short(word)}")
            member.hear(word)

    def say(self, process: SimProcess, word: Control) -> None:
        """A process says something to the owner."""
        process.point(f"say {type(word).__name__}")
        world = self.world
        if world is not None:
            self.network.say(process.token, world.token, word)
        process.point("said")

    def tell(self, process: SimProcess, token: str, order: Order) -> None:
        """The owner says something to a process."""
        process.point(f"tell {type(order).__name__}")
        self.trace(f"owner tells {token} {_short(order)}")
        if isinstance(order, Prepare):
            self.checker.prepared(Roster.read(order.roster))
        self.network.say(process.token, token, order)
        process.point("told")

    @property
    def world(self) -> SimProcess | None:
        """The world's living process."""
        name = self.scenario.roster.world
        return next((process for process in self._processes.values() if process.name == name), None)

    def _tell(self, process: SimProcess, epoch: int, digest: bytes) -> None:
        process.point("publish")
        self.checker.tells(epoch, digest)

    # --- deaths

    def died(self, process: SimProcess) -> None:
        """A process is dead; its keeper finds out and starts another one."""
        self._final.discard(process.name)
        self.trace(f"{process.token} dies at {process.at!r}")
        if not self._gone(process):
            return
        if process.is_world and isinstance(process.member, SimWorldMember) and process.member.acting:
            self.checker.uncertain.add(process.member.acting)
        self.clock.schedule(self._rng.uniform(0.0, NOTICE_S), self._notice, process)

    def exited(self, process: SimProcess) -> None:
        """A process was dismissed: it is not started again."""
        self._gone(process)
        self._to_owner(Lost(process.name, process.token, restarts=False))
        if not process.request or self.checker.had_place(process.token):
            self._final.add(process.name)

    def _gone(self, process: SimProcess) -> bool:
        was = process.alive
        process.alive = False
        self._processes.pop(process.token, None)
        return was

    def _notice(self, process: SimProcess) -> None:
        self.trace(f"keeper: {process.token} is dead")
        restarts = process.name not in self.scenario.left_dead
        self._to_owner(Lost(process.name, process.token, restarts))
        if not restarts:
            self._final.add(process.name)
            return
        self.clock.schedule(self._rng.uniform(0.0, RESTART_S), self._restart, process)

    def _to_owner(self, word: Control) -> None:
        """What keepers say is not lost while the world's process lives, and is on their list when it doesn't."""
        world = self.world
        if world is not None:
            self.clock.schedule(0.0, world.take, "word", word)

    def _restart(self, process: SimProcess) -> None:
        """Start another process, unless that one never had a place in the roster: then who asked for it knows."""
        if process.request and not self.checker.had_place(process.token):
            return
        again = self._new_process(process.name, "", process.storage)
        if again.is_world:
            self._begin(again)

    def kill(self, token: str, why: str) -> None:
        """A keeper ends a process, when it can reach it."""
        process = self._processes.get(token)
        if process is None:  # it was told before, but that may have been to another owner
            name = token.rpartition(".")[0]
            self._to_owner(Lost(name, token, name not in self.scenario.left_dead))
            return
        if token in self.network.cut:
            self.clock.schedule(0.1, self.kill, token, why)
            return
        process.at = f"killed: {why}"
        self.died(process)

    # --- faults

    def _befall(self, fault: Fault) -> None:
        self.trace(f"fault: {fault}")
        if fault.kind in (CRASH, WORLD, TORN, DAMAGE, HANG, PAUSE, SLOW, PARTITION):
            candidates = [each for each in self._processes.values() if each.name == fault.name]
            if candidates:
                self._befall_process(fault, candidates[fault.number % len(candidates)])
            return
        self.network.faults.append(fault)
        self.clock.schedule(fault.for_s, self.network.faults.remove, fault)

    def _befall_process(self, fault: Fault, process: SimProcess) -> None:
        if fault.kind != TORN:
            self.checker.counted(fault.kind)
        if fault.kind in (CRASH, WORLD):
            process.calls_left = fault.number
        elif fault.kind == TORN:
            process.torn = True
        elif fault.kind == DAMAGE:
            if process.storage.damage():
                self._damaged = True
            self.died(process)
        elif fault.kind in (HANG, PAUSE):
            process.freeze()
            process.busy = fault.kind == HANG
            self.clock.schedule(fault.for_s, process.thaw)
        elif fault.kind == SLOW:
            process.slowness_s = fault.share
            self.clock.schedule(fault.for_s, setattr, process, "slowness_s", 0.0)
        elif fault.kind == PARTITION:
            self.network.cut.add(process.token)
            self.clock.schedule(fault.for_s, self._heal, process.token)
            if fault.number:  # its keeper is cut off as well: that it is not heard of is all there is
                self.clock.schedule(UNHEARD_S, self._miss, process)

    def _miss(self, process: SimProcess) -> None:
        if process.alive and process.token in self.network.cut and not process.is_world:
            self._to_owner(Lost(process.name, process.token, restarts=True))

    def _heal(self, token: str) -> None:
        self.trace(f"{token} is joined again")
        self.network.cut.discard(token)
        self.network.open_links()

    def _unheard(self, sender: SimProcess, header: Header) -> None:
        """A message is lost, as its link is not open; that must have a reason."""
        self.trace(f"{sender.token}: nobody hears its {header.kind} for {header.receiver} of epoch {header.epoch}")
        if header.roster != self.checker.version or sender.token != self.checker.process_of(header.roster, sender.name):
            return
        token = self.checker.process_of(header.roster, header.receiver)
        if token in self._processes and not self.network.parted(sender.token, str(token)):
            self.checker.violate(f"{sender.token}: its {header.kind} for {token} is lost: the link is not open")

    # --- users

    def _propose(self, proposal: Proposal) -> None:
        """Ask for a change, until there is an answer."""
        if proposal.key in self.answers or self.stopped:
            return
        change = proposal.change
        names = sorted(change.nodes) if isinstance(change, Attach) else []
        names = [change.name] if isinstance(change, Replace) else names
        for name in names:
            if not any(each.name == name and each.request == proposal.key for each in self._processes.values()):
                self._new_process(name, proposal.key, SimStorage(self._disk_rng))
        world = self.world
        if world is not None:
            self.network.say("user", world.token, Propose(proposal.key, change.plain()))
        self.clock.schedule(PROPOSE_AGAIN_S, self._propose, proposal)

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        """A user hears what became of a change."""
        if epoch > self.checker.told + 1:
            self.checker.violate(f"{request} is said to hold from epoch {epoch} on, {self.checker.told} is the last")
        self.trace(f"{request}: {refusal or f'from epoch {epoch} on'}")
        self.answers.setdefault(request, refusal or f"epoch {epoch}")

    # --- what the checker sees of processes

    def states(self, version: int) -> Mapping[str, bytes]:
        """The states that the processes in force have now."""
        return {
            process.name: process.member.engine.encoded
            for process in self._processes.values()
            if self.checker.process_of(version, process.name) == process.token
        }


class SimMember(Member):
    """As in production."""


class SimWorldMember(WorldMember):
    """The world's member; the checker looks at what it is told and what it says.

    Attributes:
        acting: the epoch of the act under way; 0: there is none.
    """

    def __init__(self, simulation: Simulation, sim_process: SimProcess, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._simulation = simulation
        self._sim_process = sim_process
        self.acting = 0

    def begin(self, epoch: int, attempt: int, version: int) -> None:
        turn = Turn(version, epoch, attempt)
        base = self.engine.wiring.roster
        owner = self.owner
        self._simulation.trace(f"owner begins {turn}")
        self._simulation.checker.begins(base, turn, owner.roster, owner.processes)
        self._sim_process.inspector.begin(turn)
        super().begin(epoch, attempt, version)

    def act(self, epoch: int, actions: Any) -> None:
        self.acting = epoch
        super().act(epoch, actions)
        self.acting = 0

    def committed(self, committed: Committed) -> None:
        turn = self._sim_process.inspector.turn
        self._simulation.checker.commits(turn, self._simulation.states(turn.version))
        self._sim_process.point("commit")
        super().committed(committed)


class SimKeeper(Keeper):
    """Of all processes."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def end(self, name: str, process: str, why: str) -> None:
        simulation = self._simulation
        simulation.trace(f"owner ends {process}: {why}")
        simulation.clock.schedule(0.01, simulation.kill, process, why)

    def stop(self, why: str) -> None:
        self._simulation.trace(f"owner stops the run: {why}")
        self._simulation.stopped = why

    def note(self, what: str) -> None:
        self._simulation.trace(f"owner notes: {what}")

    def answer(self, request: str, epoch: int, refusal: str) -> None:
        world = self._simulation.world
        if world is not None:
            world.point("answer")
        self._simulation.answer(request, epoch, refusal)


def _short(word: Any) -> str:
    if isinstance(word, Prepare):
        roster = word.roster
        return f"Prepare(version {roster['version']}, {sorted(roster['nodes'])}, {roster['instances']})"
    return f"{word!r:.160}"
