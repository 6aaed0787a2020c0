"""Processes that are lost, and nodes that do not come back."""

from dataclasses import replace

from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.runtime.owner.effects import DETACH
from hierax.runtime.owner.members import Request, Trial
from hierax.runtime.owner.planning import Planning
from hierax.runtime.owner.roster_changes import Undo
from hierax.schemas.control import Failed, Lost
from hierax.schemas.roster import Detach, Roster


class Losses(OwnerPart):
    """Takes in who is lost, and does what the deployment says of it."""

    def __init__(self, context: OwnerContext, planning: Planning) -> None:
        super().__init__(context)
        self.planning = planning  # what is done about it

    def hear(self, word: Lost) -> None:
        """A supervisor says that a process is gone for good; where it names none, that no other comes for a node."""
        name, process = word.name, word.process
        if not process:
            if self._stays_away(name):
                self._give_up(name, "its process is lost and is not started again")
            return
        refusal = self.members.died(name, process)
        self._on_lost(name, process, word.restarts)
        if refusal and self._stays_away(name):
            self._give_up(name, refusal)

    def fail(self, word: Failed) -> None:
        """What a node that fails alone has raised; it is said again until the epoch is done again without the node."""
        members = self.members
        if word.version != members.roster.version or members.processes.get(word.name) != word.process:
            return
        told = tuple(word.subject.split("->"))
        if word.name not in told or (len(told) > 1 and told not in members.roster.pairs):
            return
        trial = members.trial
        alone = members.alone if trial is None else members.alone | {trial.name}
        ends = [name for name in told if name in alone and name in members.roster.nodes]
        if not ends:
            return  # under one version, processes are told the same of who fails alone: this is not from one of them
        name = max(ends, key=lambda end: members.born[end][0])  # of two, what came last has brought the edge
        if name in members.failures:
            return
        if trial is not None and trial.name == name:
            self._undo(name, trial.before, word.why)
            return
        members.failures[name] = word.why
        if name not in members.lost:
            members.lose(name)
            self.planning.redo()
        self._effects.note(f"{word.why}; {name} is detached (on_loss)")
        self.planning.ask(Request("", Detach(name, cascade=True), self._clock()))

    def _undo(self, name: str, before: Roster, why: str) -> None:
        """What replaces another node has failed in its first epoch."""
        self.members.failures[name] = why
        self._effects.note(f"{why}; what {name} has replaced goes on")
        self.planning.redo()
        self.planning.ask(Request("", Undo(name, before), self._clock()))

    def tick(self) -> None:
        now = self._clock()
        for (name, process), since in list(self.members.ended.items()):
            if now - since > self._policy.answer_timeout_s:  # its supervisor is cut off as well
                del self.members.ended[name, process]
                self._on_lost(name, process, restarts=True)
        for name in list(self.members.lost):
            self._give_up_late(name)

    def _give_up_late(self, name: str) -> None:
        if self.members.is_late(name):
            self._give_up(name, "it did not come back in time (rejoin_timeout)")

    def _stays_away(self, name: str) -> bool:
        return name in self.members.lost and not self.members.comes_back(name)

    def _on_lost(self, name: str, process: str, restarts: bool) -> None:
        members, planning = self.members, self.planning
        trial = members.trial
        others = (members.processes.get(name), *members.newcomers.values())
        if trial is not None and trial.name == name and process not in others:
            self._on_replaced_lost(trial, process, restarts)
        for (other, key), newcomer in list(members.newcomers.items()):
            if newcomer == process:
                del members.newcomers[other, key]
                self._on_newcomer_lost(key, name)
                self._give_up_late(other)  # at once: the next one may be here before the next tick, again and again
        if members.processes.get(name) != process:
            plan = planning.plan
            if plan is not None and plan.processes.get(name) == process:
                planning.redo()
                planning.go_on()
            return
        if name not in members.lost:
            self._effects.note(f"{name}: its process is lost in epoch {self.progress.under_way}")
            members.lose(name)
            planning.redo()
        if not restarts:
            self._give_up(name, "its process is lost and is not started again")
        planning.reconsider()

    def _on_replaced_lost(self, trial: Trial, process: str, restarts: bool) -> None:
        """A process of what was replaced has died, which waits until what replaces it has done an epoch."""
        if process == trial.process:
            trial = replace(trial, process="", came_back=False)
        if not trial.process and not restarts:
            trial = replace(trial, gone="its process is lost and is not started again")
        self.members.trial = trial

    def _on_newcomer_lost(self, key: str, name: str) -> None:
        planning = self.planning
        if planning.plan is not None and planning.plan.is_for(name, key):
            planning.redo()
        request = planning.queued(key)
        if request is not None:
            planning.withdraw(request, f"the process of {name} died")
        planning.go_on()

    def _give_up(self, name: str, why: str) -> None:
        if not self.members.give_up(name):
            return
        if self.members.policy(name) == DETACH and name != self.members.roster.world:
            self._effects.note(f"{name}: {why}; it is detached (on_loss)")
            self.planning.ask(Request("", Detach(name, cascade=True), self._clock()))
        else:
            self._effects.stop(f"{name}: {why}")
