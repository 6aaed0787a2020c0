"""Each object drawn alone, by rays or by TinyRenderer: the same, and from the arguments alone."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, cast
from support.meshes import ell, sphere

from hierax.nodes.tracking.imagery.layers import LayerRenderer, MeshRenderer, Window, surrounding
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of

BOX = (0.08, 0.06, 0.1)


def some_pose(rng: np.random.Generator) -> np.ndarray:
    return make_pose(exp_so3(rng.normal(size=3)), [*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.35, 0.8)])


@pytest.mark.parametrize("seed", range(5))
def test_a_box_is_what_rays_meet_first_and_leave_last(seed: int) -> None:
    pose = some_pose(np.random.default_rng(seed))
    layer = LayerRenderer(shape_of(*box_mesh(BOX))).layer(pose, INTRINSICS, SIZE)
    assert layer is not None
    exact = cast([Box(1, BOX, pose)])
    left, top, right, bottom = layer.window
    view = np.s_[top:bottom, left:right]
    assert exact.labels.sum() == exact.labels[view].sum()
    seen = layer.inverse > 0
    assert (seen != (exact.labels[view] > 0)).sum() <= 1
    seen &= exact.labels[view] > 0
    assert 1.0 / layer.inverse[seen] == pytest.approx(exact.depth[view][seen], rel=1e-9)
    u, v = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
    rays = np.stack(((u - INTRINSICS[2]) / INTRINSICS[0], (v - INTRINSICS[3]) / INTRINSICS[1], np.ones(u.shape)), -1)
    inside = rays[seen] @ pose[:3, :3]
    origin = -pose[:3, :3].T @ pose[:3, 3]
    half = np.array(BOX) / 2
    leaves = np.maximum((-half - origin) / inside, (half - origin) / inside).min(axis=1)
    assert 1.0 / layer.leaving(np.stack((u[seen], v[seen]), axis=1)) == pytest.approx(leaves, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_rays_and_tiny_renderer_agree(seed: int) -> None:
    pose = some_pose(np.random.default_rng(10 + seed))
    shape = shape_of(*ell())
    layer = LayerRenderer(shape).layer(pose, INTRINSICS, SIZE)
    assert layer is not None
    renderer = MeshRenderer(shape.vertices, shape.faces)
    drawn = renderer.inverse_depth(pose, INTRINSICS, layer.window)
    both = (drawn > 0) & (layer.inverse > 0)
    assert ((drawn > 0) != (layer.inverse > 0)).sum() <= 3
    assert np.quantile(np.abs(drawn[both] / layer.inverse[both] - 1.0), 0.99) < 1e-5


def test_an_open_sheet_is_seen_from_both_sides() -> None:
    corners = np.array([[-0.05, -0.05, 0.0], [0.05, -0.05, 0.0], [0.05, 0.05, 0.0], [-0.05, 0.05, 0.0]])
    fine = np.linspace(-0.05, 0.05, 14)
    grid = np.stack([*np.meshgrid(fine, fine), np.zeros((14, 14))], axis=-1).reshape(-1, 3)
    cells = [(14 * y + x, 14 * y + x + 1, 14 * y + x + 15, 14 * y + x + 14) for y in range(13) for x in range(13)]
    many = np.array([(a, b, c) for a, b, c, _ in cells] + [(a, c, d) for a, _, c, d in cells])
    for vertices, faces in ((corners, np.array([[0, 1, 2], [0, 2, 3]])), (grid, many)):
        for turned in (faces, faces[:, ::-1]):
            renderer = LayerRenderer(shape_of(vertices, turned))
            layer = renderer.layer(make_pose(np.eye(3), [0.0, 0.0, 0.5]), INTRINSICS, SIZE)
            assert layer is not None
            assert (layer.inverse > 0).sum() == pytest.approx(105 * 106, rel=0.02)
            assert layer.inverse.max() == pytest.approx(2.0, rel=1e-5)


def test_what_reaches_behind_the_camera_is_drawn_before_it() -> None:
    # A floor that goes on under the camera and behind it.
    height = 0.2
    vertices = np.array([[-5.0, height, -5.0], [5.0, height, -5.0], [5.0, height, 5.0], [-5.0, height, 5.0]])
    layer = LayerRenderer(shape_of(vertices, np.array([[0, 1, 2], [0, 2, 3]]))).layer(np.eye(4), INTRINSICS, SIZE)
    assert layer is not None
    assert layer.window == Window(0, 0, *SIZE)
    rows = np.arange(SIZE[1])
    depth = height * INTRINSICS[1] / np.maximum(rows - INTRINSICS[3], 1e-9)
    below = (depth > 0) & (depth < 4.9)
    assert layer.inverse[below] == pytest.approx(np.repeat(1.0 / depth[below][:, None], SIZE[0], axis=1))
    assert not layer.inverse[: int(INTRINSICS[3])].any()


@pytest.mark.parametrize("mesh", [box_mesh(BOX), sphere(0.05, 20, 20)])
def test_a_layer_depends_on_its_arguments_alone(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    rng = np.random.default_rng(3)
    used, fresh = LayerRenderer(shape_of(*mesh)), LayerRenderer(shape_of(*mesh))
    for _ in range(3):
        used.layer(some_pose(rng), INTRINSICS, SIZE)
    pose = some_pose(rng)
    one, other = used.layer(pose, INTRINSICS, SIZE), fresh.layer(pose, INTRINSICS, SIZE)
    assert one is not None
    assert other is not None
    assert one.window == other.window
    assert np.array_equal(one.inverse, other.inverse)


def test_what_is_behind_or_beside_the_camera_has_no_layer() -> None:
    renderer = LayerRenderer(shape_of(*box_mesh(BOX)))
    for translation in ([0.0, 0.0, -0.5], [5.0, 0.0, 0.5]):
        assert renderer.layer(make_pose(np.eye(3), translation), INTRINSICS, SIZE) is None


def test_windows_together() -> None:
    assert surrounding([Window(3, 4, 10, 12), Window(1, 8, 5, 20)]) == Window(1, 4, 10, 20)
    assert surrounding([]).size == (0, 0)
