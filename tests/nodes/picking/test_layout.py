"""Scenes: room between cubes, stacks, and guesses that are a little wrong."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.picking.layout import GUESS_M, GUESS_RAD, SIDES_M, guessed, planned
from hierax.nodes.tracking.math.geometry import pose_error

SCENES = range(40)


@pytest.mark.parametrize("scene", [0, 1, 2, 3])
def test_a_scene_is_always_the_same_and_no_other(scene: int) -> None:
    first, again, other = planned(scene), planned(scene), planned(scene + 2)
    for one, two, three in zip(first, again, other, strict=True):
        assert np.array_equal(one.pose, two.pose)
        assert not np.allclose(one.pose, three.pose, atol=1e-3)


def test_cubes_stand_on_the_table_or_on_one_another_with_room_for_errors() -> None:
    for scene in SCENES:
        places = planned(scene)
        for place in places:
            below = places[place.below - 1].side_m if place.below else 0.0
            assert place.pose[2, 3] == pytest.approx(below + place.side_m / 2)
        standing = [place for place in places if not place.below]
        for index, one in enumerate(standing):
            for two in standing[:index]:
                between = np.linalg.norm(one.pose[:2, 3] - two.pose[:2, 3])
                assert between - (one.side_m + two.side_m) / 2**0.5 >= 0.008, f"scene {scene}: {one.id}, {two.id}"


def test_every_other_scene_has_a_stack() -> None:
    for scene in SCENES:
        assert [place.below for place in planned(scene)] == [0, scene % 2, 0, 0, 0]


def test_guesses_are_wrong_by_as_much_as_is_said() -> None:
    errors = [
        pose_error(guess, place.pose)
        for scene in SCENES
        for guess, place in zip(guessed(scene), planned(scene), strict=True)
    ]
    distances, angles = np.array(errors).T
    assert 0.8 * GUESS_M < distances.max() <= GUESS_M + 1e-9
    assert 0.8 * GUESS_RAD < angles.max() <= GUESS_RAD + 1e-9
    assert distances.min() > 0.0


def test_fewer_cubes_are_the_first_ones() -> None:
    for two, five in zip(planned(3, 2), planned(3), strict=False):
        assert np.array_equal(two.pose, five.pose)


@pytest.mark.parametrize(
    ("scene", "cubes", "said"), [(-1, 5, "scene is -1"), (0, 0, "cubes is 0"), (0, 7, "cubes is 7")]
)
def test_what_is_out_of_range_is_named(scene: int, cubes: int, said: str) -> None:
    assert len(SIDES_M) == 6
    with pytest.raises(ValueError, match=said):
        planned(scene, cubes)
