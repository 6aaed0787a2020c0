"""One reading of the image is laid out as the steps take it."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.estimation.alignment import ranked
from hierax.nodes.tracking.estimation.profiles import Profiles
from hierax.nodes.tracking.estimation.stages import _peaks

SEED = 5


def test_peaks_alone_are_those_of_the_profiles_in_their_order() -> None:
    rng = np.random.default_rng(SEED)
    places = np.where(rng.random((50, 21)) < 0.2, rng.normal(size=(50, 21)), np.inf).astype(np.float32)
    places[7] = np.inf
    strange, sharpness = rng.random((2, 50, 21)).astype(np.float32)
    none = np.zeros((50, 21, 1), dtype=np.float32)
    peaks = _peaks(Profiles(places, sharpness, none, none), strange)
    assert peaks.columns.shape[1] == np.isfinite(places).sum(axis=1).max()
    nearest = np.abs(peaks.places - 0.3).argmin(axis=1)
    rows = np.arange(50)
    columns = peaks.columns[rows, nearest]
    np.testing.assert_array_equal(columns, np.abs(places - 0.3).argmin(axis=1))
    np.testing.assert_array_equal(peaks.strange[rows, nearest], strange[rows, columns])
    np.testing.assert_array_equal(peaks.sharpness[rows, nearest], sharpness[rows, columns])


def test_values_are_ranked_by_owner() -> None:
    rng = np.random.default_rng(SEED)
    owners, values = rng.integers(0, 5, 100) * (rng.random(100) < 0.9), rng.normal(size=100)
    found = ranked(owners[owners != 3], values[owners != 3], 6)
    middle = 0.5 * (found.at((found.counts - 1) // 2, np.inf) + found.at(found.counts // 2, np.inf))
    for owner in (0, 1, 2, 4):
        assert middle[owner] == np.median(values[owners == owner])
    assert np.isinf(middle[[3, 5]]).all(), "these have none"
