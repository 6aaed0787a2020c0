import numpy as np

from hierax.nodes.tracking.constants import AT_ONCE
from hierax.nodes.tracking.imagery.alternatives import elsewhere
from hierax.nodes.tracking.math.geometry import exp_so3, invert, log_se3, make_pose

TILTED = make_pose(exp_so3(np.array([0.4, -0.2, 0.3])), [0.1, -0.2, 0.05])
SPREAD = np.diag([0.02, 0.01, 0.005, 0.1, 0.2, 0.3]) ** 2
FREE = np.zeros(3)


def twists(support: np.ndarray, turns: int) -> np.ndarray:
    poses = np.concatenate([elsewhere(TILTED, SPREAD, support, turn) for turn in range(turns)])
    return np.array([log_se3(invert(TILTED) @ pose) for pose in poses])


def test_poses_are_spread_as_the_covariance_says() -> None:
    found = twists(FREE, 60)
    assert len(found) == 60 * AT_ONCE
    np.testing.assert_allclose(found.std(axis=0), np.sqrt(np.diag(SPREAD)), rtol=0.1)
    np.testing.assert_allclose(found.mean(axis=0) / np.sqrt(np.diag(SPREAD)), 0.0, atol=0.1)


def test_few_poses_in_a_row_are_spread_already() -> None:
    assert (twists(FREE, 2).std(axis=0) > 0.5 * np.sqrt(np.diag(SPREAD))).all()


def test_what_is_carried_is_neither_higher_nor_tilted() -> None:
    up = TILTED[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    poses = np.concatenate([elsewhere(TILTED, SPREAD, up, turn) for turn in range(4)])
    np.testing.assert_allclose(poses[:, 2, 3], TILTED[2, 3], atol=1e-9)
    np.testing.assert_allclose(poses[:, 2, :3], np.broadcast_to(TILTED[2, :3], (len(poses), 3)), atol=1e-9)
    assert poses[:, :2, 3].std(axis=0).min() > 0.003
    np.testing.assert_array_equal(poses[:AT_ONCE], elsewhere(TILTED, SPREAD, up, 0))
