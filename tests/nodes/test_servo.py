"""Visual servoing: the printed equations, and the figures over 200 seeds."""

from __future__ import annotations

import importlib
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hierax.nodes.servo import CameraNode, Course, MeasuredPosition, MotionNode, SlidingWorld, position_on
from hierax.runtime import Tick
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.process import ActiveHierarchy, update
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.loading.loader import build_hierarchy

FILE = Path(__file__).parents[2] / "deploy" / "servo.yaml"
K, DT = 8.49, 0.05
SEEDS = range(200)


def run(context: bool, seed: int, epochs: int = 60, noise: float = 0.1) -> list[ActiveHierarchy]:
    overrides = [f"context={str(context).lower()}", f"noise={noise}"]
    deployment = read_deployment(FILE, overrides)
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(seed=seed), deployment.allowance)
    states = [ActiveHierarchy.initial(hierarchy)]
    for _ in range(epochs):
        states.append(update(states[-1]))
    return states


def metrics(active: ActiveHierarchy) -> dict[str, float]:
    return dict(active.hierarchy.world_node.metrics(active.states["world"].belief))


def all_metrics(context: bool) -> dict[str, np.ndarray]:
    """The metrics of 60 epochs for every seed; what does not depend on the seed is read once."""
    deployment = read_deployment(FILE, [f"context={str(context).lower()}"])
    found = []
    for seed in SEEDS:
        active = ActiveHierarchy.initial(
            build_hierarchy(deployment.roster, OperatorSetting(seed=seed), deployment.allowance)
        )
        for _ in range(60):
            active = update(active)
        found.append(metrics(active))
    return {name: np.array([one[name] for one in found]) for name in found[0]}


def test_all_that_the_file_names_can_be_imported() -> None:
    names = re.findall(r"hierax[\w.]*:\w+", FILE.read_text())
    assert isinstance(yaml.safe_load(FILE.read_text()), dict)
    assert names
    for name in names:
        module, _, target = name.partition(":")
        assert callable(getattr(importlib.import_module(module), target)), name


@pytest.fixture(scope="module")
def figures() -> dict[bool, dict[str, np.ndarray]]:
    return {context: all_metrics(context) for context in (False, True)}


@pytest.mark.parametrize(("context", "mean", "spread"), [(False, 1.670, 0.012), (True, 0.030, 0.005)])
def test_the_mean_error_over_200_seeds(figures, context: bool, mean: float, spread: float) -> None:
    errors = figures[context]["tracking_error_mean"]
    assert errors.mean() == pytest.approx(mean, abs=0.002)
    assert errors.std(ddof=1) == pytest.approx(spread, rel=0.2)


@pytest.mark.parametrize(("context", "rms", "spread"), [(False, 1.989, 0.012), (True, 0.037, 0.006)])
def test_the_rms_error_over_200_seeds(figures, context: bool, rms: float, spread: float) -> None:
    errors = figures[context]["tracking_error_rms"]
    assert errors.mean() == pytest.approx(rms, abs=0.002)
    assert errors.std(ddof=1) == pytest.approx(spread, rel=0.2)


def test_context_takes_98_percent_off_the_error(figures) -> None:
    without, with_context = (figures[context]["tracking_error_mean"] for context in (False, True))
    assert 1 - with_context.mean() / without.mean() == pytest.approx(0.982, abs=0.002)
    assert (1 - with_context / without).min() > 0.94


@pytest.mark.parametrize("context", [False, True])
def test_it_is_what_the_printed_equations_give(context: bool) -> None:
    states = run(context, seed=11)
    y, x, v = 0.0, 0.0, 0.0
    errors = []
    for k, (before, after) in enumerate(itertools.pairwise(states), start=1):
        t = (k - 1) * DT
        tick = Tick(seed=11, subject="world->camera", operator="sense", epoch=k)
        seen = MeasuredPosition()(before.states["world"].belief, tick=tick)[0]
        y = 0.75 * y + 0.25 * seen
        commanded = y
        x, v = y + v * DT + 0.5 * K * DT**2, v + K * DT
        y = x if context else commanded
        errors.append(abs(0.5 * K * t**2 - commanded))
        assert after.states["camera"].actions == (pytest.approx(commanded, rel=1e-12),)
        assert after.states["camera"].belief["position"] == pytest.approx(y, rel=1e-12)
        assert after.states["motion"].belief == pytest.approx({"position": x, "velocity": v}, rel=1e-12)
        assert after.states["world"].actions == after.states["camera"].actions
        assert after.states["world"].belief["camera"] == pytest.approx(commanded, rel=1e-12)
    found = metrics(states[-1])
    assert found["tracking_error_mean"] == pytest.approx(np.mean(errors), rel=1e-12)
    assert found["tracking_error_rms"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-12)


def test_without_noise_context_makes_the_tracking_exact() -> None:
    assert metrics(run(True, seed=0, noise=0.0)[-1])["tracking_error_mean"] < 1e-12
    assert metrics(run(False, seed=0, noise=0.0)[-1])["tracking_error_mean"] > 1.5


def test_the_seed_decides_the_noise() -> None:
    first, again, other = (run(True, seed=seed, epochs=5)[-1].states["world"].belief for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_the_noise_is_normal_with_the_given_deviation() -> None:
    belief = SlidingWorld().initial_belief()
    ticks = [Tick(seed=4, subject="world->camera", operator="sense", epoch=epoch) for epoch in range(1, 2001)]
    draws = np.array([MeasuredPosition()(belief, tick=tick)[0] for tick in ticks])
    assert draws.mean() == pytest.approx(0.0, abs=0.01)
    assert draws.std() == pytest.approx(0.1, abs=0.006)


@pytest.mark.parametrize("noise", [-0.1, "much", float("nan"), None])
def test_a_noise_that_is_none_is_refused(noise: object) -> None:
    with pytest.raises(ValueError, match="noise: expected a number of metres"):
        MeasuredPosition(noise)


def test_time_begins_at_zero_and_steps() -> None:
    world = SlidingWorld()
    states = run(True, seed=0, epochs=3)
    assert [world.time_s(state.states["world"].belief, 1) for state in states] == [0.0, DT, 2 * DT, 3 * DT]


def test_no_metrics_before_the_first_epoch() -> None:
    world = SlidingWorld()
    assert world.metrics(world.initial_belief()) == {}


def test_without_observations_beliefs_stay() -> None:
    for node in (CameraNode(), MotionNode()):
        assert node.observe((), node.initial_belief()) == node.initial_belief()


def test_without_an_order_the_camera_holds() -> None:
    world = SlidingWorld()
    belief = {**world.initial_belief(), "camera": 2.0}
    assert world.select_policy(()) == world.initial_policy
    assert world.predict((), (), belief)["camera"] == 2.0


def test_a_commanded_position_arrives_to_the_bit() -> None:
    world = SlidingWorld()
    for command in (0.1 + 0.2, -1e-300, 36.789012345678901, 5e300):
        policy = world.policies()[world.select_policy((command,))]
        assert policy(world.initial_belief()) == (command,)


def test_there_are_no_other_policies() -> None:
    policies = SlidingWorld().policies()
    assert [name for name in ("jump 3", "move", "move there") if name in policies] == []


RATES = FILE.with_name("servo-rates.yaml")


def mean_error_m(*settings: str) -> float:
    report = single.run(read_deployment(RATES, settings), epochs=None, seed=5)
    return report.nodes["world"].metrics["tracking_error_mean"]


def test_below_a_slow_node_a_course_says_where_the_object_is_in_each_epoch() -> None:
    assert mean_error_m() < 0.05 < mean_error_m("context=false")
    assert mean_error_m("every=20", "turn=0.1", "delay=20", "horizon=0.2") < 0.05
    assert mean_error_m("horizon=0.005") > mean_error_m("context=false"), "it ends before what it says does"


def test_a_course_has_the_positions_at_the_end_of_each_epoch() -> None:
    motion, time_s = MotionNode(step_s=0.1), 0.3
    belief = motion.predict((), (), {"position": 0.5 * K * time_s**2, "velocity": K * time_s})
    (course,) = Course(step_s=0.02, horizon_s=0.2, turn_s=0.1)(belief, Tick(time_s=time_s))
    assert np.allclose(course["positions"], 0.5 * K * (time_s + 0.02 * np.arange(1, 11)) ** 2)
    for later, number in ((0, 0), (3, 3), (9, 9), (20, 9)):
        assert position_on(course, time_s + 0.02 * later) == course["positions"][number]


@pytest.mark.parametrize("make", [SlidingWorld, MotionNode])
def test_a_step_takes_time(make: type) -> None:
    with pytest.raises(ValueError, match="step_s: expected a number of seconds, more than 0, got 0"):
        make(step_s=0)
