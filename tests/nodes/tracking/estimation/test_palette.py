"""What the colours of objects tell: which of several alike ones it is; nothing in a gray image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.appearance import NOTHING, only_found
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.palette import _numbers, coloured, dyed, is_another, palette_of, with_colours
from hierax.nodes.tracking.estimation.profiles import Image, grey_levels, smoothed
from hierax.nodes.tracking.imagery.edges import controls_of
from hierax.nodes.tracking.math.geometry import Array, invert, looking_down, make_pose
from hierax.nodes.tracking.model.controls import gathered
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.nodes.tracking.schema import Looks
from hierax.nodes.tracking.search.multistart import FINE
from hierax.nodes.tracking.simworld.scene import develop, draw
from hierax.nodes.tracking.simworld.shapes import Thing, cube

SIZE, SIDE_M = (640, 480), 0.045
INTRINSICS = np.array([800.0, 800.0, 319.5, 239.5])
CAMERA = looking_down(0.4, 0.75, 0.5, np.zeros(3))
POSES = [make_pose(np.eye(3), np.array([x, y, SIDE_M / 2])) for x, y in ((0.0, -0.08), (0.08, 0.0), (-0.05, 0.05))]
RED, GREEN, BLUE = (200, 60, 50), (60, 160, 80), (70, 80, 190)


def picture(*colours: tuple[int, int, int], light: float = 1.0) -> Array:
    """Three cubes on the table, uint8 RGB."""
    things = [Thing(pose, cube(SIDE_M), colour) for pose, colour in zip(POSES, colours, strict=True)]
    seen = develop(draw(things, CAMERA, INTRINSICS, SIZE), 0.7, 2.0, np.random.default_rng(0))
    return np.asarray(np.rint(light * seen), dtype=np.uint8)


def aligned(image: Image) -> Aligned:
    """The cubes where they are."""
    mesh, seen = box_mesh([SIDE_M] * 3), [invert(CAMERA) @ pose for pose in POSES]
    every = [controls_of(shape_of(mesh.vertices, mesh.faces), pose, INTRINSICS, SIZE, None) for pose in seen]
    controls = gathered([each.sent(each.visible.astype(np.float32)) for each in every])
    memory = memory_of([NOTHING] * 3, controls, image.shape[2])
    found = align(image, controls, Start(np.stack(seen), np.tile(1e8 * np.eye(6), (3, 1, 1))), INTRINSICS, memory, FINE)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def known() -> list[Looks]:
    """What twenty images tell of each cube's looks."""
    shown, looks = aligned(smoothed(picture(RED, GREEN, BLUE))), [NOTHING] * 3
    for _ in range(20):
        looks = [with_colours(each, coloured(shown), at, 20.0) for at, each in enumerate(looks)]
    return looks


@pytest.mark.parametrize("light", [1.0, 0.6])
def test_cubes_have_their_own_colours_and_not_anothers_in_any_light(known: list[Looks], light: float) -> None:
    image = smoothed(picture(RED, GREEN, BLUE, light=light))
    shown, palette = aligned(image), palette_of(image, known)
    assert (dyed(shown, palette, [0, 1, 2]) > const.CLEAR_NATS).all()
    assert is_another(dyed(shown, palette, [1, 2, 0])).all()


def test_of_cubes_of_one_colour_none_is_another(known: list[Looks]) -> None:
    image = smoothed(picture(RED, RED, BLUE))
    said = dyed(aligned(image), palette_of(image, [known[0], known[0], known[2]]), [1, 0, 2])
    assert (said > 0.0).all()


def test_what_nobody_has_seen_yet_may_be_anything(known: list[Looks]) -> None:
    image = smoothed(picture(RED, GREEN, BLUE))
    said = dyed(aligned(image), palette_of(image, [NOTHING, known[1], known[2]]), [0, 1, 2])
    assert said[0] == pytest.approx(0.0, abs=1e-9)
    assert palette_of(image, [NOTHING] * 3) is None


def test_a_gray_image_tells_nothing_and_teaches_nothing(known: list[Looks]) -> None:
    image = smoothed(cv2.cvtColor(picture(RED, GREEN, BLUE), cv2.COLOR_RGB2GRAY))
    shown = aligned(image)
    assert palette_of(image, known) is None
    assert not dyed(shown, None, [0, 1, 2]).any()
    assert with_colours(known[0], coloured(shown), 0, 20.0) is known[0]


def test_what_is_hardly_sure_teaches_little_and_what_clutter_explains_nothing() -> None:
    shown = aligned(smoothed(picture(RED, GREEN, BLUE)))
    assert with_colours(NOTHING, coloured(shown), 0, 0.0) is NOTHING
    sure, hardly = (with_colours(NOTHING, coloured(shown), 0, nats)["dyed"] for nats in (20.0, 0.2))
    assert sure == pytest.approx(1.0)
    assert hardly == pytest.approx(0.1, abs=0.01)


def test_what_was_seen_beside_a_cube_now_and_then_is_not_its_colour(known: list[Looks]) -> None:
    green = aligned(smoothed(picture(GREEN, GREEN, BLUE)))
    muddled, image = known[0], smoothed(picture(GREEN, GREEN, BLUE))
    muddled = with_colours({**muddled, "dyed": 40.0}, coloured(green), 0, 20.0)
    assert is_another(dyed(green, palette_of(image, [muddled, known[1], known[2]]), [0, 1, 2])[0])


def test_colours_are_kept_where_it_may_be_another_side_that_is_seen(known: list[Looks]) -> None:
    kept = only_found(known[0])
    assert kept["dyed"] == known[0]["dyed"]
    np.testing.assert_array_equal(kept["dye"], known[0]["dye"])


def test_in_an_image_of_one_colour_nothing_is_told() -> None:
    plain = smoothed(np.full((*SIZE[::-1], 3), RED, dtype=np.uint8))
    taught = with_colours(NOTHING, coloured(aligned(smoothed(picture(RED, GREEN, BLUE)))), 0, 20.0)
    one = np.zeros(const.DYES**2, dtype=np.float32)
    one[_numbers(grey_levels(plain[:1, :1]).reshape(1, 3))] = 1.0
    palette = palette_of(plain, [{**taught, "dye": one}])
    assert palette is not None
    assert np.abs(palette[0, one > 0]).max() < 0.02
