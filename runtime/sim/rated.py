"""Simulations of hierarchies with rates: what is drawn of them, and what must hold there.

The checks apart from the states are left out where they are about attempts: of such an epoch has one only, and what a
node takes in may be of an earlier one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from random import Random

from hierax.runtime.core.digest import NO_DIGEST, DigestChain, encode_state
from hierax.runtime.core.elements import Elements
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.unrolled import Unrolled, unrolled_update
from hierax.runtime.sim.checker import Checker, End
from hierax.runtime.sim.inspection import Inspector, Turn
from hierax.runtime.sim.journal import FAULT, ORDER, VERDICT, WORD
from hierax.runtime.sim.scenario import FAULTS, RATED_FAULTS, Scenario
from hierax.schemas.messages import Header
from hierax.schemas.rates import EVERY_EPOCH, Pair, Rates, Turns
from hierax.schemas.roster import Change, Detach, Replace, Roster

MAX_EVERY, MAX_DELAY = 5, 6
NOT_WITH_RATES = frozenset(
    {
        (WORD, "Failed"),
        *((VERDICT, kind) for kind in ("INCOMPLETE", "AGAIN")),
        *((FAULT, kind) for kind in FAULTS if kind not in RATED_FAULTS),
    }
)
"""What cannot occur: no node fails alone, and an epoch has one attempt."""

ONLY_WITH_RATES = frozenset({(ORDER, "CatchUp"), (WORD, "CaughtUp")})
"""What only occurs there: nodes may be behind a world that has finished."""


def with_rates(scenario: Scenario) -> Scenario:
    """The same with rates, also of what is attached, and with other ones of some nodes that replace another."""
    rng, roster = Random(f"{scenario.seed}/rates"), scenario.roster
    sensed = [edge.pair for edge in roster.edges if edge.sense is not None]
    if Random(f"{scenario.seed}/end").random() < 0.5:
        roster = _ending(roster, scenario.epochs)
    rates = draw_rates(rng, sorted(roster.nodes.keys() - {roster.world}), list(roster.pairs), sensed)
    proposals = tuple(replace(each, change=rated(rng, each.change), alone=False) for each in scenario.proposals)
    roster = roster.with_rates(rates)
    return replace(scenario, roster=roster, proposals=proposals, on_loss={}, left_dead=frozenset(), trials_fail=False)


def _ending(roster: Roster, last: int) -> Roster:
    """The same with a world that finishes by itself, so that its last epoch is no drained one."""
    world = roster.nodes[roster.world]
    ends = replace(world, parameters={**world.parameters, "last": last})
    return replace(roster, nodes={**roster.nodes, roster.world: ends})


def rated(rng: Random, change: Change) -> Change:
    """A change with rates for what is new in it."""
    if isinstance(change, Replace):
        return replace(change, turns=_turns(rng)) if rng.random() < 0.6 else change
    if isinstance(change, Detach):
        return change
    edges = tuple(
        replace(edge, delay=_delay(rng), gather=edge.sense is not None and rng.random() < 0.3) for edge in change.edges
    )
    return replace(change, edges=edges, turns={name: _turns(rng) for name in sorted(change.nodes)})


def _turns(rng: Random) -> Turns:
    every = rng.choice((1, 1, rng.randint(2, MAX_EVERY)))
    return Turns(every, rng.randrange(every))


def _delay(rng: Random) -> int:
    return rng.randint(1, MAX_DELAY) if rng.random() < 0.5 else 0


def draw_rates(rng: Random, names: Sequence[str], pairs: Sequence[Pair], sensed: Sequence[Pair]) -> Rates:
    """Rates of some nodes but the world and of some edges, of which those that are sensed may gather; none at all where
    there is no such node."""
    turns = {name: drawn for name in names if (drawn := _turns(rng)) != EVERY_EPOCH}
    delays = {pair: delay for pair in pairs if (delay := _delay(rng))}
    gathers = frozenset(pair for pair in sensed if rng.random() < 0.3)
    rates = Rates(turns, delays, gathers, pairs=tuple(pairs))
    return rates if turns or delays or gathers else replace(rates, turns=dict.fromkeys(names[:1], Turns(2)))


class RatedChecker(Checker):
    """Follows a run with the formal core that is unrolled in time."""

    def __init__(self, scenario: Scenario, trace: Callable[[str], None]) -> None:
        super().__init__(scenario, trace)
        self._unrolled = [Unrolled.initial(self.hierarchy_of(scenario.roster), scenario.roster.rates or Rates())]

    def sends(self, header: Header) -> None:
        """Messages of an epoch may be said again."""
        if header.attempt:
            self.violate(f"attempt {header.attempt} of epoch {header.epoch}: with rates there is one")

    def starts(self, name: str, token: str, state: ActiveNode, turn: Turn) -> None:
        """Nodes begin epochs at different times."""

    def commits(self, turn: Turn, encoded: Mapping[str, bytes]) -> None:
        epoch, start = turn.epoch, self._starts[turn.epoch, turn.version]
        last, hierarchy = self._unrolled[epoch - 1], self.hierarchy_of(start.roster)
        if hierarchy is not last.active.hierarchy:
            last = last.under(hierarchy, start.roster.rates or Rates(), start.states)
        now = unrolled_update(last)
        self._unrolled[epoch:] = [now]
        states = now.active.states
        if epoch == self._scenario.epochs and not self._scenario.ends_itself:  # a drained one: all are done with it
            self._check_last(states, encoded)
        roster = start.roster
        chain = DigestChain(roster.content_hash(), epoch - 1, self._after(epoch - 1).digest)
        digest = chain.commit(epoch, now.digests.get(roster.world, NO_DIGEST))
        self._candidates[epoch] = End(epoch, roster, states, digest)

    def finishes(self, answers: Mapping[str, str], encoded: Mapping[str, bytes]) -> None:
        super().finishes(answers, encoded)
        self._check_last(self._ends[-1].states, encoded)

    def _check_last(self, states: Mapping[str, ActiveNode], encoded: Mapping[str, bytes]) -> None:
        for name in [] if self.excused else sorted(encoded):
            if encoded[name] != encode_state(*states[name]):
                self.violate(f"{name}: its state after the last epoch is not {states[name]}")


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
