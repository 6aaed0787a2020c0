"""Worn edges: what is drawn of them, and where they are expected."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.tracking.estimation.profiles import lines_of, read_profiles, smoothed
from hierax.nodes.tracking.generator.kinds import INTRINSICS, SIZE, film
from hierax.nodes.tracking.generator.worn import RADIUS_M, rounded
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.math.geometry import invert, looking_down, make_pose
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.simworld.light import Lamp
from hierax.nodes.tracking.simworld.scene import develop, draw
from hierax.nodes.tracking.simworld.shapes import Shape, Thing, angle_piece, box, wedge

SHAPES = {
    "box": box((0.05, 0.04, 0.03)),
    "wedge": wedge(0.06, 0.05, 0.04),
    "angle piece": angle_piece(0.06, 0.05, 0.02, 0.04),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_worn_shape_lies_within_the_sharp_one_and_touches_all_its_faces(name: str) -> None:
    sharp = SHAPES[name]
    worn = rounded(sharp, 0.002)
    assert worn.mesh is sharp.mesh
    points = np.concatenate(worn.convex)
    for face in sharp.sides:
        beyond = (points - face.corner) @ face.normal
        if beyond.max() < 0.01:  # not a side in the inner corner
            assert beyond.max() == pytest.approx(0.0, abs=1e-9)
    corners = sharp.mesh.vertices
    nearest = np.linalg.norm(points[:, None] - corners[None], axis=2).min(axis=0)
    assert np.sort(nearest)[: len(corners) // 2].min() > 0.0005
    for side in worn.sides:  # all of them are plane, and look outwards
        assert np.linalg.norm(side.normal) == pytest.approx(1.0)
        assert min(((part - side.corner) @ side.normal).max() for part in worn.convex) < 1e-9


def test_what_is_hardly_worn_is_sharp() -> None:
    assert rounded(SHAPES["box"], -0.001) is SHAPES["box"]


def _inwards_px(shape: Shape, radius_m: float) -> float:
    """How far inwards of where they are expected the outlines of a shape are found on average, in light without
    shadows, seen from many sides."""
    found = []
    for azimuth in np.linspace(0.2, 5.0, 4):
        camera = looking_down(float(azimuth), 0.6, 0.35, np.array([0.0, 0.0, 0.2]))
        thing = Thing(make_pose(np.eye(3), np.array([0.0, 0.0, 0.2])), shape, (235, 235, 230))
        light = draw([thing], camera, INTRINSICS, SIZE, Lamp(ambient=0.9, diffuse=0.0))
        image = smoothed(develop(light, 0.7, 0.0, np.random.default_rng(0)))
        pose, model = invert(camera) @ thing.pose, shape_of(shape.mesh.vertices, shape.mesh.faces)
        controls = controls_of(model, pose, INTRINSICS, SIZE, radius_m=radius_m)
        lines = lines_of(controls, pose[None], INTRINSICS, image.shape)
        places = read_profiles(image, lines, controls.numbers[lines.rows], 3, 1.5).places
        nearest = places[np.arange(len(places)), np.abs(places).argmin(axis=1)]
        found.append(nearest[~controls.creases[lines.rows] & (np.abs(nearest) < 2.5)])
    return float(np.concatenate(found).mean())


@pytest.mark.parametrize("name", ["box", "wedge"])
def test_outlines_of_worn_edges_are_found_where_they_are_expected(name: str) -> None:
    worn = rounded(SHAPES[name], 0.002)
    assert _inwards_px(worn, 0.0) > 0.5, "a sharp model is larger than what is seen"
    assert abs(_inwards_px(worn, 0.002)) < 0.1
    assert abs(_inwards_px(SHAPES[name], 0.0)) < 0.1


def test_scenes_have_sharp_models_of_worn_things() -> None:
    shown = film("worn", 0, 1)
    sides = [len(thing.shape.sides) for thing in shown.things]
    assert max(sides) > 80
    for thing in shown.things:
        points, corners = np.concatenate(thing.shape.convex), thing.shape.mesh.vertices
        apart = np.linalg.norm(points[:, None] - corners[None], axis=2).min(axis=0).max()
        assert apart < RADIUS_M
