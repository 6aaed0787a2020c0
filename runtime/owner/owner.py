"""The owner of the roster: decides which version an epoch runs under, and when one is done again."""

from collections.abc import Callable, Iterable, Mapping
from math import inf

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.loading.allowance import Allowance, NotAllowedError, Refusals
from hierax.runtime.owner.arrivals import Arrivals, Suspicions
from hierax.runtime.owner.context import OVER, Answers, EpochProgress, OwnerContext, OwnerPart
from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.ending import Ending
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.losses import Losses
from hierax.runtime.owner.members import Born, Members, Request, Stage, Tried
from hierax.runtime.owner.planning import MAX_TRIES, Planning
from hierax.runtime.owner.roster_changes import apply
from hierax.schemas import control
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Roster, read_change

FETCH_S = 0.02  # how often a process is told the roster at most, when it asks for it

__all__ = ["MAX_TRIES", "OVER", "Owner"]


class Owner(OwnerPart):
    """Owns the roster of a run; lives beside the world's engine."""

    def __init__(
        self,
        roster: Roster,  # in force
        processes: Mapping[str, str],  # of its nodes; one without is lost
        effects: OwnerEffects,  # called with all that is to be done
        clock: Callable[[], float],  # seconds, never going back
        policy: OwnerPolicy,  # what the deployment says
        *,
        epoch: int = 0,  # the last one committed
        attempt: int = control.NEVER,  # the last one of the epoch after that; NEVER: none was begun
        highest: int = 0,  # the highest version that was ever prepared
        # By node, the version with which it came in, the first epoch that it took part in, and the request of it; None:
        # all were there at the beginning.
        born: Mapping[str, Born] | None = None,
        settled: bool = False,  # the epoch after that may have been acted upon, so it is done again with the same nodes
        last_attempt: int = 0,  # the one of the last epoch committed that was
        tried: Tried | None = None,  # as `Members` has it
        alone: Iterable[str] | None = None,  # likewise
        drains: bool = False,  # whether the epoch after the last one committed was begun as a drained one
    ) -> None:
        members = Members(roster, processes, born, effects, clock, policy, tried, alone)
        self._inquiry = Inquiry(effects, clock, policy, members)
        counts = {"epoch": epoch, "attempt": attempt, "last_attempt": last_attempt}
        progress = EpochProgress(members, self._inquiry, effects, **counts, settled=settled, drains=drains)
        context = OwnerContext(effects, clock, policy, members, progress, Answers(members, effects))
        super().__init__(context)
        self.planning = Planning(context, self.proceed, highest)
        self._suspicions = Suspicions(context)
        self._arrivals = Arrivals(context, self.planning, self._suspicions)
        self._losses = Losses(context, self.planning)
        self._ending = Ending(context)
        self._refusals = Refusals()
        self._told_s: dict[str, float] = {}

    def take_back(self, process: str) -> None:
        """Come back as a new process of the world's; the epoch is begun again once its neighbours are ready."""
        world = self.members.roster.world
        self.members.lose(world)
        self.members.newcomers[world, ""] = process
        self.planning.reconsider()

    def proceed(self) -> None:
        """The world may begin the next epoch."""
        progress = self.progress
        if progress.running or progress.held or progress.last:
            return
        plan = self.planning.plan
        if not self.members.lost:
            ready = plan is not None and plan.stage is Stage.READY
            if plan is not None and ready and (progress.drained or not self._policy.overlaps):
                self.planning.take_effect(plan)
            elif plan is None or ready or plan.stage is Stage.PREPARE:
                progress.drains = ready
                progress.begin()
        elif self._policy.rated and self.members.roster.world not in self.members.lost:
            progress.begin()  # the world itself waits for who is lost, if it needs it
        if not progress.running:
            self._effects.write_record()  # nobody hears of a commit that a crash could undo
        self.members.dismiss_outlived()
        self._answers.report(progress.epoch)

    def committed(self, epoch: int) -> None:
        """An epoch is committed; `proceed` or `finish` follows."""
        self.progress.committed(epoch)
        self.planning.end_trial()
        if self.members.lost:
            self._arrivals.judge_again()
        if self.planning.queue:
            self.planning.reconsider()

    def finish(self, drained: bool) -> None:
        """The last epoch is committed and recorded: what is still asked for comes too late.

        With rates, and where that was no drained epoch, nodes may be behind; the run is over when all have said that
        they are done, and those that are lost meanwhile have come back."""
        if self.progress.last:
            return
        self.progress.last = True
        self.members.dismiss_outlived()
        self._answers.report(self.progress.epoch)
        self.planning.finish(OVER)
        if drained or not self._policy.rated:
            self.progress.over = True
        else:
            self._ending.begin()
            self.planning.reconsider()

    def hear(self, word: control.Control) -> None:
        """Take in what a process, a supervisor or a user says."""
        if isinstance(word, (control.Join, control.Ready, control.Fetch)):
            self.members.hear(word.process)
        if self.progress.last and isinstance(word, control.Propose):
            self._answer_late(word.request)
        elif self.progress.over:
            return
        elif isinstance(word, (control.Ready, control.State, control.Taken)):
            self.planning.hear(word)
        elif isinstance(word, control.Join):
            self._arrivals.hear(word)
        elif isinstance(word, control.Lost):
            self._losses.hear(word)
        elif isinstance(word, control.Failed):
            self._losses.fail(word)
        elif isinstance(word, control.Fetch):
            self._on_fetch(word)
        elif isinstance(word, control.Status):
            self._inquiry.hear(word)
            self._suspicions.answer(word)
        elif isinstance(word, control.CaughtUp):
            self._ending.hear(word)
        elif isinstance(word, control.Propose):
            self._on_propose(word)

    def tick(self) -> None:
        if self.progress.over:
            return
        self._losses.tick()
        self.planning.tick()
        self.progress.tick()
        self._ending.tick()

    def _on_propose(self, word: control.Propose) -> None:
        key = word.request
        if self._answers.repeat(key):
            return
        if any(request.key == key for request in self.planning.asked) or self._answers.owes(key):
            return  # asked twice
        if self._answers.owe_what_was_made(key):
            return
        try:
            change = read_change(word.change)
            Allowance(self._policy.modules).check_all(change)
            apply(self.members.roster, change, self.planning.highest + 1)
        except (HieraxError, SchemaError) as error:
            if isinstance(error, NotAllowedError) and self._refusals.is_new(str(error)):
                self._effects.note(f"a change is refused: {error}")
            self._answers.give(key, 0, str(error))
            return
        self.planning.ask(Request(key, change, self._clock(), word.on_loss, word.rejoin_timeout_s, word.alone))

    def _answer_late(self, key: str) -> None:
        """The run is over; what is asked for may have been made before the world's last process died."""
        if self._answers.repeat(key):
            return
        if self._answers.owe_what_was_made(key):
            self._answers.report(self.progress.epoch)
        else:
            self._answers.give(key, 0, OVER)

    def _on_fetch(self, word: control.Fetch) -> None:
        """Only who has a place in a version is told of it: another process of that node would take part as well."""
        if word.version != self.members.roster.version or self.members.processes.get(word.name) != word.process:
            return
        now = self._clock()
        if now - self._told_s.get(word.name, -inf) >= FETCH_S:  # who asks more often is not the process
            self._told_s[word.name] = now
            alone, trial = tuple(sorted(self.members.alone)), self.members.trial
            tried = () if trial is None else (trial.name,)
            self._effects.send_order(word.process, control.Prepare(self.members.roster.plain(), alone, tried))
