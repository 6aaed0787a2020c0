"""What control points say is the slope of what they cost, and the same however many poses are tried at once."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, photograph
from support.drawn import BOXES, all_expected

from hierax.nodes.tracking.constants import MANY, USUAL_SHARPNESS
from hierax.nodes.tracking.estimation import equations as eqs
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.estimation.stages import Search, Stage, read_stage, views_of
from hierax.nodes.tracking.math.batched import exp_many
from hierax.nodes.tracking.math.geometry import Floats, exp_se3
from hierax.nodes.tracking.model.controls import gathered

SEED = 5
STEP = 1e-6
OFF = np.array([0.002, -0.001, 0.003, 0.01, -0.02, 0.01])


def one_stage(times: int = 1) -> tuple[Stage, Floats]:
    """What an image shows of two boxes, each so many times, from poses that are a little off."""
    items = all_expected(BOXES, [box.pose @ exp_se3(OFF) for box in BOXES]) * times
    image = smoothed(photograph(BOXES, 1.0, np.random.default_rng(SEED)))
    controls = gathered([item["controls"] for item in items])
    poses = np.stack([item["pose"] for item in items])
    memory = memory_of([item["slots"] for item in items], controls, image.shape[2])
    stage = read_stage(image, controls, poses, INTRINSICS, memory, 14, Search())
    assert stage is not None
    return stage, poses


def said(stage: Stage, poses: Floats, still: bool, told: Floats | None = None) -> tuple[eqs.Equations, eqs.Nearest]:
    seen = eqs.seen_from(poses, stage, np.zeros(len(stage.edges)))
    found = eqs.nearest(seen, stage, 14.0)
    weights = eqs.weights_of(stage, found, 14.0, Search())
    return eqs.equations(poses, stage, seen, found, weights, still, told), found


def cost(stage: Stage, found: eqs.Nearest, weights: Floats, poses: Floats) -> float:
    """Half of the weighted squares of residuals, of each edge at the place that is best for it."""
    places = stage.peaks.places.reshape(-1)[found.at].astype(np.float64)
    moved = eqs.seen_from(poses, stage, np.zeros(len(places))).moved
    residuals = np.where(weights > 0.0, moved - places, 0.0)
    pulls = np.bincount(stage.edges, weights=weights * residuals)
    wholes = np.bincount(stage.edges, weights=weights) + 1.0 / stage.spread**2
    return 0.5 * float((weights * residuals**2).sum() - (pulls**2 / wholes).sum())


@pytest.mark.parametrize("still", [True, False])
def test_gradients_are_the_slope_of_what_the_hypotheses_cost(still: bool) -> None:
    stage, poses = one_stage()
    told, found = said(stage, poses, still)
    seen = eqs.seen_from(poses, stage, np.zeros(len(stage.edges)))
    weights = eqs.weights_of(stage, eqs.nearest(seen, stage, 14.0), 14.0, Search())
    ways = np.concatenate((np.eye(6), -np.eye(6))) * STEP
    for at in range(len(poses)):
        costs = []
        for way in exp_many(ways):
            moved = poses.copy()
            moved[at] = poses[at] @ way
            costs.append(cost(stage, found, weights, moved))
        slope = (np.array(costs[:6]) - np.array(costs[6:])) / (2.0 * STEP)
        np.testing.assert_allclose(told.gradients[at, -6:], slope, rtol=1e-4, atol=1e-2 * np.abs(slope).max())
    if not still:
        costs = [cost(stage, found, weights, way @ poses) for way in exp_many(ways)]
        slope = (np.array(costs[:6]) - np.array(costs[6:])) / (2.0 * STEP)
        np.testing.assert_allclose(told.gradients[:, :6].sum(axis=0), slope, atol=1e-2 * np.abs(slope).max())


def test_a_known_camera_leaves_out_what_is_said_of_it_alone() -> None:
    stage, poses = one_stage()
    still, free = said(stage, poses, True)[0], said(stage, poses, False)[0]
    np.testing.assert_allclose(still.blocks, free.blocks[:, 6:, 6:], rtol=1e-12)
    np.testing.assert_allclose(still.gradients, free.gradients[:, 6:], rtol=1e-12)


def test_nothing_is_said_of_what_no_image_tells() -> None:
    stage, poses = one_stage()
    told = np.stack([np.diag([1.0] * 5 + [0.0])] * len(poses))
    found = said(stage, poses, True, told)[0]
    assert not found.blocks[:, 5].any()
    assert not found.gradients[:, 5].any()
    np.testing.assert_allclose(found.blocks[:, :5, :5], said(stage, poses, True)[0].blocks[:, :5, :5], rtol=1e-9)


def test_what_is_said_of_many_poses_at_once_is_what_is_said_of_each() -> None:
    times = MANY // len(BOXES) + 1
    (few, poses), (many, all_poses) = one_stage(), one_stage(times)
    assert len(all_poses) > MANY
    one, every = said(few, poses, True)[0], said(many, all_poses, True)[0]
    np.testing.assert_allclose(every.normal, np.tile(one.normal, (times, 1, 1)), rtol=1e-9, atol=1e-6)


def test_products_of_many_owners_of_whom_some_have_nothing() -> None:
    rng = np.random.default_rng(SEED)
    owners = np.sort(rng.integers(0, MANY, 200))
    left, right = rng.normal(size=(2, 7, 200))
    few = eqs.products(left, right, views_of(owners, MANY))
    at_once = eqs.products(left, right, views_of(owners, MANY + 2))  # the last two have none
    np.testing.assert_allclose(at_once[:MANY], few, atol=1e-12)
    assert not at_once[MANY:].any()


def test_edges_that_are_blurred_beside_the_others_of_their_object_lose_weight() -> None:
    stage, poses = one_stage()
    found = eqs.nearest(eqs.seen_from(poses, stage, np.zeros(len(stage.edges))), stage, 14.0)
    weights = eqs.weights_of(stage, found, 14.0, Search(blur_power=0.0))
    blurred = eqs.weights_of(stage, found, 14.0, Search(blur_power=1.0))
    sharp = stage.peaks.sharpness.reshape(-1)[found.at]
    for owner in range(len(poses)):
        means = []
        for line in np.nonzero((stage.controls.owners == owner) & (weights > 0.0))[0]:
            own = (stage.edges == stage.edges[line]) & (weights > 0.0)
            means.append((line, sharp[own].astype(np.float64).mean()))
        ascending = sorted(mean for _, mean in means)
        usual = ascending[int(USUAL_SHARPNESS * (len(ascending) - 1))]
        for line, mean in means:
            assert blurred[line] == pytest.approx(weights[line] * min(mean / usual, 1.0), rel=1e-5)
