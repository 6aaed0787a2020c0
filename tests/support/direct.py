"""What a hierarchy with rates is, said a second time: every value by what it is made of, all of the past at hand.

There is no order, no state and no message here: a belief is a function of node and epoch."""

from __future__ import annotations

from functools import cache

from hierax.runtime.core.binding import epoch_time_s
from hierax.runtime.core.digest import NO_DIGEST, encode_state, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.rates import Rates


class Direct:
    """A hierarchy and its rates.

    Args:
        hierarchy, rates: as they are.
    """

    def __init__(self, hierarchy: Hierarchy, rates: Rates) -> None:
        self.hierarchy, self.rates = hierarchy, rates
        for name in ("time_s", "after", "sensed", "observed", "digest"):
            setattr(self, name, cache(getattr(self, name)))

    def turns(self, name: str, until: int) -> list[int]:
        """The epochs up to one in which a node takes part."""
        said = self.rates.turns.get(name)
        every, offset = (1, 0) if said is None else (said.every, said.offset)
        return [epoch for epoch in range(1, until + 1) if epoch % every == offset]

    def time_s(self, epoch: int) -> float:
        """The epoch's time."""
        world = self.hierarchy.world
        return epoch_time_s(world, self.hierarchy.world_node, self.after(world, epoch - 1).belief, epoch)

    def after(self, name: str, epoch: int) -> ActiveNode:
        """The state of a node after an epoch."""
        bound = self.hierarchy.bound[name]
        if epoch == 0:
            return ActiveNode(bound.initial_belief(0, 0.0), bound.node.initial_policy)
        if epoch not in self.turns(name, epoch):
            return self.after(name, epoch - 1)
        time_s, sensed = self.time_s(epoch), self.sensed(name, epoch)
        tasks = self.from_above(name, epoch, "task")
        context = self.from_above(name, epoch, "context")
        policy = bound.choose(epoch, time_s, tasks) if bound.above else self.after(name, epoch - 1).policy
        actions = bound.policies[policy].elements(epoch, time_s, sensed)
        return ActiveNode(bound.predict(epoch, time_s, context, actions, sensed), policy, actions)

    def sensed(self, name: str, epoch: int) -> Value:
        """The belief of a node in an epoch, before it predicts."""
        before = self.after(name, epoch - 1)
        if name == self.hierarchy.world or epoch not in self.turns(name, epoch):
            return before.belief
        observations: Elements = ()
        for lower in self.hierarchy.below(name):
            if (lower, name) not in self.rates.gathers:
                observations += self.observed(lower, name, epoch)
                continue
            last = max(self.turns(name, epoch - 1), default=0)
            for gathered in [each for each in self.turns(lower, epoch) if each > last]:
                observations += tuple((gathered, element) for element in self.observed(lower, name, gathered))
        return self.hierarchy.bound[name].observe(epoch, self.time_s(epoch), observations, before.belief)

    def observed(self, lower: str, upper: str, epoch: int) -> Elements:
        """What φ of an edge gives in an epoch."""
        sense = self.hierarchy.bound_edges[lower, upper].sense
        return () if sense is None else sense.elements(epoch, self.time_s(epoch), self.sensed(lower, epoch))

    def counting(self, lower: str, upper: str, epoch: int) -> int:
        """The epoch in which the upper node said what counts at the lower one; 0: none."""
        return max(self.turns(upper, epoch - self.rates.delays.get((lower, upper), 0)), default=0)

    def from_above(self, name: str, epoch: int, kind: str) -> Elements:
        """Tasks or context that count at a node in an epoch."""
        elements: Elements = ()
        for upper in self.hierarchy.above(name):
            said, function = self.counting(name, upper, epoch), getattr(self.hierarchy.bound_edges[name, upper], kind)
            if said and function is not None:
                state = self.after(upper, said)
                argument = state.actions if kind == "task" else state.belief
                elements += function.elements(said, self.time_s(said), argument)
        return elements

    def digest(self, name: str, epoch: int) -> bytes:
        """The digest of a node after its last turn up to an epoch."""
        turn = max(self.turns(name, epoch), default=0)
        if not turn:
            return NO_DIGEST
        above = self.hierarchy.above(name)
        heard = [self.digest(upper, self.counting(name, upper, turn)) for upper in above]
        return node_digest(encode_state(*self.after(name, turn)), heard)
