"""The end of a run with rates: the world has finished, and others may be behind it."""

from hierax.runtime.owner.context import OwnerContext, OwnerPart
from hierax.schemas.control import CatchUp, CaughtUp

ASK_AGAIN_S = 0.02  # how often those that have not said that they are done are asked


class Ending(OwnerPart):
    """Waits until all nodes are done with the run's last epoch."""

    def __init__(self, context: OwnerContext) -> None:
        super().__init__(context)
        self._asked_s = 0.0
        self._done: set[str] = set()  # processes

    def begin(self) -> None:
        """The last epoch is committed."""
        self.progress.inquiry.start()
        self._go_on()

    def hear(self, word: CaughtUp) -> None:
        """A process says that it is done."""
        progress, members = self.progress, self.members
        if progress.last and word.epoch == progress.epoch and members.processes.get(word.name) == word.process:
            self._done.add(word.process)
            self._look()

    def tick(self) -> None:
        """Time has passed."""
        if self.progress.last and self._clock() - self._asked_s >= ASK_AGAIN_S:
            self._go_on()

    def _look(self) -> None:
        self.progress.over = not (self.members.lost or self._behind())

    def _behind(self) -> list[tuple[str, str]]:
        """The nodes that are not known to be done, and their processes."""
        members = self.members
        there = sorted(members.processes.items())
        return [each for each in there if each[0] != members.roster.world and each[1] not in self._done]

    def _go_on(self) -> None:
        self._asked_s = self._clock()
        for name, process in self._behind():
            if name not in self.members.lost:
                self._effects.send_order(process, CatchUp(self.progress.epoch))
        self._look()
