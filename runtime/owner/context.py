"""What the parts of an owner share: how far the run is, and what became of the changes that were asked for."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import NamedTuple

from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.members import Members
from hierax.schemas.control import NEVER

REMEMBERED = 1024
"""How many answers are remembered, so that a change which is asked for twice is answered twice, and made once."""

OVER = "the run is over"


@dataclass(eq=False, repr=False)
class EpochProgress:
    """The epochs of a run."""

    members: Members  # who takes part
    inquiry: Inquiry  # of attempts that do not end
    effects: OwnerEffects  # of the owner
    _: KW_ONLY
    epoch: int  # the last one committed
    attempt: int  # of the epoch after that, the last one begun; NEVER: none was
    settled: bool  # it may have been acted upon, so it is done again with the same nodes
    last_attempt: int  # the one of the last epoch committed that was
    drains: bool = False  # whether the epoch under way does not overlap with the next one

    def __post_init__(self) -> None:
        self.running = False  # whether an epoch is under way
        self.drained = False  # whether the last one committed did not
        self.held = False  # whether the next one is not due yet
        self.last = False  # whether it was the last one of the run; with rates, nodes may be behind it
        self.over = False  # whether all are done with that
        self._skips = self.attempt != NEVER  # of the next epoch the first attempt may have been begun and forgotten

    @property
    def under_way(self) -> int:
        """The epoch that is under way, or comes next; at the end of the run, the last one."""
        return self.epoch + (not self.last)

    def begin(self) -> None:
        self.running, self.held = not self.last, False
        self.attempt += 1
        self.inquiry.start()
        self.effects.begin(self.epoch + 1, self.attempt, self.members.roster.version)

    def committed(self, epoch: int) -> None:
        self.epoch = epoch
        self.last_attempt, self.attempt = self.attempt, NEVER + self._skips
        self._skips = False
        self.running = False
        self.drained, self.drains = self.drains, False
        self.settled = False

    def tick(self) -> None:
        if (self.running or self.last) and not self.members.lost:
            self.inquiry.tick(self.under_way, self.attempt)


class Answers:
    """Those that were given, and those that are owed."""

    def __init__(self, members: Members, effects: OwnerEffects) -> None:
        self._members = members  # who takes part
        self._effects = effects  # of the owner
        self._given: OrderedDict[str, tuple[int, str]] = OrderedDict()
        self._owed: list[tuple[str, int, tuple[str, ...]]] = []

    def repeat(self, key: str) -> bool:
        if key not in self._given:
            return False
        self.give(key, *self._given[key])
        return True

    def give(self, key: str, epoch: int, refusal: str) -> None:
        """A change holds from an epoch on, which is committed; or why it is refused."""
        self._given[key] = (epoch, refusal)
        if len(self._given) > REMEMBERED:
            self._given.popitem(last=False)
        self._effects.answer(key, epoch, refusal)

    def knows(self, key: str) -> bool:
        """Whether a change was asked for, and is in force or answered."""
        return key in self._given or self.owes(key)

    def owes(self, key: str) -> bool:
        """Whether a change is in force, and nobody was told yet."""
        return any(each[0] == key for each in self._owed)

    def owe(self, key: str, epoch: int, names: tuple[str, ...]) -> None:
        """A change is in force with an epoch, and told when that is committed and recorded; `names`: its nodes."""
        self._owed.append((key, epoch, names))

    def undo(self, key: str, why: str) -> None:
        """A change was in force, and is undone before its first epoch is committed."""
        self._owed = [each for each in self._owed if each[0] != key]
        if key:
            self.give(key, 0, why)

    def owe_what_was_made(self, key: str) -> bool:
        """Whether a change took effect before the world's process died, which had not said so yet."""
        born = self._members.born
        names = tuple(sorted(name for name, each in born.items() if each[2] == key))
        if names:
            self.owe(key, born[names[0]][1], names)
        return bool(names)

    def report(self, committed: int) -> None:
        """Tell those whose first epoch is committed and recorded."""
        if not self._owed:
            return
        due = [each for each in self._owed if each[1] <= committed]
        self._owed = [each for each in self._owed if each[1] > committed]
        members = self._members
        for key, first, names in due:
            gone = [name for name in names if name not in members.roster.nodes or members.born[name][2] != key]
            if gone:
                why = "; ".join(members.failures[name] for name in names if name in members.failures)
                why = f"{why}; " if why else ""
                self.give(key, 0, f"{why}{', '.join(gone)}: detached again before the first epoch was committed")
            else:
                self.give(key, first, "")


class OwnerContext(NamedTuple):
    """What an owner's parts know, and what they act by."""

    effects: OwnerEffects  # called with all that is to be done
    clock: Callable[[], float]  # seconds, never going back
    policy: OwnerPolicy  # what the deployment says
    members: Members  # who takes part
    progress: EpochProgress  # of the epochs
    answers: Answers  # to those who have asked for changes


class OwnerPart:
    """A part of an owner. `context`: what it shares with the others."""

    def __init__(self, context: OwnerContext) -> None:
        self._effects, self._clock, self._policy, self.members, self.progress, self._answers = context
