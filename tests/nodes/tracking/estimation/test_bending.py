"""Edges that are not where a model has them: learned one by one, and how sure that is."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, photograph
from support.drawn import FIRST, expected

from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.estimation.bending import bent, slack_of
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.math.geometry import exp_se3, pose_error
from hierax.nodes.tracking.model.controls import gathered
from hierax.nodes.tracking.schema import Looks
from hierax.nodes.tracking.search.association import Estimate, Options, associate

MOTION = np.diag([0.01**2] * 3 + [0.06**2] * 3)
# The box that is seen is not as its model has it: its edges are 1 to 4 pixels beside the model's.
OTHER = FIRST._replace(size=tuple(side - loss for side, loss in zip(FIRST.size, (0.006, -0.003, 0.001), strict=True)))


def seen(tolerance: float | None, images: int, seed: int = 3) -> list[Estimate]:
    """One object in several images of another one, its first pose a little off."""
    rng = np.random.default_rng(seed)
    image = smoothed(photograph([OTHER], 2.0, rng))
    item = expected(FIRST, FIRST.pose @ exp_se3(np.array([0.002, -0.001, 0.002, 0.01, -0.01, 0.01])))
    item["status"] = "expected"
    estimates = []
    for _ in range(images):
        item["controls"] = bent(expected(FIRST, item["pose"])["controls"], item["slots"])
        found = associate(image, [item], None, INTRINSICS, Options(MOTION, 0.75, tolerance=tolerance))
        assert found is not None
        estimates.append(found.estimates[0])
        item |= {
            "pose": estimates[-1].pose,
            "before": estimates[-1].pose,
            "covariance": estimates[-1].covariance,
            "motion_scale": estimates[-1].motion_scale,
            "slots": estimates[-1].slots,
            "status": "tracked",
        }
    return estimates


@pytest.mark.parametrize("seed", range(2))
def test_an_imprecise_model_is_known_for_one_and_supported_from_the_first_image_on(seed: int) -> None:
    first, *later = seen(None, 4, seed)
    assert (first.slots["tolerance"] or 0.0) > 0.0, f"seed {seed}"
    assert min(each.score for each in (first, *later)) > 0.8, f"seed {seed}"
    assert max(pose_error(each.pose, first.pose)[0] for each in later) < 0.001, f"seed {seed}"
    told = seen(0.0, 1, seed)[0]
    assert told.slots["tolerance"] == 0.0
    assert first.score > told.score + 0.1, f"seed {seed}"


@pytest.mark.parametrize("seed", range(2))
def test_an_edge_that_is_missing_speaks_against_an_exact_model_but_hardly_against_an_imprecise_one(seed: int) -> None:
    """As where a bevel has taken it, or both of its faces look alike: what is right of the middle is painted over."""
    image = np.array(photograph([FIRST], 2.0, np.random.default_rng(seed)))
    middle = INTRINSICS[0] * FIRST.pose[0, 3] / FIRST.pose[2, 3] + INTRINSICS[2]
    image[:, int(middle) - 8 :] = 128
    nats = []
    for tolerance in (0.0, 0.0015):
        item = {**expected(FIRST, FIRST.pose), "status": "expected"}
        found = associate(smoothed(image), [item], None, INTRINSICS, Options(MOTION, 0.75, tolerance=tolerance))
        assert found is not None
        nats.append(found.estimates[0].nats)
    assert nats[0] < -5.0 < 0.0 < nats[1], f"seed {seed}"


def test_a_tolerance_that_is_given_is_kept_and_edges_become_sure() -> None:
    once, *_, often = (each.slots for each in seen(0.0015, 5))
    assert once["tolerance"] == often["tolerance"] == 0.0015
    assert len(often["bent"]) >= 7
    # along what the image shows of an edge it is known, across that it is not
    least, most = np.linalg.eigvalsh(often["slack"])[:, [0, -1]].T
    assert least.max() < 0.0004**2
    assert most == pytest.approx(0.0015**2, rel=1e-3)
    assert np.linalg.norm(often["bends"], axis=1).max() < 0.006


def test_exact_models_stay_as_they_are() -> None:
    controls = expected(FIRST, FIRST.pose)["controls"]
    assert bent(controls, NOTHING) is controls
    known: Looks = {
        **NOTHING,
        "tolerance": 0.0,
        "bent": controls["edges"][:1].astype(np.int64),
        "bends": np.ones((1, 3)),
    }
    assert bent(controls, known) is controls
    assert not slack_of([known], gathered([controls])).any()


def test_edges_that_are_not_known_yet_are_as_loose_as_the_tolerance_says() -> None:
    controls = expected(FIRST, FIRST.pose)["controls"]
    edge = int(controls["edges"][0])
    looks: Looks = {
        **NOTHING,
        "tolerance": 0.002,
        "bent": np.array([edge]),
        "bends": np.array([[0.001, 0.0, 0.0]]),
        "slack": np.diag([1e-8] * 3)[None],
    }
    slack, own = slack_of([looks], gathered([controls])), controls["edges"] == edge
    np.testing.assert_allclose(slack[own], np.broadcast_to(np.diag([1e-8] * 3), (own.sum(), 3, 3)))
    np.testing.assert_allclose(slack[~own], np.broadcast_to(0.002**2 * np.eye(3), ((~own).sum(), 3, 3)))
    moved = bent(controls, looks)["points"] - controls["points"]
    np.testing.assert_allclose(moved, np.where(own[:, None], [0.001, 0.0, 0.0], 0.0), atol=1e-15)
