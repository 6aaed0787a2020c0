"""What is known of how large objects are beside their models, from all of them together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import Box
from support.drawn import BOXES, all_expected

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.drift import joint_of, loosened, together_of
from hierax.nodes.tracking.estimation.fusion import Rows
from hierax.nodes.tracking.estimation.sizes import at_least_usual, by_tolerances, expected_sizes, sizes_of

REPORTS = np.diag([0.0015**2] * 3 + [0.0025**2] * 3)
KNOWN = np.diag([1e-8] * 27)  # of three objects and a drift


def three(off: tuple[float, ...] = (0.0, 0.0, 0.0), tolerance: float = 0.0) -> list[dict[str, Any]]:
    """Boxes that are so much larger than their models, whose models are as imprecise as that."""
    boxes = [*BOXES, Box(3, BOXES[0].size, BOXES[1].pose)]
    items = all_expected(boxes, [box.pose for box in boxes])
    return [
        {**item, "slots": {**item["slots"], "size": 1.0 + by, "tolerance": tolerance}}
        for item, by in zip(items, off, strict=True)
    ]


@pytest.mark.parametrize(("off", "least", "most"), [((0.0, 0.0, 0.0), 0.0, 0.6), ((0.012, -0.012, 0.0), 1.2, 2.0)])
def test_how_far_models_are_from_what_they_are_of_is_learned_from_all(
    off: tuple[float, ...], least: float, most: float
) -> None:
    """Of three that are known to be as large as told, or by how much they are not; as if one more were as expected."""
    items = three(off)
    sizes = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 1.0)
    assert least < sizes.alike < most
    common = const.SIZES_TOGETHER
    share = common / (1.0 - common + 3.0 * common)  # of the sum of all, what all have in common
    each = np.array(off) / const.SIZES - share * sum(off) / const.SIZES
    varied = 1e-8 / const.SIZES**2 * ((1.0 - share) ** 2 + 2.0 * share**2) + (1.0 - common) * share
    squares = (each**2 + varied) / (1.0 - common)
    assert sizes.alike == pytest.approx(np.sqrt((1.0 + squares.sum()) / 4.0))


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.001, -0.001, 0.002)])
def test_what_is_told_is_that_sizes_are_as_their_models(off: tuple[float, ...]) -> None:
    items = three(off)
    sizes = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 1.0)
    assert sizes.alike < 1.0
    np.testing.assert_allclose(sizes.told[1], [1.0 / (1.0 + by) - 1.0 for by in off], atol=1e-12)


def test_what_was_learned_is_not_learned_again() -> None:
    items, alike = three((0.003, -0.003, 0.004)), 1.0
    for _ in range(60):
        alike = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), alike).alike
    again = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), alike)
    assert again.alike == pytest.approx(alike, abs=1e-9)
    np.testing.assert_allclose(again.told[0], 0.0, atol=1e-3)
    np.testing.assert_allclose(again.looser, 0.0, atol=1e-12)


def test_what_all_are_off_alike_counts_less() -> None:
    alike, differing = (
        sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 1.0).alike
        for items in (three((0.005, 0.005, 0.005)), three((0.005, -0.005, 0.005)))
    )
    assert alike < differing - 0.05


def test_sizes_that_are_alike_are_known_better_but_for_what_they_have_in_common() -> None:
    items = three()
    found = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 1.0)
    information, which = found.told
    assert np.linalg.eigvalsh(information).min() > -1e-6
    np.testing.assert_array_equal(which, 0.0)
    np.testing.assert_array_equal(found.looser, 0.0)
    common, difference = np.ones(3) / np.sqrt(3.0), np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    assert common @ information @ common < 0.5 * difference @ information @ difference
    known = np.linalg.inv(np.linalg.inv(expected_sizes(items, const.SIZES).covariance(1.0)) + information)
    np.testing.assert_allclose(known, expected_sizes(items, const.SIZES).covariance(found.alike), rtol=1e-6)


def test_nothing_that_was_told_is_taken_away() -> None:
    """It would be more than there is of what is new."""
    items = three((0.012, -0.012, 0.0))
    found = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 0.3)
    assert not found.told[0].any()
    assert (found.looser > 0.0).all()
    before, after = (
        joint_of(items, None, REPORTS, learned=each) for each in (found._replace(looser=np.zeros(3)), found)
    )
    rows = np.r_[Rows.sizes(3)]
    np.testing.assert_allclose((after - before)[np.ix_(rows, rows)], np.diag(found.looser), atol=1e-18)


def test_nothing_is_learned_of_sizes_before_the_first_image_or_of_what_is_lost() -> None:
    items = three()
    assert sizes_of(items, None, 0.6).alike == 0.6
    items[1]["status"] = "lost"
    lost = sizes_of(items, together_of(items, [0, 1, 2], KNOWN), 1.0)
    assert lost.told[0][0, 0] > 0.0
    np.testing.assert_array_equal(lost.told[0][1], 0.0)


def test_those_that_are_known_tell_of_a_new_one_what_all_have_in_common() -> None:
    """As if all had been there from the beginning, and two of them seen."""
    items = three(tolerance=0.002)
    expected = expected_sizes(items, const.SIZES).covariance(1.0)
    seen = np.diag([1.0 / 0.001**2, 1.0 / 0.001**2, 0.0])
    after = np.linalg.inv(np.linalg.inv(expected) + seen)
    known = np.zeros((20, 20))
    known[:6, :6] = REPORTS
    for at in range(2):
        pose = slice(7 * at + 6, 7 * at + 12)
        known[pose, pose] = items[at]["covariance"]
    rows = np.ix_([12, 19], [12, 19])
    known[rows] = after[:2, :2]
    joint = joint_of(items, together_of(items, [0, 1], known), REPORTS)
    sizes = np.r_[Rows.sizes(3)]
    np.testing.assert_allclose(joint[np.ix_(sizes, sizes)], after, rtol=1e-6)
    assert np.linalg.eigvalsh(joint).min() > -1e-15


@pytest.mark.parametrize("tolerance", [0.0007, 0.002])
def test_a_model_that_turns_out_to_be_imprecise_says_less_of_the_size(tolerance: float) -> None:
    items = three()
    joint = joint_of(items, None, REPORTS)
    after = loosened(joint, items, {0: tolerance, 2: tolerance})
    changed = after - joint
    assert np.linalg.eigvalsh(changed).min() > -1e-15
    rows = np.array([Rows.body(0).stop - 1, Rows.body(2).stop - 1])
    more = by_tolerances([items[0], items[2]], [tolerance] * 2)
    np.testing.assert_allclose(changed[np.ix_(rows, rows)], more.covariance(1.0))
    changed[np.ix_(rows, rows)] = 0.0
    assert not changed.any()
    both = expected_sizes(three(tolerance=tolerance), const.SIZES).covariance(1.0)
    np.testing.assert_allclose(after[np.ix_(rows, rows)], both[np.ix_([0, 2], [0, 2])])


def test_what_is_told_to_be_exact_has_nothing_in_common() -> None:
    items = three()
    np.testing.assert_array_equal(
        expected_sizes(items, const.SAME_SIZE).covariance(1.0), np.diag([const.SAME_SIZE**2] * 3)
    )


def test_where_most_models_are_imprecise_one_that_looks_exact_may_be_of_another_size() -> None:
    assert at_least_usual([0.0, 0.002, 0.0007]) == [0.0007, 0.002, 0.0007]
    assert at_least_usual([0.0, 0.002, 0.0]) == [0.0, 0.002, 0.0]
    assert at_least_usual([]) == []
    items = three(tolerance=0.002)
    items[0]["slots"]["tolerance"] = 0.0
    found, all_loose = (expected_sizes(each, const.SIZES) for each in (items, three(tolerance=0.002)))
    np.testing.assert_array_equal(found.own, all_loose.own)
