"""What the world's process says to its supervisor while the run goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch.frames import NodeOrder
from hierax.runtime.launch.steady import SteadyClock
from hierax.runtime.launch.supervisor_pipe import SupervisorPipe

BEAT_S = 0.2  # how often the world's process says that it lives


@dataclass
class WorldWatch:
    """Says that the world's process lives and whom the roster names; and when it hangs, as nobody else watches that."""

    order: NodeOrder  # of the process
    pipe: SupervisorPipe  # to its supervisor
    world: WorldMember  # its member
    busy: Callable[[], str]  # the operator that the node's thread is in; empty: in none
    _clock: SteadyClock = field(default_factory=SteadyClock)
    _beaten_s: float = 0.0
    _version: int = -1
    _stuck: tuple[int, str] = (0, "")
    _stuck_s: float = 0.0

    def tick(self, now_s: float) -> None:
        """Time has passed; called by another thread than the node's."""
        owner = self.world.owner
        if now_s - self._beaten_s >= BEAT_S:
            self._beaten_s = now_s
            self.pipe.beat(owner)
        state, steady_s = (owner.epoch, self.busy()), self._clock()
        if not state[1] or state != self._stuck:
            self._stuck, self._stuck_s = state, steady_s
            return
        deadline_s = None if self.order.owner is None else self.order.owner.epoch_deadline_s
        if deadline_s is not None and steady_s - self._stuck_s > deadline_s:
            self._stuck_s = steady_s
            why = f"it is in {state[1]} in epoch {state[0] + 1}, past the deadline"
            self.pipe.end(self.order.name, self.order.process, why)

    def serve(self) -> bool:
        """Between two messages, called by the node's thread: say what has come of the last one; whether it waits."""
        world, owner = self.world, self.world.owner
        if owner.roster.version != self._version:
            self._version = owner.roster.version
            self.pipe.beat(owner)
        if world.pacemaker.asked:
            world.end_soon()
        if world.pacemaker.done:
            self.pipe.finish(owner)
        if world.paused:
            world.resume()
        return world.paused
