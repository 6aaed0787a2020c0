"""What the colours of objects tell: which of several alike ones it is; nothing in a gray image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.coloured import BLUE, GREEN, RED, SIZE, aligned, picture, taught

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.appearance import NOTHING, only_found
from hierax.nodes.tracking.estimation.palette import _numbers, coloured, dyed, is_another, palette_of, with_colours
from hierax.nodes.tracking.estimation.profiles import grey_levels, smoothed
from hierax.nodes.tracking.schema import Looks


@pytest.fixture(scope="module")
def known() -> list[Looks]:
    return taught(RED, GREEN, BLUE)


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
    red = taught(RED, GREEN, BLUE, images=1)[0]
    one = np.zeros(const.DYES**2, dtype=np.float32)
    one[_numbers(grey_levels(plain[:1, :1]).reshape(1, 3))] = 1.0
    palette = palette_of(plain, [{**red, "dye": one}])
    assert palette is not None
    assert np.abs(palette[0, one > 0]).max() < 0.02
