"""Production members in simulated processes; the checker looks at what they are told and what they say."""

from __future__ import annotations

from collections.abc import Mapping

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.execution.checkpoints import Checkpoints
from hierax.runtime.execution.member import Member, Seat
from hierax.runtime.execution.pacemaker import Pacemaker
from hierax.runtime.execution.world_member import OnUncertainAct, Supervision, WorldMember, has_record, read_record
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.sim.network import SimPort
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.process import SimProcess, Surroundings
from hierax.schemas.control import Census, Control, Prepare
from hierax.schemas.roster import Roster


def occupy(around: Surroundings, process: SimProcess, supervision: Supervision) -> None:
    """Have a process run what it runs in production."""
    if process.is_world:
        process.world = SimWorld(around, process, supervision)
    else:
        seat = Seat(process.name, process.token, process.wire, SimPort(around.network, process))
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

    def tick(self) -> None:
        """Time has passed."""
        if self._running is not None:
            self._running.tick()

    def link(self) -> None:
        """Open the links of the roster at the beginning."""
        roster = self._around.scenario.roster
        above = tuple(sorted(edge.upper for edge in roster.edges if edge.lower == self._process.name))
        self._port.link((), above, roster.version, roster.instances, lambda _: None)

    def _begin(self, living: Mapping[str, str]) -> None:
        """Begin the run, or go on with it, with these processes."""
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
        )
        pacemaker = Pacemaker(DigestChain(scenario.roster.content_hash()), scenario.epochs, process.publish, clock)
        seat = Seat(process.name, process.token, process.wire, self._port)
        own = (seat, process.send_order, self._supervision, slots)
        uncertain: OnUncertainAct = "repeat" if scenario.on_uncertain_act == "repeat" else "skip"
        return WorldMember(*own, pacemaker, policy, clock, living, roster, on_uncertain_act=uncertain)
