import numpy as np
import pytest

from hierax.nodes.tracking.constants import AT_ONCE
from hierax.nodes.tracking.imagery.alternatives import elsewhere, footing_of, set_down, tops_behind
from hierax.nodes.tracking.math.geometry import exp_so3, invert, log_se3, make_pose, transform
from hierax.nodes.tracking.model.mesh import box_mesh

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


BLOCK = box_mesh((0.04, 0.05, 0.08)).vertices
EYE = np.array([0.1, -0.5, 0.6])
HANGING = make_pose(exp_so3(np.array([0.2, -0.3, 0.5])), [0.03, 0.02, 0.11])


@pytest.mark.parametrize("turn", [0, 1, 7])
def test_what_hangs_is_set_down_where_it_is_seen(turn: int) -> None:
    poses = set_down(HANGING, footing_of(BLOCK), EYE, [0.0, 0.03], turn)
    assert len(poses) == AT_ONCE
    corners = np.stack([transform(pose, BLOCK) for pose in poses])
    lowest = np.sort(corners[..., 2], axis=1)[:, :4]
    np.testing.assert_allclose(lowest, np.tile([[0.0], [0.03]], (AT_ONCE // 2, 4)), atol=1e-9)  # each lies on a face
    away, seen = corners.mean(axis=1) - EYE, HANGING[:3, 3] - EYE
    np.testing.assert_allclose(np.cross(away, seen), 0.0, atol=1e-9)
    assert not np.array_equal(poses, set_down(HANGING, footing_of(BLOCK), EYE, [0.0, 0.03], turn + 1))


def test_what_hangs_is_set_down_on_the_face_that_is_nearly_down() -> None:
    poses = set_down(HANGING, footing_of(BLOCK), EYE, [0.0], 0)
    np.testing.assert_allclose(poses[:, 2, 2], 1.0, atol=1e-9)  # the others are more than 60 degrees from it
    lying = make_pose(exp_so3(np.array([0.0, 0.25 * np.pi, 0.0])), HANGING[:3, 3])
    ups = set_down(lying, footing_of(BLOCK), EYE, [0.0], 0)[:, 2, :3]
    assert {tuple(np.rint(up)) for up in np.abs(ups)} == {(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)}


def test_what_is_not_below_the_eye_is_not_set_down() -> None:
    level = make_pose(np.eye(3), [0.0, 0.5, EYE[2]])
    assert set_down(level, footing_of(BLOCK), EYE, [0.0], 0).shape == (0, 4, 4)


def test_it_may_lie_on_what_stands_behind_it() -> None:
    def standing(away_m: float) -> dict[str, object]:
        beyond = HANGING[:3, 3] + away_m * (HANGING[:3, 3] - EYE) / np.linalg.norm(HANGING[:3, 3] - EYE)
        return {"pose": make_pose(np.eye(3), [*beyond[:2], 0.04]), "model": {"vertices": BLOCK}}

    assert tops_behind(HANGING, [standing(0.04), standing(0.3)], EYE) == [0.08]
