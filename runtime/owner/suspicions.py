"""Nodes that are further than the world: somebody else has sent them observations in the name of a node below.

Only the world begins epochs and attempts, so no node can be ahead of it. One that says that it is, is asked
whether that is so, as anybody may have said it in its name.
"""

from __future__ import annotations

from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.schemas.control import AskStatus, Join, Status

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

        Nobody else will ever be in that attempt.
        """
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
        lowers = sorted(edge.lower for edge in self.members.roster.edges if edge.upper == status.name)
        who = f"somebody else has sent it observations in the name of {' or '.join(lowers)}"
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
