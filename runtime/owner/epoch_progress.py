"""How far a run is: its epochs, and their attempts."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from hierax.runtime.owner.effects import OwnerEffects
from hierax.runtime.owner.inquiry import Inquiry
from hierax.runtime.owner.members import Members
from hierax.schemas.control import NEVER


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

    def __post_init__(self) -> None:
        self.running = False  # whether an epoch is under way
        self.drains = False  # whether the epoch under way does not overlap with the next one
        self.drained = False  # whether the last one committed did not
        self.over = False  # whether it was the last one of the run
        self._skips = self.attempt != NEVER  # of the next epoch the first attempt may have been begun and forgotten

    def begin(self) -> None:
        self.running = True
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
        if self.running and not self.members.lost:
            self.inquiry.tick(self.epoch + 1, self.attempt)
