"""What several objects are chosen to be together: what floats needs something that carries it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hierax.nodes.tracking.estimation.alignment import Aligned
from hierax.nodes.tracking.math.geometry import Floats, make_pose
from hierax.nodes.tracking.search.together import Judged, Together, conflicts_of, hidden_of, look_alike

WORTH = np.array([38.0, 39.0, 46.0, 24.0])


def test_what_floats_does_not_take_what_another_on_the_table_explains_about_as_well() -> None:
    # A small cube in the air (row 1) looks like a larger one on the table (0); that one could be the small one's (2).
    options, conflicts = {1: [0], 2: [1, 2]}, {(0, 1), (1, 0)}
    together = Together(options, WORTH, conflicts, {1: set()}, 2, {})
    assert together.best(()) == (84.0, {1: 0, 2: 2})
    assert together.best([2]) == (38.0, {1: 0})


def test_what_floats_may_stand_on_one_that_is_not_found_or_on_one_that_is_chosen() -> None:
    alone = Together({1: [1]}, WORTH, set(), {1: {3}}, 2, {})
    assert 24.0 < alone.best(())[0] < 39.0
    assert alone.best(())[1] == {1: 1}
    stacked = Together({1: [1], 2: [3]}, WORTH, set(), {1: {3}}, 2, {})
    assert stacked.best(()) == (63.0, {1: 1, 2: 3})
    # Of two bodies that both float, neither carries the other: one of them is not there.
    apart = Together({1: [1], 2: [3]}, WORTH, set(), {1: set(), 3: set()}, 2, {})
    assert apart.best(())[1] == {1: 1}


def test_what_another_hides_of_one_says_nothing_against_it() -> None:
    options = {1: [0], 2: [1, 3]}
    hidden = {(3, 0): 14.0, (0, 1): -2.0}  # of row 3 nats are missing where 0 is in front of it
    together = Together(options, WORTH, set(), {}, 2, hidden)
    assert together.best(()) == (76.0, {1: 0, 2: 3})
    assert together.best([0]) == (39.0, {2: 1})
    assert together.gained(3, [0]) == 14.0
    assert together.gained(0, [3]) == 0.0


def stacked(owners: Sequence[int], poses: Sequence[Floats], side_m: float) -> Judged:
    """Cubes, each with its upper and lower corners as control points, of which half say 1 nat, half -1."""
    corners = 0.5 * side_m * np.array(list(product((-1.0, 1.0), repeat=3)))
    rows = np.repeat(np.arange(len(poses)), len(corners))
    controls = SimpleNamespace(
        owners=rows, points=np.tile(corners, (len(poses), 1)), visible=np.ones(len(rows)), creases=np.zeros(len(rows))
    )
    fine = SimpleNamespace(poses=np.stack(poses), stage=SimpleNamespace(controls=controls))
    boxes = np.tile(np.array([corners.min(axis=0), corners.max(axis=0)]), (len(poses), 1, 1))
    # the image's edge between two cubes that stand on one another is claimed by both
    claimed = np.column_stack((np.linspace(0.0, 40.0, 11), np.zeros((11, 2)), np.ones(11)))
    worth, lines = np.full(len(poses), 20.0), np.tile([1.0, -1.0], len(rows) // 2)
    return Judged(
        np.array(owners),
        cast(Aligned, fine),
        worth,
        worth,
        np.tile(np.eye(6), (len(poses), 1, 1)),
        boxes,
        [claimed] * len(poses),
        lines,
        np.full(len(poses), 4.0),
        np.zeros(len(poses)),
        np.zeros(len(poses), dtype=bool),
        np.ones(len(poses), dtype=bool),
    )


def at(*place_m: float) -> Floats:
    return make_pose(np.eye(3), np.array(place_m))


# the camera looks along z, and up is -y
LEVEL = np.array([0.0, -1.0, 0.0, 0.1])


def test_one_that_stands_on_another_may_share_an_edge_with_it() -> None:
    lower, upper, beside = at(0.0, 0.08, 0.5), at(0.0, 0.04, 0.5), at(0.041, 0.08, 0.5)
    judged = stacked([1, 2, 2], [lower, upper, beside], 0.04)
    assert conflicts_of(judged, [0, 1], LEVEL) == set()
    assert conflicts_of(judged, [0, 2], LEVEL) == {(0, 2), (2, 0)}
    inside = stacked([1, 2], [lower, at(0.0, 0.075, 0.5)], 0.04)
    assert conflicts_of(inside, [0, 1], LEVEL) == {(0, 1), (1, 0)}


def test_what_is_behind_another_loses_what_the_hidden_part_says() -> None:
    front, behind, beside = at(0.0, 0.0, 0.4), at(0.0, 0.0, 0.6), at(0.2, 0.0, 0.6)
    hidden = hidden_of(stacked([1, 2, 2], [front, behind, beside], 0.04), [0, 1, 2])
    assert hidden == {(1, 0): pytest.approx(-4.0)}  # its points' nats are as many for as against it
    half = at(-0.036, 0.0, 0.6)  # its right side is behind the other's left one
    gains = hidden_of(stacked([1, 2], [front, half], 0.04), [0, 1])
    assert gains == {(1, 0): pytest.approx(-2.0)}


def test_poses_that_differ_in_how_far_away_they_are_show_the_same() -> None:
    judged = stacked([1, 1, 1], [at(0.0, 0.0, 0.6), at(0.0, 0.0, 0.612), at(0.008, 0.0, 0.6)], 0.04)
    assert look_alike(judged, 0, [0, 1, 2]) == [0, 1]
