"""What control points say is the same however many poses are tried at once, and however it is looked up."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.constants import MANY
from hierax.nodes.tracking.estimation.stages import _peaks, _summed_products, ranked

SEED = 5


def test_what_is_said_of_many_poses_at_once_is_what_is_said_of_each() -> None:
    rng = np.random.default_rng(SEED)
    owners = np.sort(rng.integers(0, MANY, 200))
    left, right, numbers = rng.normal(size=(200, 6)), rng.normal(size=(200, 6)), rng.normal(size=200)
    blocks, gradients = _summed_products(left, right, numbers, owners, MANY)
    at_once = _summed_products(left, right, numbers, owners, MANY + 2)  # the last two have none
    np.testing.assert_allclose(at_once[0][:MANY], blocks, atol=1e-12)
    np.testing.assert_allclose(at_once[1][:MANY], gradients, atol=1e-12)
    assert not at_once[0][MANY:].any()


def test_peaks_alone_are_those_of_the_profiles_in_their_order() -> None:
    rng = np.random.default_rng(SEED)
    places = np.where(rng.random((50, 21)) < 0.2, rng.normal(size=(50, 21)), np.inf).astype(np.float32)
    places[7] = np.inf
    strange = rng.random((50, 21)).astype(np.float32)
    peaks = _peaks(places, strange)
    assert peaks.columns.shape[1] == np.isfinite(places).sum(axis=1).max()
    nearest = np.abs(peaks.places - 0.3).argmin(axis=1)
    rows = np.arange(50)
    np.testing.assert_array_equal(peaks.columns[rows, nearest], np.abs(places - 0.3).argmin(axis=1))
    np.testing.assert_array_equal(peaks.strange[rows, nearest], strange[rows, peaks.columns[rows, nearest]])


def test_values_are_ranked_by_owner() -> None:
    rng = np.random.default_rng(SEED)
    owners, values = rng.integers(0, 5, 100) * (rng.random(100) < 0.9), rng.normal(size=100)
    found = ranked(owners[owners != 3], values[owners != 3], 6)
    middle = 0.5 * (found.at((found.counts - 1) // 2, np.inf) + found.at(found.counts // 2, np.inf))
    for owner in (0, 1, 2, 4):
        assert middle[owner] == np.median(values[owners == owner])
    assert np.isinf(middle[[3, 5]]).all(), "these have none"
