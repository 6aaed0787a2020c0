"""What processes have kept that were dismissed."""

from collections.abc import Callable, Collection
from pathlib import Path

from hierax.runtime.launch.frames import NodeOrder
from hierax.runtime.recovery.disk import remove_kept


class Leftovers:
    """The checkpoints of processes that were dismissed, which nobody is to go on with: a launch may run for ever, and
    be changed any number of times.

    Args:
        is_kept: whether a node in force goes on with the checkpoint of an order, as far as it is known here. A process
            may end before it is known that its node is not in force any more, so what is kept is looked at again.
    """

    def __init__(self, is_kept: Callable[[NodeOrder], bool]) -> None:
        self._is_kept = is_kept
        self._orders: dict[str, NodeOrder] = {}  # by checkpoint: processes of one node may have had the same

    def add(self, order: NodeOrder) -> None:
        """The process of an order was dismissed, and has ended."""
        self._orders[order.checkpoint] = order

    def remove(self, in_use: Collection[str]) -> None:
        """Remove what is not kept any more, but for the checkpoints that are in use."""
        for checkpoint, order in list(self._orders.items()):
            if checkpoint not in in_use and not self._is_kept(order):
                remove_kept(Path(checkpoint))
                del self._orders[checkpoint]
