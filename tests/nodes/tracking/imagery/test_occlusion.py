"""The chance to be seen, against counting over poses drawn from their uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box

from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.imagery.occlusion import Placed, chances_seen
from hierax.nodes.tracking.math.geometry import Floats, exp_se3, exp_so3, invert, make_pose, transform
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of

CUBE = (0.06, 0.06, 0.06)


def covariance(length_m: float, angle_rad: float) -> Floats:
    return np.diag([length_m**2] * 3 + [angle_rad**2] * 3)


def chances(boxes: list[Box], certainty: Floats) -> tuple[list[Floats], list[Floats]]:
    """Control points of each box, its own frame, and their chances."""
    shapes = [shape_of(*box_mesh(box.size)) for box in boxes]
    layers = [LayerRenderer(shape).layer(box.pose, INTRINSICS, SIZE) for shape, box in zip(shapes, boxes, strict=True)]
    points = [controls_of(shape, box.pose, INTRINSICS, SIZE).points for shape, box in zip(shapes, boxes, strict=True)]
    placed = [Placed(box.pose, certainty, layer) for box, layer in zip(boxes, layers, strict=True)]
    return points, [np.asarray(part, dtype=np.float64) for part in chances_seen(points, placed, INTRINSICS)]


def counted(points: Floats, own: Box, other: Box, certainty: Floats, rng: np.random.Generator) -> Floats:
    """The share of drawn poses of both at which the other box does not lie before each point."""
    seen = np.zeros(len(points))
    factor = np.linalg.cholesky(certainty)
    draws = 400
    for _ in range(draws):
        at = transform(own.pose @ exp_se3(factor @ rng.normal(size=6)), points)
        from_camera = invert(other.pose @ exp_se3(factor @ rng.normal(size=6)))
        origin, ways = from_camera[:3, 3], at @ from_camera[:3, :3].T
        one, two = (np.array([[-1.0], [1.0]]) * np.array(other.size) / 2)[:, None] - origin
        first, last = np.minimum(one / ways, two / ways).max(axis=1), np.maximum(one / ways, two / ways).min(axis=1)
        seen += ~((first < last) & (first < 0.999))
    return seen / draws


@pytest.mark.parametrize("seed", range(4))
def test_as_counted_over_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own = Box(1, CUBE, make_pose(exp_so3(rng.normal(size=3)), [0.0, 0.0, 0.6]))
    before = Box(2, CUBE, make_pose(exp_so3(rng.normal(size=3)), [*rng.uniform(-0.04, 0.04, 2), 0.45]))
    certainty = covariance(0.004, 0.03)
    points, found = chances([own, before], certainty)
    share = counted(points[0], own, before, certainty, rng)
    assert 0.02 < share.mean() < 0.98
    off = np.abs(share - found[0])
    assert off.mean() < 0.05
    assert np.quantile(off, 0.95) < 0.2
    assert (found[1] > 0.99).all()


def test_certain_poses_hide_surely() -> None:
    own = Box(1, CUBE, make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.0, 0.0, 0.6]))
    before = Box(2, CUBE, make_pose(exp_so3(np.array([0.2, -0.4, 0.7])), [0.035, 0.02, 0.45]))
    sure = covariance(1e-4, 1e-4)
    points, (found, other) = chances([own, before], sure)
    share = counted(points[0], own, before, covariance(1e-6, 1e-6), np.random.default_rng(0))
    assert ((found > 0.5) == (share > 0.5)).mean() > 0.97
    assert ((found < 0.05) | (found > 0.95)).mean() > 0.8
    assert (other > 0.99).all()


def test_what_stands_on_another_is_not_hidden_by_it() -> None:
    turn = exp_so3(np.array([np.pi - 0.6, 0.0, 0.0]))
    camera_from_world = make_pose(turn, [0.0, 0.05, 0.6])
    lower = Box(1, CUBE, camera_from_world @ make_pose(exp_so3(np.array([0.0, 0.0, 0.4])), [0.0, 0.0, 0.03]))
    upper = Box(2, CUBE, camera_from_world @ make_pose(exp_so3(np.array([0.0, 0.0, 0.6])), [0.0, 0.0, 0.09]))
    points, (below, above) = chances([lower, upper], covariance(0.003, 0.02))
    top = points[0][:, 2] > 0.0299
    # The upper one's own edges are before the lower one, though they touch it.
    assert above.mean() > 0.85
    assert np.median(above) > 0.95
    # Of the lower one's top, the edges at the back are hidden.
    assert below[top].min() < 0.1
    assert np.median(below[~top]) > 0.9


def test_alone_everything_is_seen() -> None:
    one = Box(1, CUBE, make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [-0.1, 0.0, 0.5]))
    far = Box(2, CUBE, make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.1, 0.0, 0.5]))
    for boxes in ([one], [one, far]):
        _, found = chances(boxes, covariance(0.001, 0.01))
        assert all((part == 1.0).all() for part in found)


def test_what_the_image_cuts_goes_on_beyond_it() -> None:
    # The hiding box reaches out of the image: where that ends is no outline.
    before = Box(2, (0.3, 0.3, 0.05), make_pose(np.eye(3), [0.32, 0.0, 0.4]))
    own = Box(1, CUBE, make_pose(exp_so3(np.array([0.3, 0.2, 0.1])), [0.31, 0.0, 0.6]))
    _, (found, _) = chances([own, before], covariance(0.002, 0.01))
    assert len(found) > 10
    assert found.max() < 0.01
