"""What the parts of an owner share."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hierax.runtime.owner.answers import Answers
from hierax.runtime.owner.effects import OwnerEffects, OwnerPolicy
from hierax.runtime.owner.epoch_progress import EpochProgress
from hierax.runtime.owner.members import Members


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
