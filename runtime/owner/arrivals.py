"""Processes that offer to run a node, or ask whether they still do; and nodes that are further than the world.

Only the world begins epochs and attempts, so no node can be ahead of it. One that says that it is, is asked whether
that is so: anybody may have said it in its name, or have sent it observations in the name of a node below."""

from dataclasses import replace

from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.runtime.owner.members import UNDONE, Born, Request
from hierax.runtime.owner.planning import Planning
from hierax.schemas.control import NEVER, AskStatus, Dismiss, Join, Status
from hierax.schemas.roster import Attach

FIRST_INQUIRY = 1 << 40  # the numbers of these inquiries are no others' numbers
MAX_REPEATS = 100  # how often an epoch is begun again because a node was moved on; then the run ends


class Suspicions(OwnerPart):
    """Has an epoch begun again whose attempt a node has left; ends the run where that does not help."""

    def __init__(self, context: OwnerContext) -> None:
        super().__init__(context)
        self._number = FIRST_INQUIRY
        self._asked: dict[str, int] = {}
        self._lies: dict[str, int] = {}
        self._epoch = 0
        self._repeats = 0

    def is_ahead(self, said: Join | Status) -> bool:
        """Whether a node that has a place says that it is further than the world has begun."""
        place, begun = (said.epoch, said.attempt), (self.progress.epoch + 1, self.progress.attempt)
        version = self.members.roster.version
        if said.version < version:  # that attempt was begun under another version, if it was
            return place >= begun
        return said.version > version or place > begun

    def is_astray(self, said: Join | Status) -> bool:
        """Whether a node that has a place says that it is in an attempt of the last epoch after the committed one.

        Nobody else will ever be in that attempt."""
        return said.epoch == self.progress.epoch and said.attempt > self.progress.last_attempt

    def hear(self, word: Join) -> None:
        """A node says that it is where nobody else is: ask it."""
        self._number += 1
        self._asked[word.name] = self._number
        self._effects.send_order(word.process, AskStatus(self._number))

    def answer(self, status: Status) -> None:
        if status.inquiry < FIRST_INQUIRY or self._asked.get(status.name) != status.inquiry:
            return
        del self._asked[status.name]
        if self.is_astray(status):
            self._bring_back(status)
            return
        if not self.is_ahead(status):
            self._report_lie(status.name)
            return
        progress = self.progress
        where = f"epoch {status.epoch}, attempt {status.attempt}, roster version {status.version}"
        lowers = " or ".join(self.members.roster.below(status.name))
        who = f"somebody else has sent it observations in the name of {lowers}"
        what = f"{status.name} is in {where}, which the world has not begun: {who}"
        if status.version > self.members.roster.version or status.epoch != progress.epoch + 1:
            self._effects.stop(f"{what}, or the world's record was damaged; the world is in epoch {progress.epoch + 1}")
            return
        self._repeats = self._repeats + 1 if self._epoch == status.epoch else 1
        self._epoch = status.epoch
        if self._repeats > MAX_REPEATS:
            self._effects.stop(f"{what}, and {MAX_REPEATS} times before")
            return
        progress.attempt = max(progress.attempt, status.attempt)  # the next one is after it
        if progress.running and not self.members.lost:
            self._effects.note(f"{what}; the epoch is begun again")
            progress.begin()

    def _bring_back(self, status: Status) -> None:
        """A node waits in vain; its checkpoint is of the committed attempt, or the epoch would not have ended."""
        if status.waits_for and not status.busy:
            where = f"attempt {status.attempt} of epoch {status.epoch}"
            why = f"it waits in {where}, and attempt {self.progress.last_attempt} counts"
            self.members.end(status.name, self.members.processes[status.name], why)

    def _report_lie(self, name: str) -> None:
        """The first time, the second, the fourth, the eighth, …: it may be said any number of times."""
        count = self._lies[name] = self._lies.get(name, 0) + 1
        if count & (count - 1) == 0:
            times = "" if count == 1 else f" ({count} times)"
            self._effects.note(
                f"{name}: somebody has said in its name that it is further than the world; it is not{times}"
            )


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
            back = self._is_awaited(name) and (not word.request or process == members.processes.get(name))
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
        elif word.request and not self._answers.knows(word.request):
            return  # what it was started for is yet on its way here; it offers itself again
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
                    self.planning.redo()
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
        rates = self.members.roster.rates
        changed = 0 if rates is None else rates.latest  # the epoch before was drained, so all have written it down
        if self._policy.rated and born[1] < changed and epoch < changed - 1:
            return f"its checkpoint is of epoch {epoch}, and rates have changed since, with epoch {changed}"
        if epoch == NEVER and last >= born[1] and not self._policy.rated:
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
        if self._is_awaited(name) and members.is_dead(process):  # it was cut off, and no supervisor here can kill it
            why = f"{name}: it was cut off, and taken for lost in epoch {self.progress.under_way}"
            self._effects.send_order(process, Dismiss(why, again=True))
        elif name in members.lost and (process not in known or process == in_force):
            members.end(name, process, "it was taken for lost")  # its supervisor starts it anew, from its checkpoint
        elif process not in known:
            instead = "it is no part of the hierarchy" if in_force is None else "another process runs it"
            self._effects.send_order(process, Dismiss(f"{name}: {instead}"))
        elif self._has_had_part(name, process) and (
            self._suspicions.is_ahead(word) or self._suspicions.is_astray(word)
        ):
            self._suspicions.hear(word)

    def _is_awaited(self, name: str) -> bool:
        """Whether a process is to come for a node, or for what it has replaced."""
        trial = self.members.trial
        return name in self.members.lost or (trial is not None and trial.name == name and not trial.process)

    def _has_had_part(self, name: str, process: str) -> bool:
        """Whether a process runs a node, or has run it until it was replaced: a lost record may have undone that."""
        trial = self.members.trial
        replaced = trial is not None and (trial.name, trial.process) == (name, process)
        return replaced or process == self.members.processes.get(name)

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
