"""The faults of a scenario, as they befall processes and the network."""

from __future__ import annotations

from dataclasses import dataclass

from hierax.runtime.sim import scenario
from hierax.runtime.sim.journal import FAULT
from hierax.runtime.sim.process import SimProcess, Surroundings
from hierax.runtime.sim.supervisor import SimSupervisor

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
