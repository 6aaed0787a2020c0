"""Faces in a picture: which samples they cover, against rays, and what is visible of a body."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.tracking.generator import stock
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, make_pose, rays
from hierax.nodes.tracking.simworld.raster import drawn, visible_shares
from hierax.nodes.tracking.simworld.shapes import Shape, Thing, angle_piece, box
from hierax.nodes.tracking.simworld.world import camera_at

SIZE = (160, 120)
INTRINSICS = np.array([150.0, 155.0, 81.3, 57.9])


def place(x: float, y: float, z: float, turn: float) -> Floats:
    return make_pose(exp_so3(np.array([0.0, 0.0, turn])), np.array([x, y, z]))


def silhouette(thing: Thing, camera: Floats) -> Floats:
    """Pixels whose ray meets a triangle of the mesh."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    to_camera = invert(camera) @ thing.pose
    corners = (thing.shape.mesh.vertices @ to_camera[:3, :3].T + to_camera[:3, 3])[thing.shape.mesh.faces]
    along = rays(np.stack((columns, rows), axis=-1), INTRINSICS)
    met = np.zeros(columns.shape, bool)
    for a, b, c in corners:
        # A ray runs through a triangle where it is on the same side of the planes through its sides and the eye.
        sides = np.stack([along @ np.cross(p, q) for p, q in ((a, b), (b, c), (c, a))])
        met |= (sides > 0).all(axis=0) | (sides < 0).all(axis=0)
    return met


def test_an_angle_piece_covers_what_rays_meet() -> None:
    thing = Thing(place(0.02, 0.0, 0.04, 0.8), angle_piece(0.1, 0.09, 0.03, 0.08), (1, 2, 3))
    camera = camera_at(0.0)
    mask = np.zeros((SIZE[1], SIZE[0]), bool)
    for each in drawn(thing, camera, INTRINSICS, SIZE, 1):
        left, top, right, bottom = each.window
        mask[top:bottom, left:right] |= each.nearness > 0
    met = silhouette(thing, camera)
    assert met.sum() > 500
    assert (mask != met).sum() <= 2


def test_nearness_is_the_inverse_of_depth() -> None:
    thing = Thing(place(0.0, 0.0, 0.05, 0.3), box((0.1, 0.1, 0.1)), (1, 2, 3))
    camera = camera_at(0.0)
    seen = drawn(thing, camera, INTRINSICS, SIZE, 1)
    (covered,) = [each for each in seen if each.face is not None and each.face.normal[2] > 0.9]
    row, column = (int(axis.mean()) for axis in np.nonzero(covered.nearness))
    ray = camera[:3, :3] @ rays(np.array([covered.window[0] + column, covered.window[1] + row]), INTRINSICS)
    depth = (0.1 - camera[2, 3]) / ray[2]
    assert 1.0 / covered.nearness[row, column] == pytest.approx(depth, rel=1e-4)


def test_visible_shares_of_a_body_alone_behind_another_and_cut_off() -> None:
    near = Thing(place(0.0, -0.1, 0.06, 0.0), box((0.3, 0.02, 0.12)), (1, 2, 3))
    far = Thing(place(0.0, 0.1, 0.02, 0.2), box((0.04, 0.04, 0.04)), (1, 2, 3))
    camera = camera_at(0.0)
    np.testing.assert_allclose(visible_shares([far], camera, INTRINSICS, SIZE), [1.0])
    low = camera.copy()
    low[:3, 3] += np.array([0.0, 0.0, -0.25])
    shares = visible_shares([far, near], low, INTRINSICS, SIZE)
    assert shares[0] < visible_shares([far, near], camera, INTRINSICS, SIZE)[0]
    assert visible_shares([far, near], camera, INTRINSICS, SIZE)[1] == pytest.approx(1.0, abs=0.3)
    met = silhouette(far, camera)
    column = int(np.nonzero(met.any(axis=0))[0].mean())
    cut = visible_shares([far], camera, INTRINSICS, (column, SIZE[1]))
    assert cut[0] == pytest.approx(met[:, :column].sum() / met.sum(), abs=0.03)
    assert visible_shares([], camera, INTRINSICS, SIZE).shape == (0,)


@pytest.mark.parametrize("shape", [stock.mug(0.04, 0.09), stock.torus(0.04, 0.012), stock.ball(0.03)])
def test_a_curved_body_is_drawn_where_rays_meet_its_mesh(shape: Shape) -> None:
    thing, camera = Thing(place(0.02, 0.0, 0.04, 0.8), shape, (1, 2, 3)), camera_at(0.4)
    ((_, (left, top, right, bottom), nearness, normals),) = drawn(thing, camera, INTRINSICS, SIZE, 1)
    mask = np.zeros((SIZE[1], SIZE[0]), bool)
    mask[top:bottom, left:right] = nearness > 0
    assert np.count_nonzero(mask != silhouette(thing, camera)) <= 2
    np.testing.assert_allclose(np.linalg.norm(normals[nearness > 0], axis=1), 1.0, atol=1e-5)
    to_camera = camera[:3, 3] - thing.pose[:3, 3]
    assert (normals[nearness > 0] @ to_camera > -0.2 * np.linalg.norm(to_camera)).all(), "what is seen faces the camera"
    assert visible_shares([thing], camera, INTRINSICS, SIZE) == pytest.approx([1.0])
    behind = camera.copy()
    behind[:3, :3] = behind[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    assert drawn(thing, behind, INTRINSICS, SIZE, 1) == []
