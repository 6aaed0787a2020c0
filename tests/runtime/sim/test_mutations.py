"""Every mistake that is made on purpose shows in the simulation."""

from __future__ import annotations

import pytest
from support.mutations import MUTATIONS

from hierax.runtime.sim.campaign import simulate_quietly
from hierax.runtime.sim.scenario import draw_scenario

SEEDS = 2000


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_mutation_is_caught(name: str) -> None:
    with MUTATIONS[name]():
        for seed in range(SEEDS):
            violation = simulate_quietly(draw_scenario(seed)).violation
            if violation:
                print(f"{name}: caught at seed {seed}: {violation}")
                return
    pytest.fail(f"{name}: {SEEDS} seeds did not notice")
