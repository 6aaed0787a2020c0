from typing import Any

import numpy as np
import pytest

from hierax.nodes.tracking.imagery.alternatives import resting
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose
from hierax.nodes.tracking.model.mesh import box_mesh

WIDE = np.diag([0.01**2] * 3 + [0.1**2] * 3)
VERTICES = box_mesh((0.04, 0.05, 0.06)).vertices


def body(
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0), velocity: tuple[float, ...] = (0.0,) * 6
) -> dict[str, Any]:
    pose = make_pose(exp_so3(np.array(turn)), [0.0, 0.0, 0.03])
    return {"pose": pose, "velocity": np.array(velocity), "covariance": WIDE, "model": {"vertices": VERTICES}}


def test_what_lies_on_a_face_is_as_high_and_upright_as_that_leaves_it() -> None:
    after = resting(body((0.0, 0.0, 0.7), (0.2, 0.0, 0.0, 0.0, 0.0, 1.0)), carried=True)
    assert after["stands"]
    np.testing.assert_allclose(after["support"], [0.0, 0.0, 1.0], atol=1e-9)
    spread = np.sqrt(np.diag(after["covariance"]))
    assert spread[2] < 0.001
    assert spread[3:5].max() < 0.01
    np.testing.assert_allclose(spread[[0, 1, 5]], [0.01, 0.01, 0.1], rtol=1e-6)


@pytest.mark.parametrize(
    ("turn", "velocity"),
    [
        ((0.5, 0.0, 0.0), (0.0,) * 6),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -0.5, 0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)),
    ],
    ids=["on an edge", "sinking", "turning over"],
)
def test_what_leans_or_falls_is_carried_but_as_uncertain_as_before(
    turn: tuple[float, float, float], velocity: tuple[float, ...]
) -> None:
    after = resting(body(turn, velocity), carried=True)
    assert not after["stands"]
    np.testing.assert_allclose(np.linalg.norm(after["support"]), 1.0)
    np.testing.assert_array_equal(after["covariance"], WIDE)


def test_what_nothing_carries_has_no_support() -> None:
    after = resting(body(), carried=False)
    assert not after["stands"]
    assert not after["support"].any()
