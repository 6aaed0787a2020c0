"""The faults of a scenario, as they befall processes and the network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hierax.runtime.sim.process import SimProcess
from hierax.runtime.sim.scenario import BREAK, CRASH, DAMAGE, HANG, PARTITION, PAUSE, SLOW, TORN, WORLD, Fault
from hierax.schemas.control import Lost

if TYPE_CHECKING:
    from hierax.runtime.sim.simulation import Simulation

UNHEARD_S = 0.1
"""How long until a process that is cut off is missed."""


class Mishaps:
    """Makes faults happen.

    Args:
        simulation: to which they do.

    Attributes:
        damaged: whether anything that was written was found so.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.damaged = False
        self._simulation = simulation

    def befall(self, fault: Fault) -> None:
        """A fault happens."""
        self._simulation.trace(f"fault: {fault}")
        if fault.kind in (CRASH, WORLD, TORN, DAMAGE, HANG, PAUSE, SLOW, PARTITION, BREAK):
            candidates = [each for each in self._simulation.keepers.processes.values() if each.name == fault.name]
            if candidates:
                self._befall_process(fault, candidates[fault.number % len(candidates)])
            return
        self._simulation.network.faults.append(fault)
        self._simulation.clock.schedule(fault.for_s, self._simulation.network.faults.remove, fault)

    def _befall_process(self, fault: Fault, process: SimProcess) -> None:
        if fault.kind != TORN:
            self._simulation.checker.counted(fault.kind)
        if fault.kind in (CRASH, WORLD):
            process.calls_left = fault.number
        elif fault.kind == TORN:
            process.torn = True
        elif fault.kind == DAMAGE:
            if process.storage.damage():
                self.damaged = True
            self._simulation.keepers.died(process)
        elif fault.kind in (HANG, PAUSE):
            process.freeze()
            process.busy = fault.kind == HANG
            self._simulation.clock.schedule(fault.for_s, process.thaw)
        elif fault.kind == SLOW:
            process.slowness_s = fault.share
            self._simulation.clock.schedule(fault.for_s, setattr, process, "slowness_s", 0.0)
        elif fault.kind == BREAK:
            self._simulation.network.break_link(process, fault.number, fault.for_s)
        elif fault.kind == PARTITION:
            self._simulation.network.cut.add(process.token)
            self._simulation.clock.schedule(fault.for_s, self._heal, process.token)
            if fault.number:  # its keeper is cut off as well: that it is not heard of is all there is
                self._simulation.clock.schedule(UNHEARD_S, self._miss, process)

    def _miss(self, process: SimProcess) -> None:
        if process.alive and process.token in self._simulation.network.cut and not process.is_world:
            self._simulation.keepers.tell_owner(Lost(process.name, process.token, restarts=True))

    def _heal(self, token: str) -> None:
        self._simulation.trace(f"{token} is joined again")
        self._simulation.network.cut.discard(token)
        self._simulation.network.open_links()
