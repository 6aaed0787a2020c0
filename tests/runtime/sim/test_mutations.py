"""Every mistake that is made on purpose shows in the simulation, at the seed that the docs name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.mutations import MUTATIONS, scenario_of

from hierax.runtime.sim.campaign import simulate_quietly

PAGE = Path(__file__).parents[3] / "docs" / "simulation.md"
SEEDS = {
    name: int(seed) for name, seed in re.findall(r"\| ([^|]+) \| (\d+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
}


def test_the_docs_name_all() -> None:
    assert SEEDS.keys() == MUTATIONS.keys()


@pytest.mark.parametrize("name", SEEDS)
def test_a_mutation_is_caught(name: str) -> None:
    scenario = scenario_of(name, SEEDS[name])
    with MUTATIONS[name]():
        violation = simulate_quietly(scenario).violation
    assert violation, f"seed {SEEDS[name]} does not notice it any more: `make mutations`"
    assert not simulate_quietly(scenario).violation
