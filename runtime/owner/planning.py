"""Changes and recoveries on their way: the queue, and the version of the roster that is prepared."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.engine.table import MAX_PREPARED
from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.runtime.owner.members import Plan, Request, Stage
from hierax.runtime.owner.roster_changes import Undo, apply, next_roster, removed, touched
from hierax.schemas.control import Dismiss, HandOver, Prepare, Ready, State, Taken, TakeOver, Unchanged
from hierax.schemas.roster import Detach, Replace, Roster

TELL_AGAIN_S = 0.1  # how often those that are waited for are told again
MAX_TRIES = 5  # how often a change is planned anew because a process died meanwhile
MAX_DROPPED = MAX_PREPARED // 2
"""How many versions may be dropped, one after the other: nodes keep them, and take `MAX_PREPARED` at most."""


class Planning(OwnerPart):
    """Makes one plan after the other, and has it take effect. `highest`: the highest version that was ever prepared."""

    def __init__(self, context: OwnerContext, proceed: Callable[[], None], highest: int) -> None:
        super().__init__(context)
        self.highest = max(highest, self.members.roster.version)  # the highest version ever prepared
        self.plan: Plan | None = None  # what is prepared; None: nothing
        self.queue: deque[Request] = deque()  # what is asked for, and is not in the plan
        self._proceed = proceed  # to be called when nothing is planned any more, as an epoch may wait for that
        self._states: dict[str, tuple[bytes, bytes]] = {}
        self._states_of = 0

    # --- what is asked for

    @property
    def asked(self) -> list[Request]:
        """All that is asked for, and neither done nor refused."""
        return [*self.queue, *(self.plan.requests if self.plan else [])]

    def queued(self, key: str) -> Request | None:
        """What is asked for under a key, as long as it is not in the plan."""
        return next((each for each in self.queue if key and each.key == key), None)

    def ask(self, request: Request) -> None:
        """Do this, too; what the owner itself asks for comes first."""
        if request.key:
            self.queue.append(request)
        else:
            self.queue.appendleft(request)
        self.reconsider()

    def withdraw(self, request: Request, why: str) -> None:
        self.queue.remove(request)
        self._refuse(request, why)

    def _refuse(self, request: Request, why: str) -> None:
        if request.key:
            self.members.turn_away(request.key, why)
            self._answers.give(request.key, 0, why)
        else:
            self._effects.stop(why)

    def finish(self, why: str) -> None:
        asked, self.plan = self.asked, None
        for request in asked:
            if request.key:
                self._refuse(request, why)
        self.queue.clear()

    def tick(self) -> None:
        now = self._clock()
        for request in list(self.queue):
            missing = self._missing(request)
            if now - request.since_s > self._policy.start_timeout_s and missing:
                self.withdraw(request, f"no process for {', '.join(missing)} came up in time (start_timeout_s)")
        if self.plan is not None:
            self._hurry(self.plan, now)

    def _missing(self, request: Request) -> list[str]:
        return self.members.missing(request.new_nodes, request.key)

    # --- from the queue to a plan

    def reconsider(self) -> None:
        """Prepare the next version, where there is something to do and nothing else under way."""
        if self.plan is not None:
            return
        back = self.members.back
        undo: list[Request | None] = [request for request in self.queue if isinstance(request.change, Undo)]
        recovers = self._policy.rated and self.members.lost  # a change needs a drained epoch
        asked = [] if recovers or self._renews else self.queue
        for request in undo or [*asked, None]:  # the epoch cannot be done as it is
            if request is not None and not self._can_be_tried(request):
                continue
            if self._try(request, back):
                return

    @property
    def _renews(self) -> bool:
        """Whether the roster in force needs a new number: with it, nodes forget those that were dropped before."""
        return not self.members.lost and self.highest - self.members.roster.version >= MAX_DROPPED

    def go_on(self) -> None:
        """A plan was given up: prepare what there is, or let the epoch begin that waited for it."""
        self.reconsider()
        if self.plan is None:
            self._proceed()

    def _can_be_tried(self, request: Request) -> bool:
        if self.progress.over or request not in self.queue:
            return False
        change = request.change
        lost = self.members.lost
        if isinstance(change, Undo):
            return self._can_be_undone(request, change.name)
        if not request.key and isinstance(change, Detach) and change.name not in lost:
            self.queue.remove(request)  # it is back, or detached already
            return False
        if request.key and self.progress.settled:
            return False
        if isinstance(change, Replace) and change.name in lost:
            return False  # its state is handed over, so it has to come back first
        if isinstance(change, Replace) and lost and self.progress.running:
            return False  # the epoch under way may be committed after all, with another state than was handed over
        return not self._missing(request)

    def _can_be_undone(self, request: Request, name: str) -> bool:
        """Whether what was replaced is there; where it has died, another process of it is waited for."""
        trial = self.members.trial
        if trial is None or trial.name != name:
            self.queue.remove(request)  # it is detached
            return False
        if trial.gone:
            why = self.members.failures.get(name, "")
            self._effects.stop(f"{why}; and what {name} has replaced cannot go on: {trial.gone}")
        return bool(trial.process)

    def _try(self, request: Request | None, back: set[str]) -> bool:
        """Make a plan of a change and the nodes that are back; whether that could be done now."""
        version = self.highest + 1
        undone = request.change.name if request is not None and isinstance(request.change, Undo) else ""
        roster, along = self.members.roster, tuple[Request, ...]()
        try:
            if request is not None and undone:  # first, as what was replaced may stand on others than what replaces it
                roster = apply(roster, request.change, version)
            roster, along = self._without_lost(roster, request, undone)
            if request is not None and not undone:
                roster = apply(roster, request.change, version)
        except HieraxError as error:
            if request is not None and not along:  # else it may be done already when those are
                self.withdraw(request, str(error))
            return False
        if request is not None and undone and undone not in roster.nodes:  # it goes with those that it stands on
            self.queue.remove(request)
            return self._try(None, back)
        back = back & roster.nodes.keys() - {undone}
        if (self.members.lost.keys() - back - {undone}) & roster.nodes.keys():
            return False  # others are lost and not back
        if not (request or along or back or self._renews):
            return False
        trial = self.members.trial
        anew = back | ({undone} if trial is not None and trial.name == undone and trial.came_back else set())
        instances = {**roster.instances, **dict.fromkeys(sorted(anew), version)}
        self._prepare(replace(roster, version=version, instances=instances), request, along, frozenset(back))
        return True

    def _without_lost(self, roster: Roster, request: Request | None, undone: str) -> tuple[Roster, tuple[Request, ...]]:
        """A roster without the lost nodes that are to be detached: one after the other, each would wait for all."""
        lost = self.members.lost
        along = []
        for each in () if self._policy.rated else self.queue:
            change = each.change
            if each is request or not isinstance(change, Detach) or (each.key and self.progress.settled):
                continue
            if change.name not in lost or change.name not in roster.nodes or change.name == undone:
                continue
            try:
                smaller = next_roster(roster, change)
            except HieraxError:
                continue  # it is refused when its own turn comes
            roster = replace(smaller, version=roster.version)
            along.append(each)
        return roster, tuple(along)

    def _prepare(
        self, roster: Roster, request: Request | None, along: tuple[Request, ...], back: frozenset[str]
    ) -> None:
        self.highest = roster.version
        self._effects.write_record()  # the number is used from now on, whatever becomes of it
        now = self._clock()
        members = self.members
        gone = removed(members.roster, roster)
        processes = {name: process for name, process in members.processes.items() if name not in gone}
        processes.update({name: members.newcomers[name, ""] for name in back})
        replaced: dict[str, str] = {}
        for each in along:
            self.queue.remove(each)
        if request is not None:
            self.queue.remove(request)
            if isinstance(request.change, Replace) and request.change.name not in members.lost:
                replaced = {request.change.name: members.processes[request.change.name]}
            processes.update({name: members.newcomers[name, request.key] for name in request.new_nodes})
            if isinstance(request.change, Undo) and members.trial is not None:
                processes[request.change.name] = members.trial.process
        waiting = set(touched(members.roster, roster)) | {roster.world}
        urgent = bool(members.lost) or (request is not None and isinstance(request.change, Undo))
        self.plan = Plan(roster, processes, request, along, back, waiting, urgent, now, now, replaced)
        self._send_to_waiting(self.plan)
        same = Unchanged(roster.version, members.roster.version)
        for name in sorted(roster.nodes.keys() - waiting):  # so that they need not ask when the first message comes
            self._effects.send_order(processes[name], same)

    # --- from the plan to the roster in force

    def hear(self, word: Ready | State | Taken) -> None:
        """Somebody that a plan waits for answers."""
        plan = self.plan
        if isinstance(word, State):
            self._check_same(word)
        if plan is None or plan.version != word.version:
            return
        if isinstance(word, Ready):
            if plan.stage is Stage.PREPARE and plan.processes.get(word.name) == word.process:
                self._on_answer(plan, word)
        elif plan.stage is not Stage.HAND_OVER:
            return
        elif isinstance(word, State):
            self._on_state(plan, word)
        elif word.name in plan.waiting and word.name in plan.states:
            self._on_answer(plan, word)

    def take_effect(self, plan: Plan) -> None:
        """Begin the next epoch, or the next attempt, under a plan's roster; first what is replaced hands over."""
        if plan.replaced and plan.stage is not Stage.HAND_OVER:
            plan.stage = Stage.HAND_OVER
            self._states = {}
            plan.since_s = self._clock()
            plan.waiting = set(plan.replaced)
            self._send_to_waiting(plan)
            return
        away = self.members.lost.keys() - plan.back - {plan.undone}
        if away & plan.roster.nodes.keys():
            return
        first = self.progress.epoch + 1
        self.plan = None
        if plan.undone:
            key = self.members.born[plan.undone][2]
            self._answers.undo(key, f"{self.members.failures[plan.undone]}; what it was to replace goes on")
        gone = self.members.take_effect(plan, first)
        for request in plan.requests:
            if request.key:
                self._answers.owe(request.key, first, request.new_nodes)
        self.progress.begin()  # recorded first: a process that was told to go cannot be had back
        for name, process in gone.items():
            instead = "another process runs it" if name in plan.processes else "it is detached"
            self._effects.send_order(process, Dismiss(f"{name}: {instead} from epoch {first} on"))
        self.reconsider()

    def _send_to_waiting(self, plan: Plan) -> None:
        plan.told_s = self._clock()
        prepare = Prepare(plan.roster.plain(), self.members.alone_in(plan), self.members.tried_in(plan))
        epoch, attempt = self.progress.epoch, self.progress.last_attempt
        for name in sorted(plan.waiting):
            if plan.stage is Stage.PREPARE:
                self._effects.send_order(plan.processes[name], prepare)
            elif name in plan.states:
                self._effects.send_order(
                    plan.processes[name], TakeOver(plan.version, epoch, attempt, *plan.states[name])
                )
            else:
                self._effects.send_order(plan.replaced[name], HandOver(plan.version, epoch, attempt))

    def _on_answer(self, plan: Plan, word: Ready | Taken) -> None:
        if word.refusal:
            self._drop(plan, f"{word.name}: {word.refusal}", word.name)
            return
        plan.waiting.discard(word.name)
        if plan.waiting:
            return
        if plan.stage is Stage.PREPARE:
            plan.stage = Stage.READY
            progress = self.progress
            if (progress.running or progress.held) and not plan.urgent:
                return
            if self._policy.overlaps and not progress.drained and not plan.urgent:
                self._proceed()
                return
        self.take_effect(plan)

    def _on_state(self, plan: Plan, word: State) -> None:
        if word.name in plan.replaced and word.name not in plan.states:
            plan.states[word.name] = self._states[word.name] = (word.state, word.under_way)
            self._states_of = plan.version
            self._send_to_waiting(plan)

    def _check_same(self, word: State) -> None:
        """A state that is said again says the same, also when it was handed on long ago."""
        said = (word.state, word.under_way)
        if word.version == self._states_of and self._states.get(word.name, said) != said:
            what = f"two states of {word.name} for version {word.version} of the roster differ"
            self._effects.stop(f"{what}: somebody else speaks in the name of {word.name}")

    # --- plans that come to nothing

    def end_trial(self) -> None:
        """The first epoch of what replaces another node is committed."""
        if self.members.end_trial() and self.plan is not None and self.plan.urgent:
            self.redo()  # it says that the node is tried still
            self.reconsider()

    def redo(self) -> None:
        """Plan anew, where there is a plan, as a process died meanwhile."""
        plan, self.plan = self.plan, None
        if plan is None:
            return
        self.queue.extendleft(reversed(plan.along))
        request = plan.request
        if request is not None:
            request.tries += 1
            if request.key and request.tries > MAX_TRIES:
                self._refuse(request, "processes died each time that it was prepared")
            else:
                self.queue.appendleft(request)

    def _drop(self, plan: Plan, why: str, refuser: str = "") -> None:
        """Give a plan up; the roster in force stays. Who comes back may try again, who asked is refused."""
        self.plan = None
        self.queue.extendleft(reversed(plan.along))
        if plan.request is not None and plan.request.key:
            self._refuse(plan.request, why)
            refuser = ""
        elif plan.request is not None:
            self.queue.appendleft(plan.request)
        if refuser in plan.back:
            del self.members.newcomers[refuser, ""]
            self.members.send_away(refuser, plan.processes[refuser], why)
        elif refuser:
            self.members.end(refuser, plan.processes[refuser], why)
        self.go_on()

    def _hurry(self, plan: Plan, now: float) -> None:
        """Tell those again that are waited for; who takes too long is to blame."""
        if plan.stage is Stage.READY:
            return
        if now - plan.since_s > self._policy.answer_timeout_s:
            silent = self._silent(plan)
            if plan.request is not None and plan.request.key:
                named = ", ".join(silent)
                self._drop(plan, f"no answer from {named} within {self._policy.answer_timeout_s:g} s")
                return
            plan.since_s = now
            for name in silent if plan.requests or plan.back else ():  # else nothing waits for the plan
                self.members.end(name, plan.processes[name], "it does not answer the roster's owner")
        elif now - plan.told_s > TELL_AGAIN_S:
            self._send_to_waiting(plan)

    def _silent(self, plan: Plan) -> list[str]:
        """Who is to blame: who says nothing at all; the others may only wait for its end of a link."""
        waiting = sorted(plan.waiting - {self.members.roster.world})
        silent = [name for name in waiting if self.members.heard_s(plan.processes[name]) < plan.since_s]
        return silent or waiting or [self.members.roster.world]
