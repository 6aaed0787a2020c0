"""The formal order of hierarchies with rates: which nodes do an epoch, and of which epochs their inputs are.

The rules are those of `hierax.runtime.recording.check`; each fault is a rule and what breaks it, in words."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf

from hierax.schemas.limits import MAX_EPOCHS_APART
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.rates import Rates
from hierax.schemas.roster import Roster
from hierax.schemas.steps import NodeStep

Fault = tuple[str, str]
Place = Callable[[bool, str, str, int], int | None]
"""When a node's port saw a message, by whether it went out, kind, peer and epoch; None: it has not."""

Said = Callable[[str, str, str, int], tuple[int, bytes, bool] | None]
"""Of a message, by kind, sender, receiver and epoch, a checksum, its digest, and whether it holds nothing."""


@dataclass(frozen=True)
class RatedTurn:
    """A node's step, and what it has to hear and to say by the rates of its roster."""

    step: NodeStep
    roster: Roster
    previous: int  # the node's turn before; 0: there was none

    @property
    def _rates(self) -> Rates:
        return self.roster.rates or Rates()

    def passed(self) -> range:
        """The epochs since the node's last turn, up to this one."""
        return range(max(self.previous, self.step.epoch - MAX_EPOCHS_APART) + 1, self.step.epoch + 1)

    def turn_faults(self, told: int) -> Iterator[Fault]:
        """TURN; `told`: the epoch of the step before this one, of the same process; 0: there was none."""
        name, epoch = self.step.name, self.step.epoch
        if not self._rates.takes_part(name, epoch):
            yield "TURN", f"{name} took part, and it is not its turn"
        elif told and self.previous and told < self.previous:
            yield "TURN", f"{name} took part in epoch {told} before, and not in epoch {self.previous}"

    def input_faults(self) -> Iterator[Fault]:
        """EPOCH, but for what is gathered."""
        step, roster = self.step, self.roster
        expected = {(peer, kind): [epoch] for kind, peer, epoch in self._from_above()}
        for lower in roster.below(step.name):
            if (lower, step.name) not in self._rates.gathers:
                expected[lower, OBSERVATIONS] = [step.epoch]
        used = self._used()
        for (peer, kind), epochs in sorted(expected.items()):
            if used.get((peer, kind), []) != epochs:
                yield "EPOCH", f"{step.name} used {kind} of {peer} {_of(used.get((peer, kind), []))}, not {_of(epochs)}"

    def gathering_faults(self, said: Said) -> Iterator[Fault]:
        """EPOCH, of what is gathered, where all messages are recorded."""
        name, used = self.step.name, self._used()
        for lower in self.roster.below(name):
            if (lower, name) not in self._rates.gathers:
                continue
            epochs = [epoch for epoch in self.passed() if epoch >= self._rates.since(lower, name)]
            messages = {epoch: said(OBSERVATIONS, lower, name, epoch) for epoch in epochs}
            got = used.get((lower, OBSERVATIONS), [])
            wanted = [epoch for epoch in epochs if epoch in got or self._rates.is_sensed(lower, name, epoch)]
            if any(messages[epoch] is None for epoch in wanted):
                continue
            expected = [epoch for epoch, message in messages.items() if message is not None and not message[2]]
            if got != expected:
                yield "EPOCH", f"{name} gathered obs of {lower} {_of(got)}, not {_of(expected)}"

    def order_faults(self, place: Place, epochs: Sequence[int], after: int) -> Iterator[Fault]:
        """ALL, SENSE, UP and PREDICT, of these epochs; up to the epoch `after` its port saw what nobody recorded."""
        step, roster = self.step, self.roster
        last_up, first_down = 0.0, inf
        for epoch in epochs:
            ups = {upper: place(True, OBSERVATIONS, upper, epoch) for upper in self._neighbours(epoch, upward=True)}
            lacking = [f"{OBSERVATIONS} to {upper}" for upper, at in ups.items() if at is None]
            if lacking:
                yield "ALL", f"{step.name} has not sent {', '.join(lacking)} of epoch {epoch}"
            first_up = min((at for at in ups.values() if at is not None), default=inf)
            last_up = max((at for at in ups.values() if at is not None), default=0)
            for lower in self._neighbours(epoch, upward=False):
                received = place(False, OBSERVATIONS, lower, epoch)
                if received is None or received > first_up:
                    yield "SENSE", f"{step.name} sent observations of epoch {epoch} without those of {lower}"
        for lower in roster.below(step.name):
            for kind in (CONTEXT, *([TASKS] if (lower, step.name) in roster.tasking else [])):
                sent = place(True, kind, lower, step.epoch)
                if sent is None:
                    yield "ALL", f"{step.name} has not sent {kind} to {lower}"
                first_down = min(first_down, inf if sent is None else sent)
        if first_down < last_up:
            yield "UP", f"{step.name} sent something down before its observations had all gone up"
        for kind, upper, epoch in self._from_above():
            received = place(False, kind, upper, epoch)
            if epoch > after and (received is None or received > first_down):
                yield "PREDICT", f"{step.name} predicted without {kind} of {upper} of epoch {epoch}"

    def contexts(self) -> Sequence[tuple[str, int]]:
        """The upper neighbours, by name, and the epochs whose context counts; 0: none yet."""
        return [(upper, epoch) for kind, upper, epoch in self._from_above() if kind == CONTEXT]

    def _from_above(self) -> list[tuple[str, str, int]]:
        name, roster, found = self.step.name, self.roster, []
        for upper in roster.above(name):
            epoch = self._rates.in_force(name, upper, self.step.epoch)
            kinds = (CONTEXT, *([TASKS] if (name, upper) in roster.tasking else []))
            found += [(kind, upper, epoch) for kind in kinds]
        return found

    def _neighbours(self, epoch: int, upward: bool) -> list[str]:
        """Those above that are told of an epoch, or those below, where the node is."""
        name, rates, is_turn = self.step.name, self._rates, epoch == self.step.epoch
        if not is_turn and epoch < rates.latest:
            return []  # by the rates of another roster
        if upward:
            return [upper for upper in self.roster.above(name) if rates.is_told(upper, epoch)]
        return list(self.roster.below(name)) if is_turn or rates.is_told(name, epoch) else []

    def _used(self) -> Mapping[tuple[str, str], list[int]]:
        used: dict[tuple[str, str], list[int]] = {}
        for sender, kind, epoch, _ in self.step.used:
            used.setdefault((sender, kind), []).append(epoch)
        return used


def previous_turn(rosters: Mapping[int, Roster], step: NodeStep) -> int:
    """The turn of a node before its step, by the rosters up to the step's, by version; 0: there was none."""
    epoch = step.epoch - 1
    for version in sorted((version for version in rosters if version <= step.roster), reverse=True):
        rates = rosters[version].rates
        if rates is None or step.name not in rosters[version].nodes:
            return 0
        turn = rates.last_turn(step.name, epoch)
        since = rates.timing.since.get(step.name)
        if turn or since is None:
            return turn
        epoch = min(epoch, since - 1)
    return 0


def _of(epochs: Sequence[int]) -> str:
    if epochs == [0]:
        return "of no epoch"
    return f"of epoch{'s' * (len(epochs) > 1)} {', '.join(map(str, epochs))}" if epochs else "of no epoch"
