"""The process model with rates: one Update after another of a hierarchy that is unrolled in time.

Definition 6 for nodes that take part in some epochs only, and for edges whose context and tasks count some epochs
later. This is the reference, as `hierax.runtime.core.process.update` is without rates. What runs is
`hierax.runtime.engine.rated`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from hierax.runtime.core.binding import epoch_time_s
from hierax.runtime.core.digest import NO_DIGEST, encode_state, node_digest
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode, apply, check_orders, predict, sense
from hierax.schemas.rates import Pair, Rates


class Said(NamedTuple):
    """What an upper node predicted for a lower one."""

    epoch: int = 0  # when
    tasks: Elements = ()
    context: Elements = ()
    digest: bytes = NO_DIGEST  # of the upper node, after that epoch


NOTHING_SAID = Said()


@dataclass(frozen=True)
class Unrolled:
    """A hierarchy after some epochs, and what of it is under way in time."""

    active: ActiveHierarchy
    rates: Rates
    said: Mapping[Pair, tuple[Said, ...]] = field(default_factory=dict)  # by edge, oldest first: what may count yet
    gathered: Mapping[Pair, Elements] = field(default_factory=dict)  # by edge, since its upper node's last turn
    digests: Mapping[str, bytes] = field(default_factory=dict)  # of nodes, after their last turns

    @staticmethod
    def initial(hierarchy: Hierarchy, rates: Rates) -> "Unrolled":
        """Before the first epoch. Raises `OperatorError` if an `initial_belief` raised."""
        return Unrolled(ActiveHierarchy.initial(hierarchy), rates)

    def under(self, hierarchy: Hierarchy, rates: Rates, states: Mapping[str, ActiveNode]) -> "Unrolled":
        """The same under another roster, before its first epoch, in which its nodes are to begin in these states.

        What was said along an edge that stays counts until what is said under it does."""
        epoch = self.active.epoch
        staying = {pair for pair in hierarchy.bound_edges if rates.since(*pair) <= epoch}
        return Unrolled(
            ActiveHierarchy(hierarchy, MappingProxyType(dict(states)), epoch),
            rates,
            {pair: said for pair, said in self.said.items() if pair in staying},
            {pair: each for pair, each in self.gathered.items() if pair in staying & rates.gathers},
            {name: digest for name, digest in self.digests.items() if name in hierarchy.nodes},
        )


def unrolled_update(
    before: Unrolled, sensing_order: Sequence[str] | None = None, prediction_order: Sequence[str] | None = None
) -> Unrolled:
    """The next epoch. Arguments and errors are those of `hierax.runtime.core.process.update`."""
    hierarchy = before.active.hierarchy
    orders = check_orders(hierarchy, sensing_order, prediction_order)
    epoch = before.active.epoch + 1
    belief = before.active.states[hierarchy.world].belief
    time_s = epoch_time_s(hierarchy.world, hierarchy.world_node, belief, epoch)
    under_way = _Epoch(before, epoch, time_s)
    for name in orders[0]:
        under_way.sense(name)
    for name in orders[1]:
        under_way.predict(name)
    active = ActiveHierarchy(hierarchy, MappingProxyType(under_way.states), epoch)
    return Unrolled(active, before.rates, under_way.said, under_way.gathered, under_way.digests)


class _Epoch:
    """An epoch as it is done."""

    def __init__(self, before: Unrolled, epoch: int, time_s: float) -> None:
        self._hierarchy, self._rates = before.active.hierarchy, before.rates
        self._epoch, self._time_s = epoch, time_s
        self.states = dict(before.active.states)
        self.said = dict(before.said)
        self.gathered = dict(before.gathered)
        self.digests = dict(before.digests)

    def sense(self, name: str) -> None:
        """Definition 4 in the node's turns; what it has sensed is kept for those above that gather it."""
        hierarchy, rates, epoch = self._hierarchy, self._rates, self._epoch
        if rates.takes_part(name, epoch):
            observations = tuple(element for lower in hierarchy.below(name) for element in self._observed(lower, name))
            self.states[name] = sense(hierarchy.bound[name], self.states[name], observations, epoch, self._time_s)
        for upper in hierarchy.above(name):
            if (name, upper) in rates.gathers and rates.is_sensed(name, upper, epoch):
                made = tuple((epoch, element) for element in self._applied(name, upper))
                self.gathered[name, upper] = self.gathered.get((name, upper), ()) + made

    def _observed(self, lower: str, upper: str) -> Elements:
        if (lower, upper) in self._rates.gathers:
            return self.gathered.pop((lower, upper), ())
        return self._applied(lower, upper)

    def _applied(self, lower: str, upper: str) -> Elements:
        edge = self._hierarchy.bound_edges[lower, upper]
        return apply(edge.sense, self._epoch, self._time_s, self.states[lower].belief)

    def predict(self, name: str) -> None:
        """Definition 5 in the node's turns, with what is in force of those above."""
        if not self._rates.takes_part(name, self._epoch):
            return
        bound = self._hierarchy.bound[name]
        heard = [self._in_force(name, upper) for upper in bound.above]
        tasks = tuple(element for each in heard for element in each.tasks)
        context = tuple(element for each in heard for element in each.context)
        state = self.states[name] = predict(bound, self.states[name], tasks, context, self._epoch, self._time_s)
        self.digests[name] = node_digest(encode_state(*state), [each.digest for each in heard])
        for lower in bound.below:
            self._say(lower, name, state)

    def _in_force(self, lower: str, upper: str) -> Said:
        epoch = self._rates.in_force(lower, upper, self._epoch)
        return next((said for said in self.said.get((lower, upper), ()) if said.epoch == epoch), NOTHING_SAID)

    def _say(self, lower: str, upper: str, state: ActiveNode) -> None:
        edge, epoch, time_s = self._hierarchy.bound_edges[lower, upper], self._epoch, self._time_s
        tasks = apply(edge.task, epoch, time_s, state.actions)
        context = apply(edge.context, epoch, time_s, state.belief)
        oldest = self._rates.in_force(lower, upper, epoch)
        kept = tuple(said for said in self.said.get((lower, upper), ()) if said.epoch >= oldest)
        self.said[lower, upper] = (*kept, Said(epoch, tasks, context, self.digests[upper]))
