"""What nodes have told last, where they do not tell something in every epoch."""

from hierax.runtime.core.process import ActiveNode
from hierax.runtime.recording.trace import EpochTrace, NodeTrace
from hierax.schemas.rates import Rates
from hierax.schemas.roster import Roster


class LastTold:
    """With rates: each node's state, which stays as it was told until its next turn; none of who was replaced since."""

    def __init__(self) -> None:
        self.states: dict[str, NodeTrace] = {}  # by name
        self._epoch = self._first = 0
        self._roster: Roster | None = None

    def begin(self, recorded: EpochTrace) -> None:
        """An epoch begins; what was told before one that lacks is of no use."""
        roster, before = recorded.roster, self._roster
        if recorded.epoch != self._epoch + 1:
            self.states, self._first = {}, recorded.epoch
        elif before is not None and before.version != roster.version:
            same = {name for name, node in before.nodes.items() if roster.nodes.get(name) == node}
            self.states = {name: trace for name, trace in self.states.items() if name in same}
        self._epoch, self._roster = recorded.epoch, roster

    def end(self, recorded: EpochTrace) -> None:
        """An epoch ends."""
        if recorded.roster.rates is not None:
            self.states.update({**recorded.begun, **recorded.nodes})

    def state_of(self, name: str) -> ActiveNode | None:
        """A node's state; None: it has told none."""
        return self.states[name].state if name in self.states else None

    def knows(self, name: str) -> bool:
        """Whether a node's state before the epoch is known: what it told in its last turn, or the initial one."""
        rates = Rates() if self._roster is None or self._roster.rates is None else self._roster.rates
        turn, told = rates.last_turn(name, self._epoch - 1), self.states.get(name)
        if told is not None:
            return told.step.epoch >= turn
        return turn == 0 and self._first <= rates.timing.since.get(name, self._first)


def is_another(recorded: EpochTrace, before: NodeTrace, name: str) -> bool:
    """Whether a node was replaced by its like: unlike a process that comes back it began with another state."""
    if name in recorded.begun:
        return recorded.begun[name].step.state != before.step.state
    start = recorded.nodes[name].step.start if name in recorded.nodes else b""
    return bool(start) and start != before.step.state
