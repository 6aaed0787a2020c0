"""Hierarchies with rates whose rosters change: the formal model and the direct implementation come to the same."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.direct import Direct, Period
from support.sweep import examples

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import NO_DIGEST, encode_state
from hierax.runtime.core.hierarchy import Hierarchy
from hierax.runtime.core.process import ActiveNode
from hierax.runtime.core.unrolled import Unrolled, unrolled_update
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.owner import roster_changes
from hierax.runtime.owner.roster_changes import ChangeError, next_roster
from hierax.runtime.sim.nodes import MODULE
from hierax.runtime.sim.rated import rated, with_rates
from hierax.runtime.sim.scenario import draw_change, draw_scenario
from hierax.schemas.rates import EdgeRates, Rates, Timing, Turns
from hierax.schemas.roster import Change, Replace, Roster

EPOCHS = 16
CHANGES = 4


def built(roster: Roster, seed: int) -> Hierarchy:
    return build_hierarchy(roster, OperatorSetting(seed), Allowance((MODULE,)))


def rates_in(roster: Roster) -> Rates:
    assert roster.rates is not None
    return roster.rates


def periods(seed: int) -> list[tuple[int, Roster]]:
    """A hierarchy at first, and what it is from some epochs on: nodes come, go and have others in their places."""
    rng, roster = random.Random(f"{seed}/changes"), with_rates(draw_scenario(seed)).roster
    found = [(1, roster)]
    for epoch in sorted(rng.sample(range(2, EPOCHS), CHANGES)):
        try:
            change = _that_can_go_on(rated(rng, draw_change(rng, sorted(roster.nodes), epoch)))
            roster = next_roster(roster, change).as_of(epoch)
        except ChangeError:
            continue
        found.append((epoch, roster))
    return found


def _that_can_go_on(change: Change) -> Change:
    """The same with a node that has all policies in another one's place: else it may be refused, as one that nobody
    above gives tasks any more keeps the policy that it had."""
    if not isinstance(change, Replace):
        return change
    reference = change.reference
    return replace(change, reference=replace(reference, parameters={**reference.parameters, "policies": 3}))


def begun(name: str, before: Roster, after: Roster, now: Hierarchy, states: dict[str, ActiveNode]) -> ActiveNode:
    """The state in which a node begins the first epoch under a roster."""
    node = now.nodes[name]
    if name not in before.nodes:
        return ActiveNode(node.initial_belief(), node.initial_policy)
    if before.instance(name) == after.instance(name):
        return states[name]
    return states[name]._replace(belief=node.take_over(states[name].belief))


def check(seed: int) -> None:
    """Raises `AssertionError` where the formal model says something else than the direct implementation."""
    rosters = periods(seed)
    hierarchies = [built(roster, seed) for _, roster in rosters]
    later = []
    for (_, before), (first, roster), hierarchy in zip(rosters, rosters[1:], hierarchies[1:], strict=False):
        kept = before.nodes.keys() & roster.nodes.keys()
        replaced = frozenset(name for name in kept if before.instance(name) != roster.instance(name))
        later.append(Period(first, hierarchy, rates_in(roster), replaced))
    direct = Direct(hierarchies[0], rates_in(rosters[0][1]), *later)
    now = Unrolled.initial(hierarchies[0], rates_in(rosters[0][1]))
    for epoch in range(1, EPOCHS + 1):
        for index, (first, roster) in enumerate(rosters):
            if first == epoch > 1:
                before, hierarchy = rosters[index - 1][1], hierarchies[index]
                states = dict(now.active.states)
                states = {name: begun(name, before, roster, hierarchy, states) for name in roster.nodes}
                now = now.under(hierarchy, rates_in(roster), states)
        now = unrolled_update(now)
        for name, state in now.active.states.items():
            assert encode_state(*state) == encode_state(*direct.after(name, epoch)), (name, epoch)
            assert now.digests.get(name, NO_DIGEST) == direct.digest(name, epoch), (name, epoch)


@settings(max_examples=examples(30, 1000), deadline=None)
@given(st.integers(0, 2**32))
def test_what_counts_when_rosters_change_is_what_the_direct_implementation_says(seed: int) -> None:
    check(seed)


def _as_if_still_done(former: EdgeRates, epoch: int) -> int:
    return Turns(former.every, former.offset).last(epoch - former.delay)


MISTAKES: dict[str, tuple[Any, str, Any]] = {
    "what counted before a change counts no more": (EdgeRates, "last", lambda *_: 0),
    "what would have been said by the old rates counts": (EdgeRates, "last", _as_if_still_done),
    "rates that change count for what was said before": (Timing, "as_of", lambda *_: Timing()),
    "a change of rates is none": (roster_changes, "_with_timing", lambda old, new, *_: replace(new, timing=old.timing)),
}
"""In what rates mean when rosters change; each has to be found."""


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_is_found(mistake: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*MISTAKES[mistake])
    with pytest.raises(AssertionError):
        deque(map(check, range(200)), maxlen=0)
