"""The owner of the roster: decides which version an epoch runs under, and when one is done again."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.owner.changes import apply, check_modules, removed, touched
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.outlet import DETACH, RESTART, OwnerOutlet, OwnerSettings
from hierax.runtime.owner.plan import Plan, Request, Stage
from hierax.schemas.changes import Attach, Change, Detach, Replace, read_change
from hierax.schemas.control import (
    NEVER,
    Census,
    Control,
    Dismiss,
    Fetch,
    HandOver,
    Join,
    Lost,
    Prepare,
    Propose,
    Ready,
    State,
    Status,
    Taken,
    TakeOver,
)
from hierax.schemas.errors import SchemaError
from hierax.schemas.roster import Roster

TELL_AGAIN_S = 0.1
"""How often those that are waited for are told again."""

MAX_TRIES = 5
"""How often a change is planned anew because a process died meanwhile."""

REMEMBERED = 1024
"""How many answers, and how many dead processes, are remembered, so that what comes late or twice does no harm."""


OVER = "the run is over"


class Owner:
    """Owns the roster of a run; lives beside the world's engine.

    Args:
        roster: in force.
        processes: of its nodes; one without is lost.
        outlet: called with all that is to be done.
        clock: seconds, never going back.
        settings: of the deployment.
        epoch: the last one committed.
        attempt: the last one of the epoch after that; NEVER: none was begun.
        highest: the highest version that was ever prepared.
        born: by node, the version with which it came in, the first epoch that it took part in, and the
            request of it; None: all were there at the beginning.
        settled: the epoch after that may have been acted upon, so it is done again with the same nodes.
    """

    def __init__(
        self,
        roster: Roster,
        processes: Mapping[str, str],
        outlet: OwnerOutlet,
        clock: Callable[[], float],
        settings: OwnerSettings,
        *,
        epoch: int = 0,
        attempt: int = NEVER,
        highest: int = 0,
        born: Mapping[str, tuple[int, int, str]] | None = None,
        settled: bool = False,
    ) -> None:
        self.roster = roster
        self.processes = dict(processes)
        self.epoch = epoch
        self.attempt = attempt
        self.highest = max(highest, roster.version)
        self._outlet = outlet
        self._clock = clock
        self._settings = settings
        self._on_loss = dict(settings.on_loss)
        self._rejoin_timeout_s = dict(settings.rejoin_timeout_s)
        self._running = False
        self._drained = False
        self.drains = False
        self._plan: Plan | None = None
        self._queue: deque[Request] = deque()
        self._newcomers: dict[tuple[str, str], str] = {}
        self._lost: dict[str, float] = {}
        self._given_up: set[str] = set()
        self._unanswered: list[tuple[str, int, tuple[str, ...]]] = []
        self._answers: OrderedDict[str, tuple[int, str]] = OrderedDict()
        self._born = {name: (born or {}).get(name, (0, 1, "")) for name in roster.nodes}
        self._settled = settled
        self._skips = attempt != NEVER  # of the next epoch the first attempt may have been begun and forgotten
        self._over = False
        self._dead: OrderedDict[str, None] = OrderedDict()
        self._ended: dict[tuple[str, str], float] = {}
        self._refused: dict[str, str] = {}
        self._heard_s: dict[str, float] = {}
        self._last_of: dict[str, int] = {}
        self._inquiry = Inquiry(outlet, self._end, clock, settings)
        for name in roster.nodes.keys() - self.processes.keys():
            self._lost[name] = clock()

    @property
    def lost(self) -> frozenset[str]:
        """The nodes that have no process."""
        return frozenset(self._lost)

    @property
    def world_process(self) -> str:
        """The owner's own."""
        return self.processes[self.roster.world]

    def born(self, name: str) -> tuple[int, int, str]:
        """The version with which a node came in, the first epoch that it took part in, and the request of it.

        What a process wrote under an older version, it wrote as another node of that name.
        """
        return self._born[name]

    def take_back(self, process: str) -> None:
        """Come back as a new process of the world's; the epoch is begun again once its neighbours are ready."""
        world = self.roster.world
        self._lost[world] = self._clock()
        self._newcomers[world, ""] = process
        self._reconsider()

    def proceed(self) -> None:
        """The world may begin the next epoch."""
        if self._running:
            return
        plan = self._plan
        if not self._lost:
            ready = plan is not None and plan.stage is Stage.READY
            if plan is not None and ready and (self._drained or not self._settings.overlaps):
                self._take_effect(plan)
            elif plan is None or ready or plan.stage is Stage.PREPARE:
                self.drains = ready
                self._begin()
        if not self._running:
            self._outlet.keep()  # nobody hears of a commit that a crash could undo
        self._tell_answers()

    def committed(self, epoch: int) -> None:
        """An epoch is committed; `proceed` or `finish` follows."""
        self.epoch = epoch
        self.attempt = NEVER + self._skips
        self._skips = False
        self._running = False
        self._drained, self.drains = self.drains, False
        self._settled = False
        if self._lost:
            self._send_late_away()
        if self._queue:
            self._reconsider()

    def finish(self) -> None:
        """The last epoch is committed and recorded: what is still asked for comes too late."""
        self._over = True
        self._tell_answers()
        plan, self._plan = self._plan, None
        for request in [*self._queue, *(plan.requests if plan else [])]:
            if request.key:
                self._refuse(request, OVER)
        self._queue.clear()

    def hear(self, word: Control) -> None:
        """Take in what a process, a keeper or a user says."""
        if isinstance(word, (Join, Ready, Fetch)):
            self._heard_s[word.process] = self._clock()
        if self._over:
            if isinstance(word, Propose):
                self._answer(word.request, *self._answers.get(word.request, (0, OVER)))
        elif isinstance(word, Ready):
            self._on_ready(word)
        elif isinstance(word, Join):
            self._on_join(word)
        elif isinstance(word, Lost):
            self._on_death(word)
        elif isinstance(word, State):
            self._on_state(word)
        elif isinstance(word, Taken):
            self._on_taken(word)
        elif isinstance(word, Fetch):
            self._on_fetch(word)
        elif isinstance(word, Status):
            self._inquiry.hear(word)
        elif isinstance(word, Propose):
            self._on_propose(word)
        elif isinstance(word, Census):
            self._on_census(word)

    def tick(self) -> None:
        """Time has passed."""
        now = self._clock()
        if self._over:
            return
        for (name, process), since in list(self._ended.items()):
            if now - since > self._settings.answer_timeout_s:  # its keeper is cut off as well
                del self._ended[name, process]
                self._on_lost(name, process, restarts=True)
        for name, since in list(self._lost.items()):
            waits = self._on_loss.get(name, RESTART) == RESTART or (name, "") in self._newcomers
            if not waits and now - since > self._rejoin_timeout_s.get(name, inf):
                self._give_up(name, "it did not come back in time (rejoin_timeout)")
        for request in list(self._queue):
            if now - request.since_s > self._settings.start_timeout_s and self._missing(request):
                self._queue.remove(request)
                missing = ", ".join(self._missing(request))
                self._refuse(request, f"no process for {missing} came up in time (start_timeout_s)")
        if self._plan is not None:
            self._hurry(self._plan, now)
        if self._running and not self._lost:
            self._inquiry.tick(self.epoch + 1, self.attempt, self.roster, self.processes)

    def _begin(self) -> None:
        self._running = True
        self.attempt += 1
        self._inquiry.start()
        self._outlet.begin(self.epoch + 1, self.attempt, self.roster.version)

    # --- what is asked for

    def _on_propose(self, word: Propose) -> None:
        key = word.request
        if key in self._answers:
            self._answer(key, *self._answers[key])
            return
        asked = [*self._queue, *(self._plan.requests if self._plan else [])]
        if any(request.key == key for request in asked) or any(each[0] == key for each in self._unanswered):
            return  # asked twice
        names = tuple(sorted(name for name, born in self._born.items() if born[2] == key))
        if names:  # it took effect, and the world's process died before it said so
            self._unanswered.append((key, self._born[names[0]][1], names))
            return
        try:
            change = read_change(word.change)
            check_modules(change, self._settings.modules)
            apply(self.roster, change, self.highest + 1, lambda _: self.highest + 1)
        except (HieraxError, SchemaError) as error:
            self._answer(key, 0, str(error))
            return
        self._queue.append(Request(key, change, self._clock(), word.on_loss, word.rejoin_timeout_s))
        self._reconsider()

    def _on_join(self, word: Join) -> None:
        name, process = word.name, word.process
        if process in self._dead and not word.active:
            back = name in self._lost and (not word.request or process == self.processes.get(name))
            self._outlet.tell(process, Dismiss(f"{name}: it was cut off, and taken for lost", again=back))
            return  # where it is dead, nobody hears that
        if word.active:
            if word.epoch > self.epoch + 1:
                self._stop_behind(f"{name} has begun epoch {word.epoch}")
            else:
                self._on_active(name, process)
            return
        if process in self._processes_of(name):
            return  # said twice
        request = next((each for each in self._queue if word.request and each.key == word.request), None)
        plan = self._plan
        if request is not None:
            self._on_newcomer(word, request)
        elif plan is not None and plan.request is not None and plan.request.key == word.request:
            return
        elif word.request or name not in self.roster.nodes:
            self._outlet.tell(process, Dismiss(f"{name}: nobody asks for it (any more)"))
        elif name in self._lost:
            self._on_back(word)

    def _on_back(self, word: Join) -> None:
        """A process in the place of a lost one."""
        name, process = word.name, word.process
        if (name, "") in self._newcomers:
            return
        if word.epoch != NEVER and word.version < self._born[name][0]:
            self._outlet.tell(process, Dismiss(f"{name}: another node has taken its place"))
            return
        why = word.refusal or self._unsound(name, word.epoch)
        if word.version > self.roster.version:  # the world's record was damaged, and what it falls back to is too old
            why = f"it was in version {word.version} of the roster, and the hierarchy is in {self.roster.version}"
        if why:
            self._send_away(name, process, why)
            return
        self._newcomers[name, ""] = process
        self._last_of[process] = word.epoch
        self._reconsider()

    def _send_late_away(self) -> None:
        """An epoch was committed, as lost processes had done their part: those in their place may be behind."""
        for (name, key), process in list(self._newcomers.items()):
            why = "" if key or process not in self._last_of else self._unsound(name, self._last_of[process])
            if why:
                del self._newcomers[name, key]
                if self._plan is not None and name in self._plan.back:
                    self._redo(self._plan)
                self._send_away(name, process, why)

    def _unsound(self, name: str, epoch: int) -> str:
        """Why a process with a checkpoint of this epoch cannot go on."""
        if epoch == NEVER and self.epoch >= self._born[name][1]:
            return f"it has no checkpoint, and its node has taken part in epoch {self.epoch}"
        if epoch in (NEVER, self.epoch, self.epoch + 1) or (self._settings.overlaps and epoch < self.epoch):
            return ""  # where epochs overlap a node may be behind
        return f"its checkpoint is of epoch {epoch}, and the hierarchy is in epoch {self.epoch + 1}"

    def _send_away(self, name: str, process: str, why: str) -> None:
        """A process cannot run a node; when its keeper says that it is gone, the node is given up."""
        self._outlet.note(f"{name}: {why}; it cannot come back")
        self._refused[process] = why
        self._outlet.tell(process, Dismiss(why))

    def _on_newcomer(self, word: Join, request: Request) -> None:
        if word.refusal:
            self._queue.remove(request)
            self._refuse(request, word.refusal)
        elif word.epoch != NEVER and isinstance(request.change, Attach):
            self._outlet.tell(word.process, Dismiss("it has a checkpoint, and a node that is attached begins anew"))
        elif (word.name, word.request) not in self._newcomers:
            self._newcomers[word.name, word.request] = word.process
            self._reconsider()

    def _on_active(self, name: str, process: str) -> None:
        """A process that has taken part asks whether it still may."""
        known = self._processes_of(name)
        if name in self._lost and process in self._dead:  # it was cut off, and no keeper here can kill it
            why = f"{name}: it was cut off, and taken for lost in epoch {self.epoch + 1}"
            self._outlet.tell(process, Dismiss(why, again=True))
        elif name in self._lost and (process not in known or process == self.processes.get(name)):
            self._end(name, process, "it was taken for lost")  # its keeper starts it anew, from its checkpoint
        elif process not in known:
            instead = "another process runs it" if name in self.processes else "it is no part of the hierarchy"
            self._outlet.tell(process, Dismiss(f"{name}: {instead}"))

    def _stop_behind(self, what: str) -> None:
        """The world's record was damaged, and what it falls back to is too old."""
        self._outlet.stop(f"the world goes on with epoch {self.epoch + 1}, but {what}: its record was damaged")

    def _processes_of(self, name: str) -> list[str]:
        """All processes of a node that the owner counts on."""
        known = [process for (other, _), process in self._newcomers.items() if other == name]
        if name in self.processes:
            known.append(self.processes[name])
        if self._plan is not None and name in self._plan.processes:
            known.append(self._plan.processes[name])
        return known

    def _missing(self, request: Request) -> list[str]:
        """The nodes of a change that have no process yet."""
        return [name for name in _new_nodes(request.change) if (name, request.key) not in self._newcomers]

    # --- from the queue to a plan

    def _reconsider(self) -> None:
        """Prepare the next version, where there is something to do and nothing else under way."""
        if self._plan is not None:
            return
        back = {name for name in self._lost if (name, "") in self._newcomers}
        for request in [*self._queue, None]:
            if request is not None and not self._can_be_tried(request):
                continue
            if self._try(request, back):
                return

    def _can_be_tried(self, request: Request) -> bool:
        if self._over or request not in self._queue:
            return False
        change = request.change
        if not request.key and isinstance(change, Detach) and change.name not in self._lost:
            self._queue.remove(request)  # it is back, or detached already
            return False
        if request.key and self._settled:
            return False
        if isinstance(change, Replace) and change.name in self._lost:
            return False  # its state is handed over, so it has to come back first
        return not self._missing(request)

    def _try(self, request: Request | None, back: set[str]) -> bool:
        """Make a plan of a change and the nodes that are back; whether that could be done now."""
        version = self.highest + 1
        roster, along = self._without_lost(request)
        if request is not None:
            try:
                roster = apply(roster, request.change, version, lambda _: version)
            except HieraxError as error:
                if not along:  # else it may be done already when those are
                    self._queue.remove(request)
                    self._refuse(request, str(error))
                return False
        back = back & roster.nodes.keys()
        if (self._lost.keys() - back) & roster.nodes.keys() or not (request or along or back):
            return False  # others are lost and not back, or there is nothing to do
        instances = {**roster.instances, **dict.fromkeys(sorted(back), version)}
        self._prepare(replace(roster, version=version, instances=instances), request, along, frozenset(back))
        return True

    def _without_lost(self, request: Request | None) -> tuple[Roster, tuple[Request, ...]]:
        """The roster without the lost nodes that are to be detached: one after the other, each would wait for all."""
        roster = self.roster
        along = []
        for each in self._queue:
            change = each.change
            wanted = isinstance(change, Detach) and change.name in self._lost and change.name in roster.nodes
            if each is request or not wanted or (each.key and self._settled):
                continue
            try:
                smaller = apply(roster, change, roster.version + 1, lambda _: 0)
            except HieraxError:
                continue  # it is refused when its own turn comes
            roster = replace(smaller, version=roster.version)
            along.append(each)
        return roster, tuple(along)

    def _prepare(
        self, roster: Roster, request: Request | None, along: tuple[Request, ...], back: frozenset[str]
    ) -> None:
        self.highest = roster.version
        self._outlet.keep()  # the number is used from now on, whatever becomes of it
        now = self._clock()
        gone = removed(self.roster, roster)
        processes = {name: process for name, process in self.processes.items() if name not in gone}
        processes.update({name: self._newcomers[name, ""] for name in back})
        replaced: dict[str, str] = {}
        for each in along:
            self._queue.remove(each)
        if request is not None:
            self._queue.remove(request)
            new = {name: process for (name, key), process in self._newcomers.items() if key and key == request.key}
            if isinstance(request.change, Replace) and request.change.name not in self._lost:
                replaced = {request.change.name: self.processes[request.change.name]}
            processes.update(new)
        waiting = set(touched(self.roster, roster)) | {roster.world}
        self._plan = Plan(roster, processes, request, along, back, waiting, bool(self._lost), now, now, replaced)
        self._tell_waiting(self._plan)
        for name in sorted(roster.nodes.keys() - waiting):  # so that they need not ask when the first message comes
            self._outlet.tell(processes[name], Prepare(roster.plain()))

    def _tell_waiting(self, plan: Plan) -> None:
        plan.told_s = self._clock()
        plain = plan.roster.plain()
        for name in sorted(plan.waiting):
            if plan.stage is Stage.PREPARE:
                self._outlet.tell(plan.processes[name], Prepare(plain))
            elif name in plan.states:
                self._outlet.tell(plan.processes[name], TakeOver(plan.version, self.epoch, plan.states[name]))
            else:
                self._outlet.tell(plan.replaced[name], HandOver(plan.version, self.epoch))

    def _on_ready(self, word: Ready) -> None:
        plan = self._plan
        if plan is None or plan.version != word.version or plan.processes.get(word.name) != word.process:
            return
        if plan.stage is not Stage.PREPARE:
            return
        if word.refusal:
            self._drop(plan, f"{word.name}: {word.refusal}", word.name)
            return
        plan.waiting.discard(word.name)
        if not plan.waiting:
            plan.stage = Stage.READY
            if plan.urgent or not self._running:
                self._take_effect(plan)

    # --- from the plan to the roster in force

    def _take_effect(self, plan: Plan) -> None:
        if plan.replaced and plan.stage is not Stage.HAND_OVER:
            plan.stage = Stage.HAND_OVER
            plan.since_s = self._clock()
            plan.waiting = set(plan.replaced)
            self._tell_waiting(plan)
            return
        if any(name in plan.roster.nodes and name not in plan.back for name in self._lost):
            return
        old = self.processes
        self.roster = plan.roster
        self.processes = dict(plan.processes)
        self._plan = None
        self._lost.clear()
        self._given_up.clear()
        key = "" if plan.request is None else plan.request.key
        self._newcomers = {(name, of): process for (name, of), process in self._newcomers.items() if of and of != key}
        fresh = (plan.version, self.epoch + 1, key)
        change = None if plan.request is None else plan.request.change
        if isinstance(change, Replace):
            self._born[change.name] = fresh
        self._born = {name: self._born.get(name, fresh) for name in self.roster.nodes}
        self._unanswered += [(each.key, self.epoch + 1, _new_nodes(each.change)) for each in plan.requests if each.key]
        for request in plan.requests:
            self._on_loss.update(request.on_loss)
            self._rejoin_timeout_s.update(request.rejoin_timeout_s)
        self._begin()  # recorded first: a process that was told to go cannot be had back
        for name, process in old.items():
            if self.processes.get(name) != process:
                instead = "another process runs it" if name in self.processes else "it is detached"
                self._outlet.tell(process, Dismiss(f"{name}: {instead} from epoch {self.epoch + 1} on"))
        self._reconsider()

    def _on_state(self, word: State) -> None:
        plan = self._plan
        if plan is None or plan.version != word.version or plan.stage is not Stage.HAND_OVER:
            return
        if word.name in plan.replaced and word.name not in plan.states:
            plan.states[word.name] = word.state
            self._tell_waiting(plan)

    def _on_taken(self, word: Taken) -> None:
        plan = self._plan
        if plan is None or plan.version != word.version or plan.stage is not Stage.HAND_OVER:
            return
        if word.refusal:
            self._drop(plan, f"{word.name}: {word.refusal}", word.name)
            return
        plan.waiting.discard(word.name)
        if not plan.waiting:
            self._take_effect(plan)

    def _drop(self, plan: Plan, why: str, refuser: str = "") -> None:
        """Give a plan up; the roster in force stays. Who comes back may try again, who asked is refused."""
        self._plan = None
        self._queue.extendleft(reversed(plan.along))
        if plan.request is not None and plan.request.key:
            self._refuse(plan.request, why)
            refuser = ""
        elif plan.request is not None:
            self._queue.appendleft(plan.request)
        if refuser in plan.back:
            del self._newcomers[refuser, ""]
            self._send_away(refuser, plan.processes[refuser], why)
        elif refuser:
            self._end(refuser, plan.processes[refuser], why)
        self._go_on()

    def _redo(self, plan: Plan) -> None:
        """Plan anew, as a process died meanwhile."""
        self._plan = None
        self._queue.extendleft(reversed(plan.along))
        request = plan.request
        if request is not None:
            request.tries += 1
            if request.key and request.tries > MAX_TRIES:
                self._refuse(request, "processes died each time that it was prepared")
            else:
                self._queue.appendleft(request)

    def _go_on(self) -> None:
        self._reconsider()
        if self._plan is None:
            self.proceed()

    def _refuse(self, request: Request, why: str) -> None:
        for name, key in [pair for pair in self._newcomers if request.key and pair[1] == request.key]:
            self._outlet.tell(self._newcomers.pop((name, key)), Dismiss(why))
        if request.key:
            self._answer(request.key, 0, why)
        else:
            self._outlet.stop(why)

    def _answer(self, key: str, epoch: int, refusal: str) -> None:
        self._answers[key] = (epoch, refusal)
        if len(self._answers) > REMEMBERED:
            self._answers.popitem(last=False)
        self._outlet.answer(key, epoch, refusal)

    def _tell_answers(self) -> None:
        """Those whose first epoch is committed and recorded."""
        if not self._unanswered:
            return
        due = [each for each in self._unanswered if each[1] <= self.epoch]
        self._unanswered = [each for each in self._unanswered if each[1] > self.epoch]
        for key, first, names in due:
            gone = [name for name in names if name not in self.roster.nodes or self._born[name][2] != key]
            if gone:
                self._answer(key, 0, f"{', '.join(gone)}: detached again before the first epoch was committed")
            else:
                self._answer(key, first, "")

    def _end(self, name: str, process: str, why: str) -> None:
        """Have a process killed; it is lost when its keeper says so, or says nothing."""
        self._ended.setdefault((name, process), self._clock())
        self._outlet.end(name, process, why)

    # --- who is lost

    def _on_death(self, word: Lost) -> None:
        """A keeper says that a process is gone for good; where it names none, that no other comes for a node."""
        name, process = word.name, word.process
        if not process:
            if name in self._lost and (name, "") not in self._newcomers:
                self._give_up(name, "its process is lost and is not started again")
            return
        self._ended.pop((name, process), None)
        self._dead[process] = None
        if len(self._dead) > REMEMBERED:
            self._dead.popitem(last=False)
        self._heard_s.pop(process, None)
        self._last_of.pop(process, None)
        refusal = self._refused.pop(process, "")
        self._on_lost(name, process, word.restarts)
        if refusal and name in self._lost and (name, "") not in self._newcomers:
            self._give_up(name, refusal)

    def _on_lost(self, name: str, process: str, restarts: bool) -> None:
        for pair, newcomer in list(self._newcomers.items()):
            if newcomer == process:
                del self._newcomers[pair]
                self._on_newcomer_lost(pair[1], name)
        if self.processes.get(name) != process:
            plan = self._plan
            if plan is not None and plan.processes.get(name) == process:
                self._redo(plan)
                self._go_on()
            return
        if name not in self._lost:
            self._outlet.note(f"{name}: its process is lost in epoch {self.epoch + 1}")
            self._lost[name] = self._clock()
            if self._plan is not None:
                self._redo(self._plan)
        if not restarts:
            self._give_up(name, "its process is lost and is not started again")
        self._reconsider()

    def _on_newcomer_lost(self, key: str, name: str) -> None:
        plan = self._plan
        if plan is not None and (
            name in plan.back if not key else plan.request is not None and plan.request.key == key
        ):
            self._redo(plan)
        request = next((each for each in self._queue if key and each.key == key), None)
        if request is not None:
            self._queue.remove(request)
            self._refuse(request, f"the process of {name} died")
        self._go_on()

    def _give_up(self, name: str, why: str) -> None:
        """A node does not come back."""
        if name in self._given_up:
            return
        self._given_up.add(name)
        policy = self._on_loss.get(name, RESTART)
        if policy == DETACH and name != self.roster.world:
            self._outlet.note(f"{name}: {why}; it is detached (on_loss)")
            self._queue.appendleft(Request("", Detach(name, cascade=True), self._clock()))
            self._reconsider()
        else:
            self._outlet.stop(f"{name}: {why}")

    def _on_census(self, word: Census) -> None:
        """The keeper's processes, for an owner that is new: what of them is missing is lost."""
        for name, process in sorted(self.processes.items()):
            if name in word.processes and word.processes[name] != process and name not in self._lost:
                self._on_lost(name, process, restarts=True)

    # --- what is asked of the owner

    def _on_fetch(self, word: Fetch) -> None:
        """Only who has a place in a version is told of it: another process of that node would take part as well."""
        if word.version == self.roster.version and self.processes.get(word.name) == word.process:
            self._outlet.tell(word.process, Prepare(self.roster.plain()))

    # --- when nothing happens

    def _silent(self, plan: Plan) -> list[str]:
        """Who is to blame: who says nothing at all; the others may only wait for its end of a link."""
        waiting = sorted(plan.waiting - {self.roster.world})
        silent = [name for name in waiting if self._heard_s.get(plan.processes[name], -inf) < plan.since_s]
        return silent or waiting or [self.roster.world]

    def _hurry(self, plan: Plan, now: float) -> None:
        if plan.stage is Stage.READY:
            return
        if now - plan.since_s > self._settings.answer_timeout_s:
            silent = self._silent(plan)
            if plan.request is not None and plan.request.key:
                named = ", ".join(silent)
                self._drop(plan, f"no answer from {named} within {self._settings.answer_timeout_s:g} s")
                return
            plan.since_s = now
            for name in silent:
                self._end(name, plan.processes[name], "it does not answer the roster's owner")
        elif now - plan.told_s > TELL_AGAIN_S:
            self._tell_waiting(plan)


def _new_nodes(change: Change) -> tuple[str, ...]:
    """The nodes for which a change needs processes."""
    if isinstance(change, Attach):
        return tuple(sorted(change.nodes))
    return (change.name,) if isinstance(change, Replace) else ()
