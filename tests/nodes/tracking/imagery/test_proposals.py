"""Poses in which bodies can rest, and places all over what a camera sees of a plane."""

from __future__ import annotations

import numpy as np
import pytest
from trimesh.creation import cylinder, icosphere

from hierax.nodes.tracking.constants import BUDGET, YAWS
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.imagery.proposals import (
    Proposer,
    bottom_of,
    places_at,
    places_on,
    places_seen,
    resting_poses,
    stable_faces,
    top_of,
)
from hierax.nodes.tracking.math.geometry import Floats, invert, looking_down, project, transform
from hierax.nodes.tracking.model.mesh import Mesh, box_mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.model.symmetry import found_symmetry

CAMERA = looking_down(0.3, np.radians(40.0), 0.6, np.zeros(3))
INTRINSICS, SIZE = np.array([300.0, 300.0, 159.5, 119.5]), (320, 240)


@pytest.mark.parametrize(
    ("size", "faces"), [((0.04, 0.06, 0.09), 3), ((0.05, 0.05, 0.05), 0.5), ((0.04, 0.07, 0.07), 2)]
)
def test_a_box_rests_on_its_faces_and_what_looks_alike_is_proposed_once(
    size: tuple[float, float, float], faces: float
) -> None:
    mesh = box_mesh(size)
    shape = shape_of(mesh.vertices, mesh.faces)
    down = stable_faces(shape.vertices, np.zeros(3))
    assert len(down) == 6
    assert sorted(np.abs(each).argmax() for each in down) == [0, 0, 1, 1, 2, 2]
    poses = resting_poses(shape)
    lowest = [transform(pose, shape.vertices)[:, 2].min() for pose in poses]
    assert lowest == pytest.approx([0.0] * len(poses), abs=1e-9)
    square = sorted(size)
    if square[0] == square[2]:
        assert len(poses) == YAWS // 4
    elif square[1] == square[2]:
        assert len(poses) == YAWS // 2 + YAWS // 4
    else:
        assert len(poses) == faces * YAWS // 2


def test_a_body_does_not_rest_where_its_centre_is_beside_its_foot() -> None:
    corners = box_mesh((0.02, 0.02, 0.02)).vertices
    leaning = corners + np.array([0.04, 0.0, 0.0]) * (corners[:, 2:] > 0.0)
    for down in stable_faces(leaning, leaning.mean(axis=0)):
        assert abs(down[2]) < 0.9


@pytest.mark.parametrize(
    "corners",
    [
        box_mesh((0.006, 0.006, 0.18)).vertices,
        np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.0]]),
        np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.001, 0.0, 0.05], [0.0, 0.001, 0.05]]),
    ],
)
def test_what_is_too_thin_to_rest_steadily_is_imagined_to_rest_all_the_same(corners: Floats) -> None:
    down = stable_faces(corners, 0.5 * (corners.min(axis=0) + corners.max(axis=0)))
    assert down
    lies = np.array([np.ptp(corners @ each) for each in down])
    assert lies.min() < 0.01, "it lies, rather than that it stands on its end"


def test_what_is_round_is_proposed_once() -> None:
    ball, can = icosphere(radius=0.03, subdivisions=3), cylinder(0.02, 0.08, sections=48)
    for solid, most in ((ball, YAWS // 2), (can, YAWS)):
        mesh = Mesh(np.asarray(solid.vertices), np.asarray(solid.faces, dtype=np.int32))
        shape = shape_of(mesh.vertices, mesh.faces)
        symmetry = found_symmetry(mesh)
        assert len(symmetry["free"])
        assert len(resting_poses(shape, symmetry)) < most < len(resting_poses(shape))


def test_a_template_is_whole_wherever_the_camera_s_middle_is() -> None:
    """An image may be a part of a larger one, and the middle of the lens beside it."""
    mesh = box_mesh((0.04, 0.06, 0.09))
    shape = shape_of(mesh.vertices, mesh.faces)
    there, beside = (
        Proposer(LayerRenderer(shape)).templates(CAMERA, np.zeros(3), lens)
        for lens in (INTRINSICS, INTRINSICS - np.array([0.0, 0.0, 190.0, 0.0]))
    )
    for one, other in zip(there, beside, strict=True):
        assert len(other["controls"]["points"]) == len(one["controls"]["points"])


def test_places_are_what_the_camera_sees_of_a_plane() -> None:
    places = places_on(CAMERA, INTRINSICS, SIZE, 0.05, None, 10_000)
    assert len(places) > 400
    assert places[:, 2, 3] == pytest.approx(0.05)
    pixels = project(transform(invert(CAMERA), places[:, :3, 3]), INTRINSICS)
    assert pixels.min() > -1.0
    assert (pixels < np.array(SIZE)).all()
    away = places[:, :2, 3] - CAMERA[:2, 3]
    assert (np.einsum("nk,nk->n", away, places[:, :2, 0]) > 0.0).all()
    square = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    few = places_on(CAMERA, INTRINSICS, SIZE, 0.05, square, 10_000)
    assert 0 < len(few) < len(places) / 4
    assert np.abs(few[:, :2, 3]).max() <= 0.05
    other = places_on(CAMERA, INTRINSICS, SIZE, 0.05, None, 10_000, turn=1)
    assert np.linalg.norm(other[:, None, :3, 3] - places[None, :, :3, 3], axis=-1).min() > 1e-4


def test_the_budget_thins_places_out() -> None:
    many = places_seen(CAMERA, INTRINSICS, SIZE, [0.0], 1)
    assert len(places_seen(CAMERA, INTRINSICS, SIZE, [0.0], 4000)) < len(many) / 3
    assert len(places_seen(CAMERA, INTRINSICS, SIZE, [0.0, 0.04], 1)) > 1.5 * len(many)


def test_upper_and_lower_faces_of_bodies_are_places() -> None:
    corners = box_mesh((0.06, 0.06, 0.04)).vertices + np.array([0.0, 0.0, 0.06])
    for face, height in ((top_of(corners), 0.08), (bottom_of(corners), 0.04)):
        assert len(face) == 4
        found = places_at(CAMERA, INTRINSICS, SIZE, [face], 72)
        assert len(found) > 3
        assert found[:, 2, 3] == pytest.approx(height)
        assert np.abs(found[:, :2, 3]).max() <= 0.03
    assert places_at(CAMERA, INTRINSICS, SIZE, [], 72).shape == (0, 4, 4)
    faces, many = [top_of(corners)] * 60, 800
    every = places_at(CAMERA, INTRINSICS, SIZE, faces, 1)
    thin = [places_at(CAMERA, INTRINSICS, SIZE, faces, many, turn) for turn in (0, 1)]
    assert all(0 < len(each) * many <= BUDGET + many < len(every) * many for each in thin)
    assert not np.array_equal(thin[0][:1], thin[1][:1])
    assert not len(top_of(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])))


def test_templates_are_kept_for_views_that_are_about_the_same() -> None:
    mesh = box_mesh((0.04, 0.06, 0.09))
    proposer = Proposer(LayerRenderer(shape_of(mesh.vertices, mesh.faces)))
    middle = np.zeros(3)
    templates = proposer.templates(CAMERA, middle, INTRINSICS)
    assert len(templates) == 3 * YAWS // 2
    assert all(len(each["controls"]["points"]) > 5 for each in templates)
    assert proposer.templates(looking_down(0.3, np.radians(40.0), 0.6001, np.zeros(3)), middle, INTRINSICS) is templates
    assert (
        proposer.templates(looking_down(0.3, np.radians(60.0), 0.6, np.zeros(3)), middle, INTRINSICS) is not templates
    )
