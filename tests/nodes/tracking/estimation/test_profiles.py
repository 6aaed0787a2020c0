"""Profiles across expected edges."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

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


@pytest.mark.parametrize("blur_px", [0.5, 0.9])
@pytest.mark.parametrize(("left", "right"), [(0.02, 0.6), (0.6, 0.02), (0.1, 0.4)])
def test_an_edge_is_where_light_changes_however_a_camera_encodes_it(left: float, right: float, blur_px: float) -> None:
    """In the encoded picture, dark and bright steps seem to be up to 0.3 pixels from where they are."""
    fine = np.where(np.arange(80 * 20)[None, :] < 40 * 20 + 3, left, right).astype(np.float32)
    light = np.repeat(cv2.GaussianBlur(fine, (0, 0), 20.0 * blur_px).reshape(1, 80, 20).mean(axis=2), 60, axis=0)
    image = np.rint(255.0 * light ** (1.0 / 2.2)).astype(np.uint8)
    pixels, edges = np.array([[38.0, 25.0], [38.0, 30.0]]), np.arange(2)
    found = read_profiles(smoothed(image), Lines(edges, pixels, np.tile([1.0, 0.0], (2, 1))), edges, 6, 1.5)
    place = 40.0 + 3 / 20 - 0.5 - 38.0
    nearest = np.abs(found.places - place).min(axis=1)
    np.testing.assert_allclose(nearest, 0.0, atol=0.06)
