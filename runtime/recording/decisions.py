"""What nodes would have done: where policies and actions of a replay are others than those that were recorded.

A replay with other parameters, or another class, in a node's place is a counterfactual: what would it have done with
what the node was given then? The world and the other nodes give what they gave, whatever it decides."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from hierax.runtime.core.difference import first_unlike
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.recording.replayed_epoch import ReplayedEpoch


class Decision(NamedTuple):
    """What a node does in an epoch."""

    policy: str
    actions: Elements


class Stretch(NamedTuple):
    """Epochs in a row in which a node would have done the same one thing in place of the same other one."""

    node: str
    first: int
    last: int
    recorded: Decision
    replayed: Decision

    @property
    def epochs(self) -> int:
        return self.last - self.first + 1


@dataclass
class Decisions:
    """Where the decisions of a replay's live nodes are others than those recorded."""

    tolerance: float = 0.0  # of numbers, as `first_unlike` has it
    compared: dict[str, int] = field(default_factory=dict)  # of each node, in how many epochs both are known
    stretches: list[Stretch] = field(default_factory=list)  # in the order in which they begin

    def __post_init__(self) -> None:
        self._open: dict[str, int] = {}  # of each node, at which index a stretch is that may go on

    def gather(self, epochs: Iterable[ReplayedEpoch]) -> None:
        """Compare the nodes that are done again, epoch by epoch."""
        for epoch in epochs:
            for name in sorted(epoch.states):
                recorded = epoch.recorded.state_of(name)
                if recorded is not None:
                    self._compare(epoch.epoch, name, recorded, epoch.states[name])

    def otherwise(self, node: str) -> int:
        """In how many epochs a node would have done something else."""
        return sum(stretch.epochs for stretch in self.stretches if stretch.node == node)

    def _compare(self, epoch: int, name: str, recorded: ActiveNode, replayed: ActiveNode) -> None:
        self.compared[name] = self.compared.get(name, 0) + 1
        was, would = (Decision(state.policy, state.actions) for state in (recorded, replayed))
        index = self._open.pop(name, None)
        if self._alike(was, would):
            return
        if index is None or not self._goes_on(self.stretches[index], epoch, was, would):
            index = len(self.stretches)
            self.stretches.append(Stretch(name, epoch, epoch, was, would))
        self.stretches[index] = self.stretches[index]._replace(last=epoch)
        self._open[name] = index

    def _goes_on(self, stretch: Stretch, epoch: int, was: Decision, would: Decision) -> bool:
        follows = stretch.last == epoch - 1
        return follows and self._alike(stretch.recorded, was) and self._alike(stretch.replayed, would)

    def _alike(self, a: Decision, b: Decision) -> bool:
        return first_unlike(tuple(a), tuple(b), "", self.tolerance) is None
