"""One simulation: a run under the faults of a scenario, and whether all that must hold does."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random
from typing import Any, NamedTuple

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.world_member import has_record, read_record
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.sim.checker import Checker, ViolationError
from hierax.runtime.sim.clock import Clock
from hierax.runtime.sim.keepers import Keepers
from hierax.runtime.sim.members import SimSupervision, SimWorldMember
from hierax.runtime.sim.mishaps import Mishaps
from hierax.runtime.sim.network import Network
from hierax.runtime.sim.process import SimProcess
from hierax.runtime.sim.scenario import BREAK, Proposal, Scenario
from hierax.runtime.sim.storage import SimStorage
from hierax.schemas.changes import Attach, Replace
from hierax.schemas.control import Control, Lost, Order, Prepare, Propose
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster

AFTER_S = 20.0
"""How long a run may take after its last fault."""

AFTER_BREAKS_S = 1.5
"""Likewise, where links broke, nothing else befell it and no deadline helps."""

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
        self._lines = trace
        self._disk_rng = Random(f"{scenario.seed}/disk")
        self.keepers = Keepers(self, Random(f"{scenario.seed}/simulation"))
        self._mishaps = Mishaps(self)
        self.network = Network(
            self.clock,
            Random(f"{scenario.seed}/network"),
            self.keepers.processes,
            lambda header, sender: self.checker.sends(header, sender.is_world),
            self._unheard,
            self.checker.counted,
        )
        self.keeper = SimSupervision(self)

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
            self.clock.schedule(fault.at_s, self._mishaps.befall, fault)
            last_s = max(last_s, fault.at_s + fault.for_s)
        for proposal in scenario.proposals:
            self.clock.schedule(proposal.at_s, self._propose, proposal)
            last_s = max(last_s, proposal.at_s)
        only_breaks = {fault.kind for fault in scenario.faults} == {BREAK} and not scenario.proposals
        limit_s = last_s + (AFTER_BREAKS_S if only_breaks else AFTER_S)
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
        if not self._mishaps.damaged:
            self.checker.violate(f"the run gave up: {self.stopped}")

    def _start(self) -> None:
        names = sorted(self.scenario.roster.nodes)
        for name in names:
            self.keepers.start(name, "", SimStorage(self._disk_rng))
        if self.scenario.together:
            plain = self.scenario.roster.plain()
            self.network.at_once = True
            for process in list(self.keepers.processes.values()):
                self._link_first(process, plain)
            self.network.at_once = False
        for process in list(self.keepers.processes.values()):
            if process.is_world:
                self.begin(process)

    def _link_first(self, process: SimProcess, plain: Any) -> None:
        if process.is_world:
            self._link_world(process)
        else:
            process.member.obey(Prepare(plain))

    def _link_world(self, process: SimProcess) -> None:
        roster = self.scenario.roster
        above = tuple(sorted(edge.upper for edge in roster.edges if edge.lower == process.name))
        process.member.port.link((), above, roster.version, roster.instances, process.member.linked)

    def begin(self, process: SimProcess) -> None:
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
            self.checker.resumes(record.epoch, record.last_digest, self._mishaps.damaged)
            if faulty:
                self.checker.uncertain.update((record.epoch, record.epoch + 1))
            for name in sorted(self.keepers.final - {each.name for each in self.keepers.processes.values()}):
                self.keepers.tell_owner(Lost(name, "", restarts=False))  # this one has not heard it
            member.resume_run({token: token for token, each in self.keepers.processes.items() if not each.is_world})
            return
        roster = self.scenario.roster
        if process.token != f"{process.name}.1" and self.scenario.together:
            self._link_world(process)
        living = {process.name: process.token}
        if self.scenario.together:
            living.update({name: f"{name}.1" for name in roster.nodes if f"{name}.1" in self.keepers.processes})
        member.begin_run(roster, living)

    # --- processes

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
        return next((process for process in self.keepers.processes.values() if process.name == name), None)

    def publish(self, process: SimProcess, epoch: int, digest: bytes) -> None:
        process.point("publish")
        self.checker.tells(epoch, digest)

    def _unheard(self, sender: SimProcess, header: Header) -> None:
        """A message is lost, as its link is not open; that must have a reason."""
        self.trace(f"{sender.token}: nobody hears its {header.kind} for {header.receiver} of epoch {header.epoch}")
        if header.roster != self.checker.version or sender.token != self.checker.process_of(header.roster, sender.name):
            return
        token = self.checker.process_of(header.roster, header.receiver)
        if token in self.keepers.processes and not self.network.parted(sender.token, str(token)):
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
            if not any(each.name == name and each.request == proposal.key for each in self.keepers.processes.values()):
                self.keepers.start(name, proposal.key, SimStorage(self._disk_rng))
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
            for process in self.keepers.processes.values()
            if self.checker.process_of(version, process.name) == process.token
        }


def _short(word: Any) -> str:
    if isinstance(word, Prepare):
        roster = word.roster
        return f"Prepare(version {roster['version']}, {sorted(roster['nodes'])}, {roster['instances']})"
    return f"{word!r:.160}"
