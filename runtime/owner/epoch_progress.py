"""How far a run is: its epochs, and their attempts."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from hierax.runtime.owner.effects import OwnerEffects
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.members import Members
from hierax.schemas.control import NEVER


@dataclass(eq=False, repr=False)
class EpochProgress:
    """The epochs of a run.

    Attributes:
        epoch: the last one committed.
        attempt: of the epoch after that, the last one begun; NEVER: none was.
        last_attempt: the one of the last epoch committed that was.
        running: whether an epoch is under way.
        settled: it may have been acted upon, so it is done again with the same nodes.
        drains: whether the epoch under way does not overlap with the next one.
        drained: whether the last one committed did not.
        over: whether it was the last one of the run.
    """

    members: Members  # who takes part
    inquiry: Inquiry  # of attempts that do not end
    effects: OwnerEffects  # of the owner
    _: KW_ONLY
    epoch: int
    attempt: int
    settled: bool
    last_attempt: int

    def __post_init__(self) -> None:
        self.running = False
        self.drains = False
        self.drained = False
        self.over = False
        self._skips = self.attempt != NEVER  # of the next epoch the first attempt may have been begun and forgotten

    def begin(self) -> None:
        """Begin the next epoch, or begin it again."""
        self.running = True
        self.attempt += 1
        self.inquiry.start()
        self.effects.begin(self.epoch + 1, self.attempt, self.members.roster.version)

    def committed(self, epoch: int) -> None:
        """An epoch is committed."""
        self.epoch = epoch
        self.last_attempt, self.attempt = self.attempt, NEVER + self._skips
        self._skips = False
        self.running = False
        self.drained, self.drains = self.drains, False
        self.settled = False

    def tick(self) -> None:
        """Time has passed."""
        if self.running and not self.members.lost:
            self.inquiry.tick(self.epoch + 1, self.attempt)
