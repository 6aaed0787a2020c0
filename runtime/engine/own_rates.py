"""The rates of a hierarchy as one node has them, laid out so that little is left to do in an epoch."""

from hierax.runtime.engine.wiring import Slot, Wiring
from hierax.schemas.rates import EVERY_EPOCH, EdgeRates, Rates, includes


class OwnRates:
    """What a node does in which epoch.

    Args:
        rates: of the hierarchy, of which it is known since when they hold.
        wiring: of the node.
    """

    def __init__(self, rates: Rates, wiring: Wiring) -> None:
        node = wiring.node
        name = self._name = node.name
        self.passes = rates.passes(name)  # the epochs of which it is told
        self.above = {slot: rates.edge(name, slot[0]) for slot in wiring.above}  # when what comes of it counts
        self._at_once = set(self.above.values()) <= {EdgeRates(1, 0, 0)}
        self.below = {lower: rates.edge(lower, name) for lower in node.below}  # when context counts there
        self._told = tuple((upper, rates.passes(upper)) for upper in node.above)
        since = rates.timing.since
        turns = {each: rates.turns_of(each) for each in (name, *node.above)}
        self._turns = {each: (its.every, its.offset, since.get(each, 1)) for each, its in turns.items()}
        self._each_epoch = set(self._turns.values()) == {(1, 0, 1)}
        self._gathered = frozenset(upper for upper in node.above if (name, upper) in rates.gathers)
        self._all = frozenset(node.above)
        self._tells_all = all(EVERY_EPOCH in passed for _, passed in self._told)

    def takes_part(self, name: str, epoch: int) -> bool:
        """Whether an epoch is a turn of the node, or of a neighbour above."""
        if self._each_epoch:
            return True
        every, offset, first = self._turns[name]
        return (epoch - offset) % every == 0 and epoch >= first

    def is_sensed(self, upper: str, epoch: int) -> bool:
        """Whether φ of the edge to a neighbour above is applied: in its turns; where that gathers, in the node's."""
        return self.takes_part(self._name if upper in self._gathered else upper, epoch)

    def counting(self, epoch: int) -> dict[Slot, int]:
        """By slot, the epoch whose input from above counts in a turn of the node; 0: there is none yet."""
        if self._at_once:
            return dict.fromkeys(self.above, epoch)
        return {slot: edge.in_force(epoch) for slot, edge in self.above.items()}

    def told_above(self, epoch: int) -> frozenset[str]:
        """Which neighbours above pass an epoch that is not drained."""
        if self._tells_all:
            return self._all
        return frozenset(upper for upper, passed in self._told if includes(passed, epoch))
