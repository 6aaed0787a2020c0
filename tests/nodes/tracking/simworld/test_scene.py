"""The simulated pictures: geometry against an independent ray caster, shadows, and the sensor."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest

from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, invert, make_pose, rays
from hierax.nodes.tracking.simworld import light as sim_light
from hierax.nodes.tracking.simworld import scene as sim_scene
from hierax.nodes.tracking.simworld.light import LAMP, Lamp, shaded, shadows
from hierax.nodes.tracking.simworld.scene import FACE_PX, GAMMA, QUANTILES, develop, draw, drawn_quantiles
from hierax.nodes.tracking.simworld.shapes import Face, Thing, cube
from hierax.nodes.tracking.simworld.world import camera_at

SIZE = (160, 120)
INTRINSICS = np.array([150.0, 155.0, 81.3, 57.9])
CUBES = [
    Thing(make_pose(exp_so3(np.array([0.0, 0.0, 0.5])), np.array([0.05, 0.02, 0.04])), cube(0.08), (200, 40, 40)),
    Thing(make_pose(exp_so3(np.array([0.0, 0.0, 0.9])), np.array([0.05, 0.02, 0.11])), cube(0.06), (40, 60, 200)),
    Thing(make_pose(exp_so3(np.array([0.3, -0.2, 0.1])), np.array([-0.06, -0.08, 0.06])), cube(0.05), (30, 170, 60)),
]


def ray_cast(cubes: list[Thing], camera: Floats, intrinsics: Floats = INTRINSICS) -> Array:
    """Number of the cube at each pixel's centre, -1 where there is none: slab by slab, in each cube's own frame."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    directions = rays(np.stack((columns, rows), axis=-1), intrinsics) @ camera[:3, :3].T
    nearest = np.full(columns.shape, np.inf)
    found = np.full(columns.shape, -1)
    for number, each in enumerate(cubes):
        to_object = invert(each.pose)
        start = to_object[:3, :3] @ camera[:3, 3] + to_object[:3, 3]
        along = directions @ to_object[:3, :3].T
        ends = np.stack([(corner - start) / along for corner in each.shape.convex[0][[0, -1]]])
        enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        hit = (enter < leave) & (enter > 0) & (enter < nearest)
        nearest[hit] = enter[hit]
        found[hit] = number
    return found


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_every_pixel_shows_the_cube_that_a_ray_meets(order: tuple[int, ...]) -> None:
    camera = camera_at(0.3)
    picture = draw([CUBES[number] for number in order], camera, INTRINSICS, SIZE)
    expected = ray_cast(CUBES, camera)
    brightest = picture.argmax(axis=-1)
    channel = {0: 0, 1: 2, 2: 1}
    inner = np.zeros(expected.shape, bool)
    inner[1:-1, 1:-1] = True
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        inner &= expected == np.roll(expected, (dy, dx), axis=(0, 1))
    for number in range(len(CUBES)):
        seen = inner & (expected == number)
        assert seen.sum() > 100
        pure = picture[seen]
        assert (brightest[seen] == channel[number]).all()
        assert (pure.max(axis=1) > 2.0 * pure.min(axis=1)).all()


def test_a_silhouette_is_where_it_belongs_to_a_hundredth_of_a_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sim_scene, "_grain", lambda: np.ones((FACE_PX, FACE_PX), np.float32))
    cube, camera = CUBES[2]._replace(colour=(250, 0, 0)), camera_at(0.0)
    even = Lamp(diffuse=0.0)
    bright = draw([cube], camera, INTRINSICS, SIZE, even)[..., 0]
    dark = draw([cube._replace(colour=(0, 0, 0))], camera, INTRINSICS, SIZE, even)[..., 0]
    cover = (bright - dark) / (250.0 / 255.0 * even.ambient) ** GAMMA
    samples = 6
    expected = np.zeros(cover.shape)
    for dx, dy in product((np.arange(samples) + 0.5) / samples - 0.5, repeat=2):
        expected += ray_cast([cube], camera, INTRINSICS - np.array([0.0, 0.0, dx, dy])) == 0
    expected /= samples**2
    assert cover.sum() == pytest.approx(expected.sum(), rel=0.003)
    for place in np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])):
        centre = (cover * place).sum() / cover.sum()
        assert centre == pytest.approx((expected * place).sum() / expected.sum(), abs=0.01)


def test_faces_look_outwards() -> None:
    for face in CUBES[2].faces():
        middle = face.corner + (face.right + face.up) / 2
        outwards = middle - CUBES[2].pose[:3, 3]
        np.testing.assert_allclose(face.normal * 0.05 / 2, outwards, atol=1e-12)


def test_a_shadow_lies_where_rays_to_the_lamp_are_blocked() -> None:
    """Against an independent test: from points of the table towards the lamp's middle."""
    each = CUBES[0]
    table = Face(np.array([-0.5, -0.5, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    pixels = 200
    homography = np.array([[pixels, 0.0, -0.5], [0.0, pixels, -0.5], [0.0, 0.0, 1.0]])
    light = light_on(table, each.parts(), pixels, homography)
    place = (np.arange(pixels) + 0.5) / pixels - 0.5
    points = np.stack((*np.meshgrid(place, place), np.zeros((pixels, pixels))), axis=-1)
    to_object = invert(each.pose)
    starts, along = points @ to_object[:3, :3].T + to_object[:3, 3], to_object[:3, :3] @ LAMP.direction
    ends = np.stack([(corner - starts) / along for corner in each.shape.convex[0][[0, -1]]])
    blocked = ends.min(axis=0).max(axis=-1) < ends.max(axis=0).min(axis=-1)
    full = LAMP.ambient + LAMP.diffuse * LAMP.direction[2]
    assert light.max() == pytest.approx(full, rel=1e-5)
    dark = (full - light) / (LAMP.diffuse * LAMP.direction[2])
    assert dark[blocked].mean() > 0.9
    assert dark.sum() == pytest.approx(blocked.sum(), rel=0.02)


def test_a_cube_that_stands_on_a_face_throws_no_shadow_below_it() -> None:
    lower, upper = CUBES[0], CUBES[1]
    top, bottom = lower.faces()[5], lower.faces()[4]
    (corners,) = upper.parts()
    assert len(shadows(corners, top)) > 0
    assert shadows(corners, bottom) == []
    (standing_below,) = lower.parts()
    assert shadows(standing_below, upper.faces()[5]) == []


def test_drawing_is_equal_to_the_bit() -> None:
    camera = camera_at(0.5)
    assert draw(CUBES, camera, INTRINSICS, SIZE).tobytes() == draw(CUBES, camera, INTRINSICS, SIZE).tobytes()


def test_a_scene_out_of_sight_is_the_table_alone() -> None:
    away = [CUBES[0]._replace(pose=make_pose(np.eye(3), np.array([5.0, 5.0, 0.04])))]
    camera = camera_at(0.0)
    np.testing.assert_array_equal(draw(away, camera, INTRINSICS, SIZE), draw([], camera, INTRINSICS, SIZE))


@pytest.mark.parametrize("shape", [(1,), (7, 5), (12, 16, 3)])
def test_noise_is_drawn_as_the_generator_draws_whole_numbers(shape: tuple[int, ...]) -> None:
    drawn = np.random.default_rng(3).integers(0, QUANTILES, shape, np.uint8)
    np.testing.assert_array_equal(drawn_quantiles(np.random.default_rng(3), shape), drawn)


def test_the_sensor_adds_noise_of_the_given_size() -> None:
    grey = np.full((100, 100, 3), (128.0 / 255.0) ** GAMMA, np.float32)
    image = develop(grey, 0.0, 3.0, np.random.default_rng(1))
    assert image.dtype == np.uint8
    assert image.astype(float).std() == pytest.approx(3.0, rel=0.05)
    np.testing.assert_array_equal(develop(grey, 0.7, 0.0, np.random.default_rng(1)), 128)


def test_the_sensor_stays_within_its_range() -> None:
    ends = np.array([[[-0.1, 0.0, 1.2]]], np.float32)
    np.testing.assert_array_equal(develop(ends, 0.0, 0.0, np.random.default_rng(1)), [[[0, 0, 255]]])


def test_nothing_is_dark_where_nothing_is_in_the_way() -> None:
    """A face that looks away from the lamp is in no shadow, nor one that nothing rises over, or all is beside."""
    parts = [corners for each in CUBES for corners in each.parts()]
    pixels, to_pixels = (50, 50), np.array([[50.0, 0.0, -0.5], [0.0, 50.0, -0.5], [0.0, 0.0, 1.0]])
    away = [face for each in CUBES for face in each.faces() if face.normal @ LAMP.direction <= 0]
    highest = CUBES[1].faces()[5]
    beside = Face(np.array([1.0, 1.0, 0.0]), np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]))
    assert away
    for face in (*away, highest, beside):
        assert shaded(face, parts, pixels, to_pixels)[2].size == 0
    assert shaded(CUBES[0].faces()[5], parts, pixels, to_pixels)[2].size > 0


@pytest.mark.parametrize("seed", range(4))
def test_a_face_is_out_of_all_shadows_that_do_not_reach_it(seed: int) -> None:
    """Also where a cube sticks through its plane, askew."""
    rng, said = np.random.default_rng(seed), 0
    table = Face(np.array([-0.3, -0.3, 0.0]), np.array([0.6, 0.0, 0.0]), np.array([0.0, 0.6, 0.0]))
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    for _ in range(20):
        pose = make_pose(exp_so3(rng.normal(size=3)), np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.05, 0.05)]))
        (corners,) = Thing(pose, cube(0.08), (200, 40, 40)).parts()
        whole = shadows(corners, table)
        for a, b in rng.uniform(0.0, 0.95, (200, 2)) if whole else ():
            part = Face(table.corner + a * table.right + b * table.up, 0.05 * table.right, 0.05 * table.up)
            if not shadows(corners, part):
                shares = [((each - (a, b)) / 0.05).astype(np.float32) for each in whole]
                assert max(cv2.intersectConvexConvex(each, square)[0] for each in shares) < 1e-3, f"seed {seed}"
                said += 1
    assert said > 100


def light_on(face: Face, parts: list[Floats], pixels: int, homography: Floats) -> Array:
    bright, (left, top, right, bottom), shade = shaded(face, parts, (pixels, pixels), homography)
    light = np.full((pixels, pixels), bright, np.float32)
    light[top:bottom, left:right] = shade
    return light


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.785, 1.2])
def test_a_shadow_covers_as_much_as_its_polygon(turn: float) -> None:
    """Also a thin one, wherever it is between pixels; and what is thinner than a pixel's edge covers nothing."""
    corners = np.array([[-20.0, -9.0], [18.0, -11.0], [24.0, 8.0], [-6.0, 12.0]])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for size, place in product((1.0, 0.4), np.random.default_rng(4).uniform(29.0, 31.0, (6, 2))):
        polygon = size * corners @ rotation.T + place
        x, y = polygon.T
        area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
        for way in (polygon, polygon[::-1]):
            mask = np.zeros((60, 60), np.uint8)
            sim_light._fill(mask, way)
            assert mask.sum() / 255.0 == pytest.approx(area, rel=0.03 / size)
    mask = np.zeros((60, 60), np.uint8)
    for thin in ([[5.0, 5.0], [40.0, 5.0], [40.0, 5.4], [5.0, 5.4]], [[5.0, 5.0], [40.0, 30.0]], [[7.0, 7.0]]):
        sim_light._fill(mask, np.array(thin))
    assert not mask.any()


def test_noise_is_normal_and_another_one_in_each_picture() -> None:
    grey = np.full((200, 300, 3), (128.0 / 255.0) ** GAMMA, np.float32)
    one, other = (develop(grey, 0.0, 20.0, np.random.default_rng(seed)).astype(float) - 128.0 for seed in (1, 2))
    assert one.mean() == pytest.approx(0.0, abs=0.3)
    for deviations, share in ((1.0, 0.6827), (2.0, 0.9545), (3.0, 0.9973)):
        assert (abs(one) < 20.0 * deviations).mean() == pytest.approx(share, abs=0.02)
    neighbours = (one[:, 1:] * one[:, :-1]).mean(), (one[1:] * one[:-1]).mean(), (one * other).mean()
    assert np.allclose(np.array(neighbours) / 400.0, 0.0, atol=0.02)
