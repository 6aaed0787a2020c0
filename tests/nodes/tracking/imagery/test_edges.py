"""Control points: on edges that the camera sees, and none on those that the object hides of itself."""

from __future__ import annotations

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, cast
from support.meshes import ELL_BOXES, cylinder, divided, ell, sphere

from hierax.nodes.tracking.constants import POINTS_MAX, SPACING_PX
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.imagery.layers import LayerRenderer
from hierax.nodes.tracking.math.geometry import exp_so3, invert, make_pose, project, transform
from hierax.nodes.tracking.model.controls import CREASE, LIMB, OUTLINE, Controls
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of

BOX = (0.08, 0.06, 0.1)


def controls(mesh: tuple[np.ndarray, np.ndarray], pose: np.ndarray) -> Controls:
    shape = shape_of(*mesh)
    renderer = LayerRenderer(shape)
    return controls_of(shape, pose, INTRINSICS, SIZE, renderer.layer(pose, INTRINSICS, SIZE))


def some_pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_pose(exp_so3(rng.normal(size=3)), [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.7)])


@pytest.mark.parametrize("seed", range(6))
def test_a_box_seen_from_anywhere(seed: int) -> None:
    pose = some_pose(seed)
    found = controls(box_mesh(BOX), pose)
    half = np.array(BOX) / 2
    on_sides = (np.abs(np.abs(found.points) - half) < 1e-9).sum(axis=1)
    assert (on_sides == 2).all()
    assert (np.diff(found.edges) >= 0).all()
    assert (found.visible == 1.0).all()
    # Just inside of an outline the box is seen, just outside it is not; beside a crease it is seen on both sides.
    exact = cast([Box(1, BOX, pose)]).labels
    step = 3.0 / 525.0 * pose[2, 3]
    across = project(transform(pose, found.points + 1e-4 * found.inwards), INTRINSICS)
    here = project(transform(pose, found.points), INTRINSICS)
    across = (across - here) / np.linalg.norm(across - here, axis=1, keepdims=True)
    along = project(transform(pose, found.points + step * found.tangents), INTRINSICS) - here
    normals = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    normals *= np.sign(np.sum(normals * across, axis=1, keepdims=True))
    inner, outer = (np.rint(here + sign * 2.0 * normals).astype(int) for sign in (1, -1))
    assert (exact[inner[:, 1], inner[:, 0]] == 1).mean() > 0.9
    assert (exact[outer[:, 1], outer[:, 0]] == np.where(found.kinds == CREASE, 1, 0)).mean() > 0.9
    assert np.array_equal(found.faces[:, 1] >= 0, found.kinds == CREASE)
    # Evenly spaced along each edge.
    for edge in np.unique(found.edges):
        gaps = np.linalg.norm(np.diff(here[found.edges == edge], axis=0), axis=1)
        assert gaps == pytest.approx(SPACING_PX, rel=0.5)


def test_an_edge_keeps_its_number_whatever_is_seen_of_it() -> None:
    found = [controls(box_mesh(BOX), some_pose(seed)) for seed in range(6)]
    for one in found:
        for other in found:
            for number in np.intersect1d(one.edges, other.edges):
                first, second = (part.points[part.edges == number] for part in (one, other))
                start, along = first[0], first[-1] - first[0]
                off = np.cross(second - start, along / max(np.linalg.norm(along), 1e-9))
                assert len(first) == 1 or np.linalg.norm(off, axis=1).max() < 1e-9


def test_triangles_within_a_side_are_no_edges() -> None:
    pose = some_pose(1)
    whole, cut = controls(box_mesh(BOX), pose), controls(divided(*box_mesh(BOX)), pose)
    assert len(whole.points) == len(cut.points)
    assert len(np.unique(whole.edges)) == len(np.unique(cut.edges))


@pytest.mark.parametrize("seed", range(8))
def test_what_a_body_hides_of_itself_is_left_out(seed: int) -> None:
    pose = some_pose(seed)
    found = controls(ell(), pose)
    boxes = [Box(1, size, pose @ make_pose(np.eye(3), centre)) for size, centre in ELL_BOXES]
    depth = cast(boxes).depth
    seen = transform(pose, found.points)
    columns, rows = np.rint(project(seen, INTRINSICS)).astype(int).T
    around = np.stack([depth[rows + dy, columns + dx] for dy in (-2, 0, 2) for dx in (-2, 0, 2)])
    farthest = np.where(around == 0, np.inf, around).max(axis=0)
    assert (farthest > seen[:, 2] - 0.003).all()
    # What another ray casting shows as an outline is there: its length in pixels.
    edges = (depth > 0).astype(int)
    border = (np.diff(edges, axis=0) != 0).sum() + (np.diff(edges, axis=1) != 0).sum()
    assert 0.6 * border < SPACING_PX * (found.kinds == OUTLINE).sum() < 1.6 * border


@pytest.mark.parametrize("degrees", [-4.0, -3.0, -1.5, 0.0])
def test_a_sides_far_edge_is_listed_until_the_side_turns_away(degrees: float) -> None:
    # Without a back its sides may be seen from within: it is what stands before the edge that hides it.
    mesh = box_mesh((0.1, 0.1, 0.1))
    back = (mesh.vertices[mesh.faces][:, :, 2] > 0).all(axis=1)
    pose = make_pose(exp_so3(np.array([0.0, np.arctan2(0.01, 0.45) + np.radians(degrees), 0.0])), [-0.06, 0.0, 0.5])
    found = controls((mesh.vertices, mesh.faces[~back]), pose)
    upright = (found.points[:, 0] > 0.0499) & (np.abs(found.tangents[:, 1]) > 0.9)
    far = upright & (found.points[:, 2] > 0.0499)
    ends = project(transform(pose, np.array([[0.05, 0.0, 0.05], [0.05, 0.0, -0.05]])), INTRINSICS)
    assert (upright & ~far).sum() > 20
    assert far.sum() == (0 if degrees < -2.0 else 23)
    assert (ends[0, 0] > ends[1, 0]) == (degrees > -2.0)
    assert abs(ends[0, 0] - ends[1, 0]) < 5.0


def test_an_open_box_shows_its_inside() -> None:
    mesh = box_mesh((0.1, 0.1, 0.06))
    top = np.nonzero((mesh.vertices[mesh.faces][:, :, 2] > 0).all(axis=1))[0]
    open_box = (mesh.vertices, np.delete(mesh.faces, top, axis=0))
    pose = make_pose(exp_so3(np.array([np.pi - 0.5, 0.0, 0.0])), [0.0, 0.0, 0.4])
    found = controls(open_box, pose)
    floor = (np.abs(found.points[:, 2] + 0.03) < 1e-9) & (found.kinds == CREASE)
    rim = np.abs(found.points[:, 2] - 0.03) < 1e-9
    assert floor.sum() > 10
    assert (found.kinds[rim] == OUTLINE).all()
    assert len(np.unique(found.edges[rim])) == 4


def test_a_sphere_has_points_where_it_turns_away() -> None:
    pose = make_pose(exp_so3(np.array([0.4, 0.2, 0.1])), [0.03, -0.02, 0.5])
    found = controls(sphere(0.05, 60, 60), pose)
    centre = invert(pose)[:3, 3]
    assert len(found.points) > 50
    assert (found.kinds == LIMB).all()
    assert (found.faces[:, 1] == -1).all()
    rays = found.points - centre
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    outwards = found.points / np.linalg.norm(found.points, axis=1, keepdims=True)
    assert np.abs(np.sum(rays * outwards, axis=1)).max() < 0.06
    assert np.sum(outwards * found.inwards, axis=1).max() < -0.99
    assert np.abs(np.sum(outwards * found.tangents, axis=1)).max() < 0.06
    # One behind the other on each arc, each arc where the one of its number always is.
    pixels = project(transform(pose, found.points), INTRINSICS)
    for edge in np.unique(found.edges):
        part = pixels[found.edges == edge]
        assert np.linalg.norm(np.diff(part, axis=0), axis=1).max() < 2.6 * SPACING_PX
    rolled = pose @ make_pose(exp_so3(np.array([0.3, -0.5, 0.4])), np.zeros(3))
    turned = controls(sphere(0.05, 60, 60), rolled)
    other = project(transform(rolled, turned.points), INTRINSICS)
    assert np.array_equal(np.unique(found.edges), np.unique(turned.edges))
    for edge in np.unique(found.edges):
        apart = pixels[found.edges == edge].mean(axis=0) - other[turned.edges == edge].mean(axis=0)
        assert np.linalg.norm(apart) < 2.0 * SPACING_PX
    # In the image: on the true outline.
    angle = np.arccos(-np.sum(rays * centre / np.linalg.norm(centre), axis=1))
    assert np.abs(angle - np.arcsin(0.05 / np.linalg.norm(centre))).max() * 525.0 < 0.3


def test_a_cylinder_has_rims_and_two_straight_sides() -> None:
    pose = make_pose(exp_so3(np.array([2.0, 0.3, 0.1])), [0.0, 0.0, 0.4])
    found = controls(cylinder(0.03, 0.08, 64), pose)
    rims = np.abs(np.abs(found.points[:, 2]) - 0.04) < 1e-9
    sides = ~rims
    assert np.linalg.norm(found.points[rims][:, :2], axis=1) == pytest.approx(0.03, rel=0.01)
    assert len(np.intersect1d(found.edges[rims], found.edges[sides])) == 0
    assert len(np.unique(found.edges[sides])) == 2
    assert (found.kinds[sides] == LIMB).all()
    assert np.abs(found.tangents[sides][:, 2]).min() > 0.99
    assert np.linalg.norm(found.points[sides][:, :2], axis=1) == pytest.approx(0.03, rel=0.01)
    assert (found.kinds == CREASE).sum() > 10


def test_points_are_few_and_in_the_image() -> None:
    near = controls(box_mesh((0.4, 0.3, 0.2)), make_pose(exp_so3(np.array([0.6, 0.4, 0.2])), [0.0, 0.0, 0.55]))
    assert 100 < len(near.points) <= POINTS_MAX
    pose = make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [0.29, 0.0, 0.5])
    beside = controls(box_mesh(BOX), pose)
    pixels = project(transform(pose, beside.points), INTRINSICS)
    assert len(pixels) > 10
    assert pixels[:, 0].max() < SIZE[0] + 8
    for position in ([0.0, 0.0, -0.5], [9.0, 0.0, 0.5]):
        assert len(controls(box_mesh(BOX), make_pose(np.eye(3), position)).points) == 0
