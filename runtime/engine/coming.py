"""Which epochs come next at a node with rates."""

from collections.abc import Sequence

from hierax.schemas.rates import Turns, includes


class ComingEpochs:
    """The next epoch that the node passes, and drained ones before that of which it has heard."""

    def __init__(self, passed: Sequence[Turns], epoch: int) -> None:
        self._drained: set[int] = set()
        self.begin(passed, epoch)

    def begin(self, passed: Sequence[Turns], epoch: int) -> None:
        """After this epoch the node is sent observations in these turns, and in drained epochs."""
        self._passed = passed
        self.look_on(epoch)

    def look_on(self, epoch: int) -> None:
        """The node is in another epoch."""
        self._epoch, passed = epoch, self._passed
        self.next = passed[0].next(epoch) if len(passed) == 1 else min(turns.next(epoch) for turns in passed)
        self.epochs: tuple[int, ...] = (self.next,)
        if self._drained:
            self._drained = {drained for drained in self._drained if drained > epoch}
            self._sort()

    def _sort(self) -> None:
        self.epochs = (*sorted(epoch for epoch in self._drained if epoch < self.next), self.next)

    def include(self, epoch: int, is_drained: bool) -> bool:
        """Whether observations of an epoch are wanted; of others, who has the same rates sends none."""
        if epoch == self.next:
            return True
        if epoch <= self._epoch:
            return False
        if is_drained:
            self._drained.add(epoch)
            self._sort()
        return is_drained or includes(self._passed, epoch)
