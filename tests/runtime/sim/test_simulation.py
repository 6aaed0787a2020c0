"""Some hundred seeds of all faults; the simulator itself: deterministic, and it shrinks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from typing import cast, get_args
from unittest.mock import Mock

import pytest
from support.mutations import MUTATIONS
from support.sweep import examples

from hierax.runtime.commands.main import main
from hierax.runtime.engine.engine import Engine
from hierax.runtime.engine.table import Verdict
from hierax.runtime.owner import planning
from hierax.runtime.owner.members import Plan
from hierax.runtime.sim.campaign import Scenarios, Summary, fails, shrink, simulate_many, simulate_quietly
from hierax.runtime.sim.scenario import CONTRADICT, DAMAGE, FAULTS, Scenario, draw_scenario
from hierax.runtime.sim.simulation import simulate
from hierax.schemas.control import Control

SEEDS = examples(150, 300)


def test_nothing_is_wrong_under_any_faults() -> None:
    summary = simulate_many(range(SEEDS))
    assert not summary.violations, summary.violations[:5]
    assert not summary.unreached()
    assert summary.epochs > 5 * SEEDS
    assert summary.answers["made"] > SEEDS // 5


def test_nothing_is_wrong_with_rates_and_delays() -> None:
    summary = simulate_many(range(2 * SEEDS), Scenarios(rated=True))
    assert not summary.violations, summary.violations[:5]
    assert set(summary.unreached(rated=True)) <= {"word Fetch"}, "which is seldom"
    assert summary.epochs > 8 * SEEDS


@pytest.mark.parametrize(
    "seed",
    [
        3,  # what nobody will say any more by the rates of before does not count
        43,  # an older checkpoint stands in for one that was damaged, and what it lacks is gone
        146,  # who is lost, and is to be detached, is waited for
        345,  # what is handed over is of no attempt
        1312,  # a version that leaves a node's rates, after one that changed them
        1604,  # who comes is prepared for two versions
    ],
)
def test_what_simulations_with_rates_have_found_holds(seed: int) -> None:
    assert not simulate_quietly(Scenarios(rated=True).draw(seed)).violation


def test_damage_that_cannot_be_mended_with_rates_is_said() -> None:
    result = simulate_quietly(Scenarios(rated=True).draw(43))
    assert re.fullmatch(r".*goes on after epoch 10, and was further when it said so last.*", result.stopped)


@pytest.mark.parametrize("rated", [False, True])
def test_nothing_is_wrong_where_a_dropped_version_is_followed_by_a_new_number(
    monkeypatch: pytest.MonkeyPatch, rated: bool
) -> None:
    monkeypatch.setattr(planning, "MAX_DROPPED", 1)
    renewed: list[int] = []
    take_effect = planning.Planning.take_effect

    def note(self: planning.Planning, plan: Plan) -> None:
        take_effect(self, plan)
        if not plan.requests and not plan.back and self.members.roster.version == plan.version:
            renewed.append(plan.version)

    monkeypatch.setattr(planning.Planning, "take_effect", note)
    for seed in (309, 380, 473, 496):  # in each of them, with rates or without, a change is dropped
        assert not simulate_quietly(Scenarios(rated=rated).draw(seed)).violation
    assert len(renewed) >= 4


@pytest.mark.parametrize("kind", FAULTS)
def test_nothing_is_wrong_under_faults_of_one_kind(kind: str) -> None:
    summary = simulate_many(range(1000, 1020), Scenarios((kind,)))
    assert not summary.violations, summary.violations[:5]
    assert all(not count for fault, count in summary.kinds["fault"].items() if fault != kind)
    if kind not in (DAMAGE, CONTRADICT):
        assert not summary.stopped


@pytest.mark.parametrize(
    ("seed", "why"),
    [
        (3206, "somebody else has sent it observations"),  # lost after an attempt that nobody has begun
        (6550, "somebody else has sent it observations"),
        (5933, "say different things"),  # two observations, of which an operator raised
        (6815, "say different things"),  # two tasks
        (14971, "not started again"),  # a node is given up, and the world's process dies before it heard that
    ],
)
def test_what_cannot_be_mended_is_said(seed: int, why: str) -> None:
    result = simulate_quietly(draw_scenario(seed))
    assert not result.violation
    assert why in result.stopped


def test_a_kind_that_no_seed_has_reached_fails_a_campaign(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["sim", "--seeds", "0:3", "--jobs", "1"]) == 0, "so few seeds may miss some"
    assert " Unchanged " in capsys.readouterr().out
    monkeypatch.setattr("hierax.runtime.commands.sim.ENOUGH", 3)
    assert main(["sim", "--seeds", "0:3", "--jobs", "1"]) == 1
    assert "no seed has reached" in capsys.readouterr().err
    assert main(["sim", "--seeds", "0:3", "--jobs", "1", "--faults", "crash"]) == 0, "some are not wanted"


class _EnoughError(Exception):
    pass


class _ManySeeds:
    """More seeds than there is memory for; not many may be asked for."""

    def __init__(self) -> None:
        self.asked = 0

    def __len__(self) -> int:
        return 10**11

    def __getitem__(self, part: slice) -> range:
        self.asked += 1
        assert self.asked < 100
        return range(part.start, part.start + 1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_seeds_are_given_out_as_they_are_needed(jobs: int) -> None:
    def stop(_: Summary) -> None:
        raise _EnoughError

    with pytest.raises(_EnoughError):
        simulate_many(cast(range, _ManySeeds()), jobs=jobs, progress=stop)


def test_kinds_are_those_of_the_types() -> None:
    told = simulate_many(range(1)).kinds
    assert {*told["order"], *told["word"]} == {kind.__name__ for kind in get_args(Control)}
    assert list(told["verdict"]) == [verdict.name for verdict in Verdict]
    assert list(told["fault"]) == list(FAULTS)


def test_without_faults_all_epochs_are_committed() -> None:
    for seed in range(40):
        scenario = draw_scenario(seed, ())
        result = simulate_quietly(scenario)
        assert not result.violation
        assert result.epochs == scenario.epochs


def test_a_seed_fixes_everything() -> None:
    traces: list[list[str]] = [[], []]
    results = [simulate(draw_scenario(7), trace) for trace in traces]
    assert traces[0] == traces[1]
    assert results[0] == results[1]
    other: list[str] = []
    simulate(draw_scenario(8), other)
    assert other != traces[0]


def test_a_seed_fixes_everything_whatever_order_sets_have() -> None:
    """In seed 121 two nodes come back at once, and are detached again."""
    command = [sys.executable, "-m", "hierax.runtime.commands.entry", "sim", "--seeds", "121", "--trace"]
    traces = [
        subprocess.run(command, env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=False).stdout
        for seed in ("0", "1")
    ]
    assert b"is detached from epoch 1 on" in traces[0]
    assert traces[0] == traces[1]


def test_the_work_can_be_shared() -> None:
    assert simulate_many(range(40), jobs=2).plain() == simulate_many(range(40)).plain()


def test_what_fails_is_made_small() -> None:
    with MUTATIONS["wrong belief rolled back"]():
        scenario = next(each for each in map(draw_scenario, range(100)) if fails(each))
        small = shrink(scenario, fails)
        assert fails(small)
    assert not fails(small), "it fails without the mistake, too"
    assert _size(small) < _size(scenario)
    assert len(small.faults) <= 2


def test_shrinking_ends_where_nothing_smaller_fails() -> None:
    scenario = draw_scenario(3)
    assert shrink(scenario, lambda _: False) == scenario
    smallest = shrink(replace(scenario, epochs=9), lambda _: True)
    assert (smallest.epochs, smallest.faults, smallest.proposals, len(smallest.roster.nodes)) == (1, (), (), 1)


def test_the_command_prints_a_summary(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "--seeds", "0:20", "--faults", "crash,loss", "--jobs", "1", "--format", "json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["seeds"] == 20
    assert printed["violations"] == []
    assert {kind for kind, count in printed["kinds"]["fault"].items() if count} == {"crash", "loss"}
    assert printed["epochs"] > 100


def test_the_command_shows_what_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with MUTATIONS["wrong belief rolled back"]():
        assert main(["sim", "--seeds", "0:10", "--jobs", "1"]) == 1
        printed = capsys.readouterr().out
        seed = next(line for line in printed.splitlines() if line.startswith("  seed ")).split()[1].rstrip(":")
        assert f"seed {seed}, made small" in printed
        assert main(["sim", "--seeds", seed, "--trace"]) == 1
    assert "owner begins" in capsys.readouterr().out


def test_production_code_that_raises_whatever_is_a_violation_of_its_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    for error in (TypeError("planted"), ZeroDivisionError("planted"), AssertionError("planted")):
        monkeypatch.setattr(Engine, "_begin", Mock(side_effect=error))
        assert simulate_many(range(2)).violations == [(seed, f"{type(error).__name__}: planted") for seed in range(2)]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--seeds", "1:x"], "--seeds 1:x: expected two whole numbers"),
        (["--seeds", "4:4"], "--seeds 4:4: expected numbers from 0"),
        (["--faults", "crahs"], "there is no 'crahs'; did you mean 'crash'"),
        (["--rates", "--faults", "crash,raise"], "--faults: 'raise' cannot occur with --rates"),
        (["--seeds", "0:5", "--trace"], "--trace: expected a single seed"),
        (["--seeds", "3", "--trace", "--format", "json"], "--trace: it is printed as text"),
        (["--seeds", f"{10**22}:{10**28}"], "expected numbers below 9223372036854775807"),
    ],
)
def test_the_command_says_what_it_expects(arguments: list[str], what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", *arguments]) == 1
    assert what in capsys.readouterr().err


def _size(scenario: Scenario) -> int:
    return len(scenario.faults) + len(scenario.proposals) + scenario.epochs + len(scenario.roster.nodes)
