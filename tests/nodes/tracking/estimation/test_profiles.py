"""Profiles across expected edges."""

from __future__ import annotations

import numpy as np

from hierax.nodes.tracking.estimation.profiles import Lines, read_profiles, smoothed


def test_very_many_profiles_are_those_of_few() -> None:
    """OpenCV takes less than 32768 rows at a time; a search from many starts has more."""
    image = np.zeros((60, 80, 3), dtype=np.uint8)
    image[:, 40:] = 200
    soft = smoothed(image)
    count = 40_000
    pixels = np.column_stack((np.full(count, 38.0), np.linspace(20.0, 40.0, count)))
    normals = np.tile([1.0, 0.0], (count, 1))
    edges = np.arange(count)
    many = read_profiles(soft, Lines(edges, pixels, normals), edges, 6, 4.0)
    few = np.array([0, 29_999, 30_000, count - 1])
    some = read_profiles(soft, Lines(few, pixels[few], normals[few]), few, 6, 4.0)
    assert many.places.shape[0] == count
    np.testing.assert_array_equal(many.places[few], some.places)
    np.testing.assert_array_equal(many.inside[few], some.inside)
