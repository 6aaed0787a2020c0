"""What colours decide where edges say the same of several cubes: which one is there, and what is learned of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.coloured import BLUE, CAMERA, GREEN, INTRINSICS, POSES, RED, imagined, item, picture, taught

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.appearance import NOTHING
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.math.geometry import Floats, exp_se3, pose_error
from hierax.nodes.tracking.schema import Looks
from hierax.nodes.tracking.search.association import Options, associate
from hierax.nodes.tracking.search.missing import Sighting, _judged, _Search, look_for_missing
from hierax.nodes.tracking.search.sweep import maps_of

OPTIONS = Options(np.diag([0.01**2] * 3 + [0.06**2] * 3), 0.75)
WIDE = np.diag([0.1**2] * 3 + [0.5**2] * 3)
NEAR = exp_se3(np.array([0.001, -0.001, 0.001, 0.01, -0.01, 0.01]))
AWAY = exp_se3(np.array([0.03, 0.01, 0.03, 0.1, 0.1, 0.0]))
LEVEL = CAMERA[2]
SEEN = smoothed(picture(RED, GREEN, BLUE))


@pytest.fixture(scope="module")
def known() -> list[Looks]:
    return taught(RED, GREEN, BLUE)


def associated(*items: dict[str, Any]) -> list[Any]:
    found = associate(SEEN, list(items), None, INTRINSICS, OPTIONS)
    assert found is not None
    return list(found.estimates)


def lost(number: int, looks: Looks, others: list[Floats]) -> dict[str, Any]:
    """A cube that is looked for, by what is imagined nearest to where another one is."""
    return item(1, POSES[number] @ AWAY, looks, others, covariance=WIDE, status="lost", score=0.0)


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("beside", [0, 1, 2])
def test_of_places_where_a_lost_cube_may_be_that_of_its_colours_is_found(
    known: list[Looks], number: int, beside: int
) -> None:
    (estimate,) = associated(lost(beside, known[number], [pose @ NEAR for pose in POSES]))
    assert estimate.sure
    assert estimate.colours > const.CLEAR_NATS
    assert pose_error(estimate.pose, POSES[number])[0] < 0.002


def test_a_place_of_other_colours_is_neither_believed_nor_guessed(known: list[Looks]) -> None:
    others = [pose @ NEAR for pose in POSES[1:]]
    for looks, believed in ((NOTHING, True), (known[0], False)):
        (estimate,) = associated(lost(1, looks, others))
        poses = [estimate.pose, *estimate.guesses]
        assert any(pose_error(pose, place)[0] < 0.01 for pose in poses for place in POSES[1:]) == believed


def test_a_cube_where_another_one_is_seen_has_nats_against_it_and_learns_nothing_of_its_colours(
    known: list[Looks],
) -> None:
    mistaken, itself = associated(item(1, POSES[1] @ NEAR, known[0]), item(2, POSES[2] @ NEAR, known[2]))
    assert mistaken.colours < -const.CLEAR_NATS
    assert mistaken.slots["dyed"] == known[0]["dyed"]
    np.testing.assert_array_equal(mistaken.slots["dye"], known[0]["dye"])
    assert itself.colours > const.CLEAR_NATS
    assert not np.array_equal(itself.slots["dye"], known[2]["dye"])


def test_what_was_found_just_now_teaches_no_colours() -> None:
    exact: Looks = {**NOTHING, "tolerance": 0.0}
    fresh, tracked = associated(
        item(1, POSES[0] @ NEAR, exact, probation=5), item(2, POSES[1] @ NEAR, exact, probation=0)
    )
    assert fresh.slots["dyed"] == 0.0
    assert tracked.slots["dyed"] > 0.5


def sightings(looks: list[Looks]) -> dict[int, Sighting]:
    """Of two missing cubes, each of which may be where any cube is, before all were looked for everywhere."""
    missing = {"status": "lost", "failed_searches": 0}
    objects = [item(number, POSES[number], each, **missing) for number, each in enumerate(looks)]
    guesses = [imagined(pose @ NEAR) for pose in POSES]
    return look_for_missing(SEEN, objects, dict.fromkeys(range(len(looks)), guesses), (), INTRINSICS, LEVEL)


def test_missing_cubes_of_known_colours_are_found_at_once(known: list[Looks]) -> None:
    found = sightings([known[0], known[2]])
    for at, pose in ((0, POSES[0]), (1, POSES[2])):
        assert found[at].known
        sighted = found[at].pose
        assert sighted is not None
        assert pose_error(sighted, pose)[0] < 0.002


@pytest.mark.parametrize(("tolerance", "score", "fits"), [(None, 0.65, True), (0.0, 0.65, False), (0.0, 0.75, True)])
def test_of_a_model_that_was_judged_before_more_edges_have_to_be_found(
    tolerance: float | None, score: float, fits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    aligned = _Search.aligned

    def scored(*arguments: Any) -> Any:
        fine, *others = aligned(*arguments)
        return fine._replace(scores=np.full(len(fine.scores), score)), *others

    monkeypatch.setattr(_Search, "aligned", scored)
    missing: Any = item(1, POSES[0], {**NOTHING, "tolerance": tolerance}, status="lost")
    guesses: Any = {0: [imagined(POSES[0] @ NEAR)]}
    judged = _judged(_Search(SEEN, INTRINSICS, LEVEL, None), maps_of(SEEN), [missing], guesses)
    assert judged is not None
    assert judged.fits.tolist() == [fits]


@pytest.mark.parametrize(("tolerance", "swept", "believed"), [(None, 0, False), (None, 3, True), (0.0, 0, True)])
def test_what_was_never_seen_is_looked_for_before_another_one_is_believed(
    tolerance: float | None, swept: int, believed: bool
) -> None:
    """It may explain the same edges; what was seen before, and is lost again, keeps no others waiting."""
    one = item(0, POSES[0], {**NOTHING, "tolerance": None}, status="lost", failed_searches=const.SWEEPS_FIRST)
    other = item(1, POSES[1], {**NOTHING, "tolerance": tolerance}, status="lost", failed_searches=swept)
    guesses: Any = {0: [imagined(POSES[0] @ NEAR)], 1: []}
    found = look_for_missing(SEEN, [one, other], guesses, (), INTRINSICS, LEVEL)
    assert (found[0].pose is not None) == believed


def test_of_missing_cubes_of_one_colour_and_of_unknown_ones_none_is_found_at_once(known: list[Looks]) -> None:
    for looks in ([known[0], known[0]], [NOTHING, NOTHING]):
        found = sightings(looks)
        assert [sighting.pose for sighting in found.values()] == [None, None]
        assert not any(sighting.known for sighting in found.values())
