"""Production members in simulated processes; the checker looks at what they are told and what they say."""

from __future__ import annotations

from typing import Any

from hierax.runtime.core.digest import DigestChain
from hierax.runtime.engine.effects import Committed
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.runner import Pacemaker
from hierax.runtime.execution.world_member import Supervision, WorldMember, has_record, read_record
from hierax.runtime.owner.effects import OwnerPolicy
from hierax.runtime.recovery.slots import Slots
from hierax.runtime.sim.inspection import Turn
from hierax.runtime.sim.network import SimPort
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.process import SimProcess, Surroundings
from hierax.schemas.control import Census, Control, Prepare


def make_member(around: Surroundings, process: SimProcess, keeper: Supervision) -> Member:
    """What runs in a process."""
    port = SimPort(around.network, process)
    slots = Slots(process.storage)
    if not process.is_world:
        return Member(process.name, process.token, process.wire, port, process.say, slots)
    scenario = around.scenario
    chain = DigestChain(scenario.roster.content_hash())
    settings = OwnerPolicy(
        modules=(MODULE,),
        on_loss=scenario.on_loss,
        rejoin_timeout_s=scenario.rejoin_timeout_s,
        alone=scenario.alone,
        epoch_deadline_s=scenario.epoch_deadline_s,
        start_timeout_s=2.0,
        answer_timeout_s=0.8,
    )
    return SimWorldMember(
        around,
        process,
        process.name,
        process.token,
        process.wire,
        port,
        process.tell,
        keeper,
        slots,
        Pacemaker(chain, scenario.epochs, process.publish, around.clock),
        settings,
        around.clock,
        on_uncertain_act="repeat" if scenario.on_uncertain_act == "repeat" else "skip",
    )


def link_first(around: Surroundings, process: SimProcess) -> None:
    """Have a process open its links before the run begins."""
    if isinstance(process.member, SimWorldMember):
        process.member.link()
    else:
        process.member.obey(Prepare(around.scenario.roster.plain(), around.scenario.alone))


class SimWorldMember(WorldMember):
    """The world's member; the checker looks at what it is told and what it says.

    Attributes:
        acting: the epoch of the act under way; 0: there is none.
    """

    def __init__(self, around: Surroundings, sim_process: SimProcess, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._around = around
        self._sim_process = sim_process
        self._began = False
        self.acting = 0

    def take_word(self, word: Control) -> None:
        if isinstance(word, Census):
            self._began = True
            self._begin(word.processes)
        elif self._began:  # nobody hears anything before
            super().take_word(word)

    def tick(self) -> None:
        if self._began:
            super().tick()

    def link(self) -> None:
        """Open the links of the roster at the beginning."""
        roster = self._around.scenario.roster
        above = tuple(sorted(edge.upper for edge in roster.edges if edge.lower == self.name))
        self.port.link((), above, roster.version, roster.instances, self.linked)

    def _begin(self, living: dict[str, str]) -> None:
        """Begin the run, or go on with it, with these processes."""
        scenario, checker = self._around.scenario, self._around.checker
        slots = Slots(self._sim_process.storage)
        if has_record(slots):
            record, _ = read_record(slots)
            checker.resumes(record.epoch, record.last_digest)
            if any(read.fault for read in slots.read()):
                checker.uncertain.update((record.epoch, record.epoch + 1))
            self.resume_run(living)
            return
        if self.process != f"{self.name}.1" and scenario.together:
            self.link()
        first = [f"{name}.1" for name in scenario.roster.nodes] if scenario.together else []
        here = {token.rpartition(".")[0]: token for token in first if token in living}
        self.begin_run(scenario.roster, {**here, self.name: self.process})

    def begin(self, epoch: int, attempt: int, version: int) -> None:
        turn = Turn(version, epoch, attempt)
        base = self.engine.wiring.roster
        owner = self.owner
        self._around.journal.trace(f"owner begins {turn}")
        self._around.checker.begins(base, turn, owner.roster, owner.processes)
        self._sim_process.inspector.begin(turn)
        super().begin(epoch, attempt, version)

    def act(self, epoch: int, actions: Any) -> None:
        self.acting = epoch
        super().act(epoch, actions)
        self.acting = 0

    def committed(self, committed: Committed) -> None:
        turn = self._sim_process.inspector.turn
        self._around.checker.commits(turn, self._around.states(turn))
        self._sim_process.point("commit")
        super().committed(committed)
