"""Simulations of hierarchies with rates: what is drawn of them, and what must hold there.

The checks apart from the states are left out where they are about attempts: of such an epoch has one only, and what a
node takes in may be of an earlier one."""

from collections.abc import Callable, Mapping, Sequence
from random import Random

from hierax.runtime.core.digest import NO_DIGEST, DigestChain, encode_state
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.graph import Pair
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.rates import Rates, Turns
from hierax.runtime.core.unrolled import Unrolled, unrolled_update
from hierax.runtime.sim.checker import Checker, End
from hierax.runtime.sim.inspection import Inspector, Turn
from hierax.runtime.sim.journal import CHANGE, FAULT, KINDS, ORDER, VERDICT, WORD
from hierax.runtime.sim.scenario import FAULTS, RATED_FAULTS, Scenario
from hierax.schemas.messages import Header
from hierax.schemas.roster import Roster

MAX_EVERY, MAX_DELAY = 5, 6
NOT_WITH_RATES = frozenset(
    {
        *((ORDER, kind) for kind in ("HandOver", "TakeOver")),
        *((WORD, kind) for kind in ("State", "Taken", "Failed", "Propose")),
        *((VERDICT, kind) for kind in ("INCOMPLETE", "AGAIN")),
        *((CHANGE, kind) for kind in KINDS[CHANGE]),
        *((FAULT, kind) for kind in FAULTS if kind not in RATED_FAULTS),
    }
)
"""What cannot occur: nothing is changed, no node fails alone, and an epoch has one attempt."""


def rates_of(seed: int, roster: Roster) -> Rates:
    """The rates of a seed's scenario."""
    edges = roster.edges
    sensed = [edge.pair for edge in edges if edge.sense is not None]
    names = sorted(roster.nodes.keys() - {roster.world})
    return draw_rates(Random(f"{seed}/rates"), names, [edge.pair for edge in edges], sensed)


def draw_rates(rng: Random, names: Sequence[str], pairs: Sequence[Pair], sensed: Sequence[Pair]) -> Rates:
    """Rates of some nodes but the world and of some edges, of which those that are sensed may gather; none at all where
    there is no such node."""
    turns: dict[str, Turns] = {}
    for name in names:
        every = rng.choice((1, 1, rng.randint(2, MAX_EVERY)))
        if every > 1:
            turns[name] = Turns(every, rng.randrange(every))
    delays = {pair: rng.randint(1, MAX_DELAY) for pair in pairs if rng.random() < 0.5}
    gathers = frozenset(pair for pair in sensed if rng.random() < 0.3)
    return Rates(turns, delays, gathers) or Rates(dict.fromkeys(names[:1], Turns(2)))


class RatedChecker(Checker):
    """Follows a run with the formal core that is unrolled in time."""

    def __init__(self, scenario: Scenario, trace: Callable[[str], None]) -> None:
        super().__init__(scenario, trace)
        self._unrolled = [Unrolled.initial(self.hierarchy_of(scenario.roster), scenario.rates)]

    def sends(self, header: Header) -> None:
        """Messages of an epoch may be said again."""
        if header.attempt:
            self.violate(f"attempt {header.attempt} of epoch {header.epoch}: with rates there is one")

    def starts(self, name: str, token: str, state: ActiveNode, turn: Turn) -> None:
        """Nodes begin epochs at different times."""

    def commits(self, turn: Turn, encoded: Mapping[str, bytes]) -> None:
        epoch = turn.epoch
        while len(self._unrolled) <= epoch:
            self._unrolled.append(unrolled_update(self._unrolled[-1]))
        now = self._unrolled[epoch]
        states = now.active.states
        if epoch == self._scenario.epochs and not self.excused:  # a drained one: all are done with it
            for name in sorted(encoded):
                if encoded[name] != encode_state(*states[name]):
                    self.violate(f"{name}: its state after the last epoch is not {states[name]}")
        roster = self._starts[epoch, turn.version].roster
        chain = DigestChain(roster.content_hash(), epoch - 1, self._after(epoch - 1).digest)
        digest = chain.commit(epoch, now.digests.get(roster.world, NO_DIGEST))
        self._candidates[epoch] = End(epoch, roster, states, digest)


class Unlooked(Inspector):
    """Puts no tags on what goes into operators, and looks for none."""

    def tag(self, elements: Elements) -> Elements:
        return elements

    def observed(self, elements: Elements, senders: tuple[str, ...], version: int, epoch: int) -> Elements:
        return elements

    def acts(self) -> None:
        return

    def given(self, elements: Elements, senders: tuple[str, ...], what: str) -> Elements:
        return elements
