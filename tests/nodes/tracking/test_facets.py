"""Facets grown in inverse depth."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, Box, cast

from hierax.nodes.tracking.facets import angle_between, facets_of, facing, patch_of
from hierax.nodes.tracking.geometry import exp_so3, make_pose

POSE = make_pose(exp_so3(np.array([0.6, 0.5, 0.2])), [0.02, -0.03, 0.5])


def test_every_pixel_belongs_to_the_face_that_it_shows() -> None:
    seen = cast([Box(4, (0.08, 0.06, 0.1), POSE)])
    patch = patch_of(seen.depth, seen.labels, 4)
    assert patch is not None
    facets = facets_of(patch)
    height, width = patch.mine.shape
    faces = seen.faces[patch.top : patch.top + height, patch.left : patch.left + width]
    assert len(facets.planes) == 3
    for number in (1, 2, 3):
        shown = faces[facets.numbers == number]
        assert len(np.unique(shown)) == 1
    assert (facets.numbers[patch.mine] > 0).all()
    assert not facets.numbers[~patch.mine].any()


def test_angles_are_those_of_the_box() -> None:
    seen = cast([Box(4, (0.08, 0.06, 0.1), POSE)])
    patch = patch_of(seen.depth, seen.labels, 4)
    assert patch is not None
    facets = facets_of(patch)
    assert angle_between(facets.planes[:2], INTRINSICS, patch) == pytest.approx(np.pi / 2, abs=1e-3)
    for number, plane in enumerate(facets.planes, start=1):
        rows, columns = np.nonzero(facets.numbers == number)
        points = np.stack((columns, rows), axis=1).astype(np.float64)
        face = np.unique(seen.faces[rows + patch.top, columns + patch.left])[0]
        middle = np.array([*(points.mean(axis=0) + patch.corner), 1.0])
        middle[:2] = (middle[:2] - INTRINSICS[2:]) / INTRINSICS[:2]
        expected = abs(POSE[:3, face // 2] @ middle) / np.linalg.norm(middle)
        assert facing(plane, points, INTRINSICS, patch) == pytest.approx(expected, abs=1e-3)


def test_an_object_that_is_not_seen_has_no_patch() -> None:
    seen = cast([Box(4, (0.08, 0.06, 0.1), POSE)])
    assert patch_of(seen.depth, seen.labels, 5) is None
