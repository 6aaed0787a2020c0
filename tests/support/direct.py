"""What a hierarchy with rates is, said a second time: every value by what it is made of, all of the past at hand.

There is no order, no state and no message here: a belief is a function of node and epoch."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from hierax.runtime.core.binding import epoch_time_s
from hierax.runtime.core.digest import NO_DIGEST, encode_state, node_digest
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveNode
from hierax.schemas.rates import Rates


class Period(NamedTuple):
    """Epochs under one roster.

    Args:
        first: the first of them.
        hierarchy, rates: as they are then.
        replaced: the nodes that take over what another one of their names believed.
    """

    first: int
    hierarchy: Hierarchy
    rates: Rates
    replaced: frozenset[str] = frozenset()


class Direct:
    """A hierarchy and its rates.

    Args:
        hierarchy, rates: as they are at first.
        later: what they are later, in order.
    """

    def __init__(self, hierarchy: Hierarchy, rates: Rates, *later: Period) -> None:
        self.periods = [Period(1, hierarchy, rates), *later]
        for name in ("time_s", "after", "sensed", "observed", "digest", "counting"):
            setattr(self, name, cache(getattr(self, name)))

    def at(self, epoch: int) -> Period:
        return [period for period in self.periods if period.first <= max(epoch, 1)][-1]

    def is_turn(self, name: str, epoch: int) -> bool:
        period = self.at(epoch)
        said = period.rates.turns.get(name)
        every, offset = (1, 0) if said is None else (said.every, said.offset)
        return name in period.hierarchy.nodes and epoch % every == offset

    def turns(self, name: str, until: int) -> list[int]:
        """The epochs up to one in which a node takes part."""
        return [epoch for epoch in range(1, until + 1) if self.is_turn(name, epoch)]

    def since(self, epoch: int, *said: object) -> int:
        """The first epoch of those up to this one, without a gap, of which `_says` gives the same."""
        first = epoch
        while first > 1 and self._says(first - 1, *said) == self._says(epoch, *said):
            first -= 1
        return first

    def _says(self, epoch: int, lower: str, upper: str, what: str) -> object:
        period, pair = self.at(epoch), (lower, upper)
        if pair not in period.hierarchy.bound_edges:
            return None
        if what == "gather":
            return pair in period.rates.gathers
        return what == "edge" or (period.rates.turns.get(upper), period.rates.delays.get(pair, 0))

    def time_s(self, epoch: int) -> float:
        """The epoch's time."""
        hierarchy = self.at(epoch).hierarchy
        return epoch_time_s(hierarchy.world, hierarchy.world_node, self.after(hierarchy.world, epoch - 1).belief, epoch)

    def before(self, name: str, epoch: int) -> ActiveNode:
        """The state of a node when an epoch begins."""
        period = self.at(epoch)
        bound = period.hierarchy.bound[name]
        if epoch == 1 or name not in self.at(epoch - 1).hierarchy.nodes:
            return ActiveNode(bound.initial_belief(0, 0.0), bound.node.initial_policy)
        state = self.after(name, epoch - 1)
        if epoch == period.first and name in period.replaced:
            return state._replace(belief=bound.node.take_over(state.belief))
        return state

    def after(self, name: str, epoch: int) -> ActiveNode:
        """The state of a node after an epoch."""
        if epoch == 0:
            return self.before(name, 1)
        before = self.before(name, epoch)
        if not self.is_turn(name, epoch):
            return before
        bound = self.at(epoch).hierarchy.bound[name]
        time_s, sensed = self.time_s(epoch), self.sensed(name, epoch)
        tasks = self.from_above(name, epoch, "task")
        context = self.from_above(name, epoch, "context")
        policy = bound.choose(epoch, time_s, tasks) if bound.above else before.policy
        actions = bound.policies[policy].elements(epoch, time_s, sensed)
        return ActiveNode(bound.predict(epoch, time_s, context, actions, sensed), policy, actions)

    def sensed(self, name: str, epoch: int) -> Value:
        """The belief of a node in an epoch, before it predicts."""
        belief, (_, hierarchy, rates, _) = self.before(name, epoch).belief, self.at(epoch)
        if name == hierarchy.world or not self.is_turn(name, epoch):
            return belief
        observations: Elements = ()
        for lower in hierarchy.below(name):
            if (lower, name) not in rates.gathers:
                observations += self.observed(lower, name, epoch)
                continue
            last = max(self.turns(name, epoch - 1), default=0)
            first = max(last + 1, self.since(epoch, lower, name, "gather"))
            for gathered in [each for each in self.turns(lower, epoch) if each >= first]:
                observations += tuple((gathered, element) for element in self.observed(lower, name, gathered))
        return hierarchy.bound[name].observe(epoch, self.time_s(epoch), observations, belief)

    def observed(self, lower: str, upper: str, epoch: int) -> Elements:
        """What φ of an edge gives in an epoch."""
        sense = self.at(epoch).hierarchy.bound_edges[lower, upper].sense
        return () if sense is None else sense.elements(epoch, self.time_s(epoch), self.sensed(lower, epoch))

    def counting(self, lower: str, upper: str, epoch: int, under: int = 0) -> int:
        """The epoch in which the upper node said what counts at the lower one; 0: none. `under`: by the rates of which
        epoch, when nothing later was said; by default of this one."""
        under = under or epoch
        delay = self.at(under).rates.delays.get((lower, upper), 0)
        first = self.since(under, lower, upper, "rates")
        said = [turn for turn in self.turns(upper, under) if first <= turn <= epoch - delay]
        if said:
            return max(said)
        if first == self.since(under, lower, upper, "edge"):
            return 0
        return self.counting(lower, upper, first, first - 1)

    def from_above(self, name: str, epoch: int, kind: str) -> Elements:
        """Tasks or context that count at a node in an epoch."""
        elements: Elements = ()
        for upper in self.at(epoch).hierarchy.above(name):
            said = self.counting(name, upper, epoch)
            function = getattr(self.at(said).hierarchy.bound_edges[name, upper], kind) if said else None
            if function is not None:
                state = self.after(upper, said)
                argument = state.actions if kind == "task" else state.belief
                elements += function.elements(said, self.time_s(said), argument)
        return elements

    def digest(self, name: str, epoch: int) -> bytes:
        """The digest of a node after its last turn up to an epoch; there is none before its first one."""
        came = epoch
        while came > 1 and name in self.at(came - 1).hierarchy.nodes:
            came -= 1
        turn = max(self.turns(name, epoch), default=0)
        if turn < came:
            return NO_DIGEST
        heard = [(upper, self.counting(name, upper, turn)) for upper in self.at(turn).hierarchy.above(name)]
        digests = [self.digest(upper, said) if said else NO_DIGEST for upper, said in heard]
        return node_digest(encode_state(*self.after(name, turn)), digests)
