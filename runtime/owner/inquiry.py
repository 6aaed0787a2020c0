"""Who is to blame for an epoch that does not end."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.members import Members
from hierax.schemas.control import AskStatus, Resend, Status

ANSWER_S = 0.2  # how long a process that is well may take to say what it waits for

ASK_AGAIN_S = 0.1  # after which time those are asked once more who have not answered: it may be lost with a link
RESENDS = 3  # how often what is missing is sent again before its link is taken for dead


@dataclass(eq=False)
class Inquiry:
    """Watches the deadline of each attempt; asks, has messages sent again, and names the culprit."""

    effects: OwnerEffects  # of the owner
    clock: Callable[[], float]  # seconds
    policy: OwnerPolicy  # what the deployment says
    members: Members  # who takes part
    _began_s: float = 0.0
    _asked_s: float | None = None
    _insisted: bool = False
    _number: int = 0
    _resends: int = 0
    _answers: dict[str, Status] = field(default_factory=dict)
    _places: dict[str, tuple[int, float]] = field(default_factory=dict)  # with rates: epochs of nodes, and since when

    def start(self) -> None:
        self._began_s = self.clock()
        self._asked_s = None
        self._resends = 0

    def hear(self, status: Status) -> None:
        if status.inquiry == self._number:
            self._answers[status.name] = status

    def tick(self, epoch: int, attempt: int) -> None:
        now = self.clock()
        if self.policy.epoch_deadline_s is None or now - self._began_s <= self.policy.epoch_deadline_s:
            return
        if self._asked_s is None:
            self._ask(now)
        elif self._answers.keys() != self.members.roster.nodes.keys() and not self._insisted:
            if now - self._asked_s > ASK_AGAIN_S:
                self._insisted = True
                self._send_question(sorted(self.members.roster.nodes.keys() - self._answers.keys()))
        elif now - self._asked_s > ANSWER_S or self._answers.keys() == self.members.roster.nodes.keys():
            self._asked_s = None
            self._judge(epoch, attempt)

    def _ask(self, now: float) -> None:
        self._asked_s = now
        self._number += 1
        self._answers = {}
        self._insisted = False
        self._send_question(sorted(self.members.roster.nodes))

    def _send_question(self, names: list[str]) -> None:
        for name in names:
            self.effects.send_order(self.members.processes[name], AskStatus(self._number))

    def _judge(self, epoch: int, attempt: int) -> None:
        silent = sorted(self.members.roster.nodes.keys() - self._answers.keys())
        busy = sorted(name for name, status in self._answers.items() if status.busy)
        place = self._place_of(Status("", 0, epoch, attempt, (), "", self.members.roster.version))
        waiting = {
            name: status.waits_for
            for name, status in sorted(self._answers.items())
            if self._place_of(status) == place and status.waits_for
        }
        behind = sorted(name for name, status in self._answers.items() if self._place_of(status) < place)
        ahead = sorted(name for name, status in self._answers.items() if status.epoch > epoch)
        if ahead:  # the world's record was damaged, and what it falls back to is too old
            others = f"{', '.join(ahead)}: in epoch {self._answers[ahead[0]].epoch}"
            what = f"the world goes on with epoch {epoch}, and that was committed already ({others})"
            self.effects.stop(f"{what}, or somebody else has sent them observations")
            return
        if self.policy.rated:
            at_work, got_on = busy, self._has_got_on()
            busy = [name for name in at_work if self._is_stuck(name)]
            if not (silent or busy) and (at_work or got_on):
                self._began_s = self.clock() - self._deadline_s / 2
                return
        self._note(epoch, silent, busy, waiting)
        if silent or busy:
            self._blame(epoch, silent, busy)
        elif self._resends < RESENDS:
            self._resends += 1
            self._send_again(epoch, attempt, waiting, behind)
        else:
            self._resends = 0
            self._blame_link(waiting, behind)

    def _has_got_on(self) -> bool:
        """Whether a node is in another epoch than when all were asked before; with rates it may be behind by many."""
        now, moved = self.clock(), False
        for name, status in self._answers.items():
            if self._places.get(name, (-1, 0.0))[0] != status.epoch:
                self._places[name], moved = (status.epoch, now), True
        return moved

    def _is_stuck(self, name: str) -> bool:
        """Whether a node is in one epoch for as long as one may take."""
        return self.clock() - self._places[name][1] >= self._deadline_s

    @property
    def _deadline_s(self) -> float:
        return self.policy.epoch_deadline_s or 0.0

    def _place_of(self, status: Status) -> tuple[int, ...]:
        """Where all have to be; with rates nodes may be in different epochs, and an epoch has one attempt."""
        return (status.version,) if self.policy.rated else (status.epoch, status.attempt, status.version)

    def _note(
        self, epoch: int, silent: list[str], busy: list[str], waiting: Mapping[str, tuple[tuple[str, str], ...]]
    ) -> None:
        parts = [f"{name} does not answer" for name in silent]
        parts += [f"{name} is in {self._answers[name].busy}" for name in busy]
        parts += [
            f"{name} waits for {', '.join(f'{kind} from {sender}' for sender, kind in slots)}"
            for name, slots in waiting.items()
            if name not in busy
        ]
        self.effects.note(
            f"epoch {epoch} is past its deadline of {self.policy.epoch_deadline_s:g} s: {'; '.join(parts)}"
        )

    def _blame(self, epoch: int, silent: list[str], busy: list[str]) -> None:
        self._began_s = self.clock()
        for name in silent or busy:
            why = "it does not answer" if name in silent else f"it is in {self._answers[name].busy}"
            self.members.end(name, self.members.processes[name], f"{why} in epoch {epoch}, past the deadline")

    def _send_again(
        self, epoch: int, attempt: int, waiting: Mapping[str, tuple[tuple[str, str], ...]], behind: list[str]
    ) -> None:
        wanted: dict[str, set[str]] = {}
        for name, slots in waiting.items():
            for sender, _ in slots:
                wanted.setdefault(sender, set()).add(name)
        for edge in self.members.roster.edges:
            if edge.upper in behind and edge.lower not in behind:
                wanted.setdefault(edge.lower, set()).add(edge.upper)
        for sender, receivers in sorted(wanted.items()):
            self.effects.send_order(self.members.processes[sender], Resend(epoch, attempt, tuple(sorted(receivers))))

    def _blame_link(self, waiting: Mapping[str, tuple[tuple[str, str], ...]], behind: list[str]) -> None:
        """What is sent again and again does not arrive: the upper end of the link is taken for lost."""
        self._began_s = self.clock()
        missing = {(sender, name) for name, slots in waiting.items() for sender, _ in slots}
        if self.policy.rated:  # who waits for somebody who waits is not to blame
            missing = {(sender, name) for sender, name in missing if sender not in waiting} or missing
        uppers = sorted(
            edge.upper
            for edge in self.members.roster.edges
            if edge.pair in missing or edge.pair[::-1] in missing or (edge.upper in behind and edge.lower not in behind)
        )
        for name in uppers[:1]:
            self.members.end(name, self.members.processes[name], "a link to it carries nothing")
