"""Expected edges: on the true ones, and none where something nearer hides them."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, cast

from hierax.nodes.tracking.edges import CREASE, OUTLINE, visible_edges
from hierax.nodes.tracking.geometry import exp_so3, make_pose, project, transform
from hierax.nodes.tracking.models import box_mesh

SIDE_M = 0.08
CUBE = (SIDE_M, SIDE_M, SIDE_M)


def true_edges(box: Box) -> np.ndarray:
    corners = box_mesh(box.size).vertices
    pairs = [(a, b) for a in range(8) for b in range(a) if (np.abs(corners[a] - corners[b]) > 1e-9).sum() == 1]
    return transform(box.pose, corners[np.array(pairs)])


def distances(segments: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Of each segment: the metres that its farther end is from the nearest true edge's line."""
    along = edges[:, 1] - edges[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    off = segments[:, None] - edges[None, :, :1]
    across = off - np.sum(off * along[None, :, None], axis=-1, keepdims=True) * along[None, :, None]
    return np.linalg.norm(across, axis=-1).max(axis=-1).min(axis=-1)


@pytest.mark.parametrize("seed", range(8))
def test_edges_lie_on_the_true_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = exp_so3(np.array([0.5, 0.6, 0.1]) + rng.uniform(-0.15, 0.15, 3))
    box = Box(2, CUBE, make_pose(turn, [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.7)]))
    seen = cast([box])
    edges = visible_edges(seen.depth, seen.labels, 2, INTRINSICS)
    off = distances(edges.segments, true_edges(box))
    assert (edges.kinds == CREASE).sum() == 3
    assert (edges.kinds == OUTLINE).sum() >= 6
    # A crease is where two planes meet: exact. An outline is fitted to pixels.
    assert off[edges.kinds == CREASE].max() < 1e-5
    assert np.median(off[edges.kinds == OUTLINE]) < 2e-4
    assert off.max() < 1e-3
    pixels = project(edges.segments, INTRINSICS)
    length = np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=1).sum()
    corners = project(true_edges(box), INTRINSICS)
    assert length > 0.7 * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).sum() * 9 / 12


def test_what_hides_an_object_gives_it_no_edge() -> None:
    turn = exp_so3(np.array([0.5, 0.6, 0.1]))
    hidden = Box(1, CUBE, make_pose(turn, [0.0, 0.0, 0.6]))
    hider = Box(2, CUBE, make_pose(exp_so3(np.array([0.2, -0.4, 0.7])), [0.035, 0.02, 0.45]))
    seen = cast([hidden, hider])
    own = visible_edges(seen.depth, seen.labels, 1, INTRINSICS)
    assert len(own.segments) >= 3
    # The segments are on the hidden cube's edges, and on pixels that show it.
    assert distances(own.segments, true_edges(hidden)).max() < 1.5e-3
    for segment in own.segments:
        middles = project(segment[0] + np.linspace(0.1, 0.9, 20)[:, None] * (segment[1] - segment[0]), INTRINSICS)
        around = [seen.labels[v - 1 : v + 2, u - 1 : u + 2] for u, v in np.rint(middles).astype(int)]
        assert all((part == 1).any() for part in around)
    # The one in front keeps all of its edges.
    alone = cast([hider])
    assert len(visible_edges(seen.depth, seen.labels, 2, INTRINSICS).segments) == len(
        visible_edges(alone.depth, alone.labels, 2, INTRINSICS).segments
    )


def test_where_the_image_ends_is_no_edge() -> None:
    box = Box(1, CUBE, make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.29, 0.0, 0.5]))
    seen = cast([box])
    assert seen.labels[:, -1].any()
    edges = visible_edges(seen.depth, seen.labels, 1, INTRINSICS)
    assert len(edges.segments) >= 2
    assert distances(edges.segments, true_edges(box)).max() < 1.5e-3


def test_a_curved_object_has_its_outline() -> None:
    width, height = SIZE
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - 313.06) / 525.0, (v - 223.59) / 530.0, np.ones((height, width))], axis=-1)
    centre, radius = np.array([0.02, 0.01, 0.5]), 0.05
    along, square = rays @ centre, (rays * rays).sum(axis=-1)
    inside = along**2 - square * (centre @ centre - radius**2)
    depth = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / square, 0.0)
    edges = visible_edges(depth, (depth > 0).astype(np.uint8), 1, INTRINSICS)
    assert len(edges.segments) >= 8
    assert (edges.kinds == OUTLINE).all()
    pixels = project(edges.segments, INTRINSICS).reshape(-1, 2)
    directions = np.stack([(pixels[:, 0] - 313.06) / 525.0, (pixels[:, 1] - 223.59) / 530.0, np.ones(len(pixels))], 1)
    cosine = directions @ centre / np.linalg.norm(directions, axis=1) / np.linalg.norm(centre)
    # Tangents touch the sphere at the angle asin(radius / distance).
    angle = np.arcsin(radius / np.linalg.norm(centre))
    assert np.abs(np.arccos(cosine) - angle).max() * 525.0 < 1.5


def test_an_object_that_is_not_seen_has_no_edges() -> None:
    seen = cast([Box(1, CUBE, make_pose(np.eye(3), [0.0, 0.0, 0.5]))])
    edges = visible_edges(seen.depth, seen.labels, 9, INTRINSICS)
    assert edges.segments.shape == (0, 2, 3)
    assert edges.kinds.shape == (0,)
