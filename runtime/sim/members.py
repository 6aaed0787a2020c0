"""Production members in simulated processes; the checker looks at what they are told and what they say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.engine.effects import Committed
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.runner import Pacemaker
from hierax.runtime.execution.world_member import Supervision, WorldMember
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.network import SimPort
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.process import SimProcess

if TYPE_CHECKING:
    from hierax.runtime.sim.simulation import Simulation


def make_member(simulation: Simulation, process: SimProcess) -> Member:
    """What runs in a process."""
    port = SimPort(simulation.network, process)
    if process.is_world:
        return _world_member(simulation, process, port)
    return Member(
        process.name,
        process.token,
        process.wire,
        port,
        lambda word: simulation.say(process, word),
        Slots(process.storage),
    )


def _world_member(simulation: Simulation, process: SimProcess, port: SimPort) -> SimWorldMember:
    scenario = simulation.scenario
    pacemaker = Pacemaker(
        DigestChain(scenario.roster.content_hash()),
        scenario.epochs,
        lambda epoch, digest: simulation.publish(process, epoch, digest),
        simulation.clock,
    )
    settings = OwnerPolicy(
        modules=(MODULE,),
        on_loss=scenario.on_loss,
        rejoin_timeout_s=scenario.rejoin_timeout_s,
        epoch_deadline_s=scenario.epoch_deadline_s,
        start_timeout_s=2.0,
        answer_timeout_s=0.8,
    )
    return SimWorldMember(
        simulation,
        process,
        process.name,
        process.token,
        process.wire,
        port,
        lambda token, order: simulation.tell(process, token, order),
        simulation.keeper,
        Slots(process.storage),
        pacemaker,
        settings,
        simulation.clock,
        on_uncertain_act="repeat" if scenario.on_uncertain_act == "repeat" else "skip",
    )


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


class SimSupervision(Supervision):
    """Of all processes."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def end(self, name: str, process: str, why: str) -> None:
        simulation = self._simulation
        simulation.trace(f"owner ends {process}: {why}")
        simulation.clock.schedule(0.01, simulation.keepers.kill, process, why)

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
