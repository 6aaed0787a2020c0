"""One simulation: a run under the faults of a scenario, and whether all that must hold does."""

from collections.abc import Mapping
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

from hierax.runtime.sim import scenario
from hierax.runtime.sim.checker import Checker, ViolationError
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.journal import CHANGE, FAULT, Journal, Tally
from hierax.runtime.sim.network import Clock, Network
from hierax.runtime.sim.process import SimProcess, Surroundings
from hierax.runtime.sim.rated import RatedChecker
from hierax.runtime.sim.scenario import BREAK, Proposal, Scenario
from hierax.runtime.sim.supervisor import SimSupervisor, link_first

AFTER_S = 20.0  # how long a run may take after its last fault
AFTER_BREAKS_S = 1.5  # likewise, where links broke, nothing else befell it and no deadline helps

PROPOSE_AGAIN_S = 0.4
MAX_EVENTS = 400_000

UNHEARD_S = 0.1  # how long until a process that is cut off is missed
# Those that befall a process at its next write, call or message, and count then.
_WAITING = (scenario.TORN, scenario.RAISE, *scenario.FORGED)


@dataclass(eq=False, repr=False)
class FaultInjector:
    """Makes faults happen."""

    around: Surroundings  # what the processes stand in
    supervisor: SimSupervisor  # of the processes

    def befall(self, fault: scenario.Fault) -> None:
        around = self.around
        around.journal.trace(f"fault: {fault}")
        if fault.kind in scenario.OF_MESSAGES:
            around.network.faults.append(fault)
            around.clock.schedule(fault.for_s, around.network.faults.remove, fault)
            return
        candidates = [each for each in around.processes.values() if each.name == fault.name]
        if candidates:
            self._befall_process(fault, candidates[fault.number % len(candidates)])

    def _befall_process(self, fault: scenario.Fault, process: SimProcess) -> None:
        kind, around = fault.kind, self.around
        if kind not in _WAITING:
            around.journal.count(FAULT, kind)
        if kind in (scenario.CRASH, scenario.WORLD):
            process.calls_left = fault.number
        elif kind == scenario.TORN:
            process.torn = True
        elif kind == scenario.RAISE:
            process.raises = True
        elif kind in scenario.FORGED:
            process.forges = kind
        elif kind == scenario.DAMAGE:
            around.checker.excused |= process.storage.damage()
            self.supervisor.died(process)
        elif kind in (scenario.HANG, scenario.PAUSE):
            process.freeze()
            process.busy = kind == scenario.HANG
            around.clock.schedule(fault.for_s, process.thaw)
        elif kind == scenario.SLOW:
            process.slowness_s = fault.share
            around.clock.schedule(fault.for_s, setattr, process, "slowness_s", 0.0)
        elif kind == scenario.BREAK:
            around.network.break_link(process, fault.number, fault.for_s)
        elif kind == scenario.PARTITION:
            around.network.cut.add(process.token)
            around.clock.schedule(fault.for_s, self._heal, process.token)
            if fault.number:  # its supervisor is cut off as well: that it is not heard of is all there is
                around.clock.schedule(UNHEARD_S, self._miss, process)

    def _miss(self, process: SimProcess) -> None:
        if process.token in self.around.network.cut:
            self.supervisor.miss(process)

    def _heal(self, token: str) -> None:
        self.around.journal.trace(f"{token} is joined again")
        self.around.network.cut.discard(token)
        self.around.network.open_links()


class Result(NamedTuple):
    """How a simulation ended."""

    seed: int  # its scenario's
    violation: str  # what did not hold; empty: all did
    epochs: int  # how many were committed
    tally: Tally  # how often each kind of thing occurred
    stopped: str  # why the run gave up, as it may under some faults
    answers: Mapping[str, str]  # what became of the changes that were asked for


def simulate(scenario: Scenario, trace: list[str] | None = None) -> Result:
    simulation = Simulation(scenario, trace)
    violation = ""
    try:
        simulation.run()
    except ViolationError as error:
        violation = str(error)
    except Exception as error:  # production code must not raise, whatever happens
        violation = f"{type(error).__name__}: {error}"
        if trace is not None:
            import traceback

            trace.extend(traceback.format_exc().splitlines())
    around, supervisor = simulation.around, simulation.supervisor
    return Result(
        scenario.seed,
        violation,
        around.checker.told,
        around.journal.tally,
        supervisor.stopped,
        supervisor.answers,
    )


class Simulation:
    """A run from its beginning to its end, with those who ask for changes."""

    def __init__(self, scenario: Scenario, trace: list[str] | None) -> None:
        clock = Clock()
        journal = Journal(clock, trace)
        checker = (RatedChecker if scenario.rated else Checker)(scenario, journal.trace)
        network = Network(clock, Random(f"{scenario.seed}/network"), journal, checker)
        self._scenario = scenario
        self.around = Surroundings(scenario, clock, journal, checker, network)  # what the processes stand in
        network.hosts = self.around.processes
        self.supervisor = SimSupervisor(self.around)  # of the processes

    def run(self) -> None:
        """Let everything happen. Raises `ViolationError` if something that must hold does not."""
        scenario, around = self._scenario, self.around
        self._start()
        injector = FaultInjector(around, self.supervisor)
        for fault in scenario.faults:
            around.clock.schedule(fault.at_s, injector.befall, fault)
        for proposal in scenario.proposals:
            around.clock.schedule(proposal.at_s, self._propose, proposal)
        only_breaks = {fault.kind for fault in scenario.faults} == {BREAK} and not scenario.proposals
        limit_s = scenario.last_s + (AFTER_BREAKS_S if only_breaks else AFTER_S)
        events = 0
        while not self._done():
            events += 1
            if self.supervisor.stopped:
                if not around.checker.excused:
                    around.checker.violate(f"the run gave up: {self.supervisor.stopped}")
                return
            if around.clock.now > limit_s or events > MAX_EVENTS or not around.clock.step():
                around.checker.violate(self._stuck(limit_s))
        last = Turn(around.checker.version, around.checker.told, 0)
        around.checker.finishes(self.supervisor.answers, around.states(last))
        for proposal in scenario.proposals:
            if self.supervisor.answers[proposal.key].startswith("epoch "):
                around.journal.count(CHANGE, type(proposal.change).__name__)

    def _start(self) -> None:
        processes = [self.supervisor.start(name) for name in sorted(self._scenario.roster.nodes)]
        if self._scenario.together:
            self.around.network.at_once = True
            for process in processes:
                link_first(self.around, process)
            self.around.network.at_once = False
        for process in processes:
            if process.is_world:
                self.supervisor.begin(process)

    def _done(self) -> bool:
        scenario = self._scenario
        if self.around.checker.told < scenario.epochs or len(self.supervisor.answers) < len(scenario.proposals):
            return False
        return self.around.over or not scenario.rated

    def _stuck(self, limit_s: float) -> str:
        unanswered = sorted({proposal.key for proposal in self._scenario.proposals} - self.supervisor.answers.keys())
        asked = f", {', '.join(unanswered)} are not answered" if unanswered else ""
        return f"after {limit_s:.1f} s, all faults long over, epoch {self.around.checker.told} is the last{asked}"

    def _propose(self, proposal: Proposal) -> None:
        """Ask for a change, until there is an answer."""
        around = self.around
        if proposal.key in self.supervisor.answers or self.supervisor.stopped:
            return
        for name in proposal.new_nodes:
            if not any(each.name == name and each.request == proposal.key for each in around.processes.values()):
                self.supervisor.start(name, proposal.key)
        world = around.world
        if world is not None:
            around.network.say("user", world.token, proposal.word())
        around.clock.schedule(PROPOSE_AGAIN_S, self._propose, proposal)
