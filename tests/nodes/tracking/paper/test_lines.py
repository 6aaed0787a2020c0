"""Expected edges by Laplacian and Hough transform, and poses from line segments."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, Box, cast, photograph

from hierax.nodes.tracking.math.geometry import exp_so3, invert, make_pose, pose_error, project, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.paper.lines import expected_lines, image_lines, match_lines

CUBE = (0.08, 0.08, 0.08)
POSE = make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.02, -0.01, 0.5])


def off_edges(lines: np.ndarray, box: Box) -> np.ndarray:
    """Of each end point: pixels from the nearest true edge's line."""
    corners = box_mesh(box.size).vertices
    pairs = [(a, b) for a in range(8) for b in range(a) if (np.abs(corners[a] - corners[b]) > 1e-9).sum() == 1]
    edges = project(transform(box.pose, corners[np.array(pairs)]), INTRINSICS)
    along = (edges[:, 1] - edges[:, 0]) / np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1, keepdims=True)
    relative = project(lines, INTRINSICS)[:, :, None] - edges[None, None, :, 0]
    off = np.abs(relative[..., 0] * along[:, 1] - relative[..., 1] * along[:, 0])
    return off.max(axis=1).min(axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_expected_lines_are_the_visible_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = exp_so3(np.array([0.5, 0.6, 0.1]) + rng.uniform(-0.15, 0.15, 3))
    box = Box(2, CUBE, make_pose(turn, [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.6)]))
    seen = cast([box])
    lines = expected_lines(seen.depth, seen.labels, 2, INTRINSICS)
    assert 8 <= len(lines) <= 12
    assert np.quantile(off_edges(lines, box), 0.9) < 2.0
    # The depth of the end points is that of the surface.
    inside = transform(invert(box.pose), lines)
    assert np.median(np.abs(np.abs(inside).max(axis=-1) - 0.04)) < 0.001


def test_no_line_where_something_nearer_hides_the_object() -> None:
    hidden = Box(1, CUBE, make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.0, 0.0, 0.6]))
    hider = Box(2, CUBE, make_pose(exp_so3(np.array([0.2, -0.4, 0.7])), [0.035, 0.02, 0.45]))
    seen = cast([hidden, hider])
    lines = expected_lines(seen.depth, seen.labels, 1, INTRINSICS)
    assert len(lines) >= 4
    assert off_edges(lines, hidden).max() < 3.0
    assert len(expected_lines(seen.depth, seen.labels, 9, INTRINSICS)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_corrected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = Box(1, CUBE, POSE)
    lines = image_lines(photograph([box], 2.0, rng))
    wrong = POSE @ make_pose(exp_so3(rng.normal(size=3) * 0.015), rng.normal(size=3) * 0.002)
    seen = cast([Box(1, CUBE, wrong)])
    expected = transform(invert(wrong), expected_lines(seen.depth, seen.labels, 1, INTRINSICS))
    found = match_lines(lines, expected, wrong, INTRINSICS)
    assert found is not None
    assert found.score > 0.8
    distance, angle = pose_error(found.pose, POSE)
    assert distance < 0.006
    assert angle < np.radians(2.5)
    assert np.linalg.eigvalsh(found.information).min() > 0


def test_too_few_lines_say_nothing() -> None:
    seen = cast([Box(1, CUBE, POSE)])
    expected = transform(invert(POSE), expected_lines(seen.depth, seen.labels, 1, INTRINSICS))
    plain = np.full((480, 640, 3), 90, dtype=np.uint8)
    assert match_lines(image_lines(plain), expected, POSE, INTRINSICS) is None
    lines = image_lines(photograph([Box(1, CUBE, POSE)], 0.0, np.random.default_rng(0)))
    assert match_lines(lines, expected[:2], POSE, INTRINSICS) is None
    behind = make_pose(np.eye(3), [0.0, 0.0, -0.5])
    assert match_lines(lines, expected, behind, INTRINSICS) is None
