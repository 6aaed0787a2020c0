"""Stacks of rigid motions agree with the single ones."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.math.batched import adjoints, exp_many, inverse, invert_many, log_many
from hierax.nodes.tracking.math.geometry import cross, exp_se3, invert, log_se3


def twists() -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.concatenate((rng.normal(size=(6, 6)), 1e-6 * rng.normal(size=(2, 6)), np.zeros((1, 6))))


def test_exponential_and_inverse_are_those_of_single_poses() -> None:
    poses = exp_many(twists())
    np.testing.assert_allclose(poses, [exp_se3(twist) for twist in twists()], atol=1e-12)
    np.testing.assert_allclose(invert_many(poses), [invert(pose) for pose in poses], atol=1e-12)


def test_logarithm_takes_the_exponential_back() -> None:
    poses = exp_many(twists())
    np.testing.assert_allclose(log_many(poses), [log_se3(pose) for pose in poses], atol=1e-9)
    np.testing.assert_allclose(exp_many(log_many(poses)), poses, atol=1e-9)


def test_few_are_as_many() -> None:
    few = twists()
    many = np.tile(few, (8, 1))
    np.testing.assert_allclose(np.tile(exp_many(few), (8, 1, 1)), exp_many(many), atol=1e-14)
    np.testing.assert_allclose(np.tile(log_many(exp_many(few)), (8, 1)), log_many(exp_many(many)), atol=1e-9)
    assert exp_many(few[:0]).shape == (0, 4, 4)
    assert log_many(np.zeros((0, 4, 4))).shape == (0, 6)


def test_adjoints_carry_twists_from_frame_to_frame() -> None:
    poses, others = exp_many(twists()), twists()[::-1]
    carried = np.einsum("mij,mj->mi", adjoints(poses), others)
    np.testing.assert_allclose(poses @ exp_many(others), exp_many(carried) @ poses, atol=1e-9)


def test_cross_products_and_inverses() -> None:
    rng = np.random.default_rng(4)
    first, second = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose(cross(first, second), np.cross(first, second))
    roots = rng.normal(size=(3, 6, 6))
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(6)
    found = inverse(matrices)
    np.testing.assert_allclose(found @ matrices, np.broadcast_to(np.eye(6), (3, 6, 6)), atol=1e-9)
    assert np.array_equal(found, found.transpose(0, 2, 1))
