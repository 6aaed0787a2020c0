"""Processes that offer to run a node, or ask whether they still do."""

from __future__ import annotations

from dataclasses import replace

from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.runtime.owner.members import UNDONE
from hierax.runtime.owner.plan import Born, Request
from hierax.runtime.owner.planning import Planning
from hierax.runtime.owner.suspicions import Suspicions
from hierax.schemas.changes import Attach
from hierax.schemas.control import NEVER, Dismiss, Join


class Arrivals(OwnerPart):
    """Says who may come in."""

    def __init__(self, context: OwnerContext, planning: Planning, suspicions: Suspicions) -> None:
        super().__init__(context)
        self.planning = planning  # what is done about those who may
        self._suspicions = suspicions  # of what those who take part say

    def hear(self, word: Join) -> None:
        """A process is there."""
        name, process = word.name, word.process
        members = self.members
        if self._runs_another(name, process):
            return  # somebody says it who is not that process: a dismissal would be of one that has a place
        if members.is_dead(process) and not word.active:
            back = name in members.lost and (not word.request or process == members.processes.get(name))
            self._effects.send_order(process, Dismiss(f"{name}: it was cut off, and taken for lost", again=back))
            return  # where it is dead, nobody hears that
        if word.active:
            self._on_active(word)
            return
        if process in self._processes_of(name):
            return  # said twice
        if word.epoch != NEVER and members.was_undone(name, word.version):
            self._effects.send_order(process, Dismiss(f"{name}: {UNDONE}"))
            return
        request = self.planning.queued(word.request)
        plan = self.planning.plan
        if request is not None:
            self._on_newcomer(word, request)
        elif plan is not None and plan.request is not None and plan.request.key == word.request:
            return
        elif word.request or name not in members.roster.nodes:
            self._effects.send_order(process, Dismiss(f"{name}: nobody asks for it (any more)"))
        elif word.epoch != NEVER and word.version < members.born[name][0]:
            self._on_replaced(word)
        elif name in members.lost:
            self._on_back(word)

    def judge_again(self) -> None:
        """An epoch was committed, as lost processes had done their part: those in their place may be behind."""
        for (name, key), process in list(self.members.newcomers.items()):
            saved = self.members.saved(process)
            why = "" if key or saved is None else self._unsound(self.members.born[name], *saved)
            if why:
                del self.members.newcomers[name, key]
                plan = self.planning.plan
                if plan is not None and name in plan.back:
                    self.planning.redo(plan)
                self.members.send_away(name, process, why)

    def _on_back(self, word: Join) -> None:
        name, process = word.name, word.process
        members = self.members
        if members.comes_back(name):
            return
        why = word.refusal or self._unsound(members.born[name], word.epoch, word.attempt)
        version = members.roster.version
        if word.version > version:  # the world's record was damaged, and what it falls back to is too old
            why = f"it was in version {word.version} of the roster, and the hierarchy is in {version}"
        if why:
            members.send_away(name, process, why)
            return
        members.come_back(name, process, word.epoch, word.attempt)
        self.planning.reconsider()

    def _on_replaced(self, word: Join) -> None:
        """A process in the place of one that was replaced and has died."""
        name, process = word.name, word.process
        trial = self.members.trial
        if trial is None or trial.name != name:
            self._effects.send_order(process, Dismiss(f"{name}: another node has taken its place"))
        elif not trial.process:
            why = word.refusal or self._unsound(trial.born, word.epoch, word.attempt)
            if why:
                self._effects.send_order(process, Dismiss(why))
                self.members.trial = replace(trial, gone=why)
            else:
                self.members.trial = replace(trial, process=process, came_back=True, gone="")
            self.planning.reconsider()

    def _unsound(self, born: Born, epoch: int, attempt: int) -> str:
        """Why a process with a checkpoint of this attempt of an epoch cannot go on; its node was born so."""
        last, last_attempt = self.progress.epoch, self.progress.last_attempt
        if epoch == NEVER and last >= born[1]:
            return f"it has no checkpoint, and its node has taken part in epoch {last}"
        if self._policy.overlaps and epoch <= last:
            return ""  # where epochs overlap a node may be behind
        has_part = born[1] <= last  # else it holds the state that it came with, of no attempt
        if epoch == last and attempt != last_attempt and has_part:
            why = f"its checkpoint is of attempt {attempt} of epoch {epoch}, and attempt {last_attempt} counts"
            forged = ", the last one: somebody else has sent it observations, or the world's record was damaged"
            return why + forged if attempt > last_attempt else why
        if epoch in (NEVER, last, last + 1):
            return ""
        return f"its checkpoint is of epoch {epoch}, and the hierarchy is in epoch {last + 1}"

    def _on_newcomer(self, word: Join, request: Request) -> None:
        newcomers = self.members.newcomers
        if word.refusal:
            self.planning.withdraw(request, word.refusal)
        elif word.epoch != NEVER and isinstance(request.change, Attach):
            self._effects.send_order(
                word.process, Dismiss("it has a checkpoint, and a node that is attached begins anew")
            )
        elif (word.name, word.request) not in newcomers:
            newcomers[word.name, word.request] = word.process
            self.planning.reconsider()

    def _on_active(self, word: Join) -> None:
        """A process that has taken part asks whether it still may."""
        name, process = word.name, word.process
        members = self.members
        known = self._processes_of(name)
        in_force = members.processes.get(name)
        if name in members.lost and members.is_dead(process):  # it was cut off, and no supervisor here can kill it
            why = f"{name}: it was cut off, and taken for lost in epoch {self.progress.epoch + 1}"
            self._effects.send_order(process, Dismiss(why, again=True))
        elif name in members.lost and (process not in known or process == in_force):
            members.end(name, process, "it was taken for lost")  # its supervisor starts it anew, from its checkpoint
        elif process not in known:
            instead = "it is no part of the hierarchy" if in_force is None else "another process runs it"
            self._effects.send_order(process, Dismiss(f"{name}: {instead}"))
        elif process == in_force and (self._suspicions.is_ahead(word) or self._suspicions.is_astray(word)):
            self._suspicions.hear(word)

    def _runs_another(self, name: str, process: str) -> bool:
        """Whether a process is counted on for another node than it says."""
        return any(token == process and other != name for other, token in self._counted_on())

    def _processes_of(self, name: str) -> list[str]:
        return [token for other, token in self._counted_on() if other == name]

    def _counted_on(self) -> list[tuple[str, str]]:
        """All nodes and processes that there are, or are to be."""
        plan, trial = self.planning.plan, self.members.trial
        return [
            *([(trial.name, trial.process)] if trial is not None and trial.process else []),
            *((name, process) for (name, _), process in self.members.newcomers.items()),
            *self.members.processes.items(),
            *(() if plan is None else plan.processes.items()),
        ]
