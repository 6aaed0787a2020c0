"""Who keeps simulated processes: starts them, notices their deaths, and tells the owner."""

from __future__ import annotations

from collections import Counter
from random import Random
from typing import TYPE_CHECKING

from hierax.runtime.sim.members import SimWorldMember, make_member
from hierax.runtime.sim.process import TICK_S, SimProcess
from hierax.runtime.sim.storage import SimStorage
from hierax.schemas.control import Control, Lost

if TYPE_CHECKING:
    from hierax.runtime.sim.simulation import Simulation

NOTICE_S, RESTART_S = 0.02, 0.05
"""At most, until a death is noticed, and until another process is there."""


class Keepers:
    """Of all processes.

    Args:
        simulation: of which they are.
        rng: of all that takes its time.

    Attributes:
        processes: that live, by token.
        final: nodes of which a process has gone, and none comes in its place.
    """

    def __init__(self, simulation: Simulation, rng: Random) -> None:
        self.processes: dict[str, SimProcess] = {}
        self.final: set[str] = set()
        self._simulation = simulation
        self._rng = rng
        self._started: Counter[str] = Counter()

    def start(self, name: str, request: str, storage: SimStorage) -> SimProcess:
        """A process of a node comes up; for a request, or in the place of another one, with the storage of that."""
        self._started[name] += 1
        token = f"{name}.{self._started[name]}"
        process = SimProcess(self._simulation, name, token, request, storage)
        self.processes[token] = process
        process.member = make_member(self._simulation, process)
        self._simulation.clock.schedule(self._rng.uniform(0.0, TICK_S), self._tick, process)
        self._simulation.trace(f"{token} starts" + (f" for {request}" if request else ""))
        return process

    def _tick(self, process: SimProcess) -> None:
        if process.alive:
            process.take("tick", None)
            self._simulation.clock.schedule(TICK_S, self._tick, process)

    def died(self, process: SimProcess) -> None:
        """A process is dead; its keeper finds out and starts another one."""
        self.final.discard(process.name)
        self._simulation.trace(f"{process.token} dies at {process.at!r}")
        if not self._gone(process):
            return
        if process.is_world and isinstance(process.member, SimWorldMember) and process.member.acting:
            self._simulation.checker.uncertain.add(process.member.acting)
        self._simulation.clock.schedule(self._rng.uniform(0.0, NOTICE_S), self._notice, process)

    def exited(self, process: SimProcess) -> None:
        """A process was dismissed: it is not started again."""
        self._gone(process)
        self.tell_owner(Lost(process.name, process.token, restarts=False))
        if not process.request or self._simulation.checker.had_place(process.token):
            self.final.add(process.name)

    def _gone(self, process: SimProcess) -> bool:
        was = process.alive
        process.alive = False
        self.processes.pop(process.token, None)
        return was

    def _notice(self, process: SimProcess) -> None:
        self._simulation.trace(f"keeper: {process.token} is dead")
        restarts = process.name not in self._simulation.scenario.left_dead
        self.tell_owner(Lost(process.name, process.token, restarts))
        if not restarts:
            self.final.add(process.name)
            return
        self._simulation.clock.schedule(self._rng.uniform(0.0, RESTART_S), self._restart, process)

    def tell_owner(self, word: Control) -> None:
        """What keepers say is not lost while the world's process lives, and is on their list when it doesn't."""
        world = self._simulation.world
        if world is not None:
            self._simulation.clock.schedule(0.0, world.take, "word", word)

    def _restart(self, process: SimProcess) -> None:
        """Start another process, unless that one never had a place in the roster: then who asked for it knows."""
        if process.request and not self._simulation.checker.had_place(process.token):
            return
        again = self.start(process.name, "", process.storage)
        if again.is_world:
            self._simulation.begin(again)

    def kill(self, token: str, why: str) -> None:
        """A keeper ends a process, when it can reach it."""
        process = self.processes.get(token)
        if process is None:  # it was told before, but that may have been to another owner
            name = token.rpartition(".")[0]
            self.tell_owner(Lost(name, token, name not in self._simulation.scenario.left_dead))
            return
        if token in self._simulation.network.cut:
            self._simulation.clock.schedule(0.1, self.kill, token, why)
            return
        process.at = f"killed: {why}"
        self.died(process)
