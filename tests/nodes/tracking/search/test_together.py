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
from hierax.nodes.tracking.search.together import Hidden, Judged, Together, conflicts_of, hidden_of, look_alike

WORTH = np.array([38.0, 39.0, 46.0, 24.0])
OPEN = Hidden({}, {})
ALL = np.ones(1, dtype=bool)


def test_what_floats_does_not_take_what_another_on_the_table_explains_about_as_well() -> None:
    # A small cube in the air (row 1) looks like a larger one on the table (0); that one could be the small one's (2).
    options, conflicts = {1: [0], 2: [1, 2]}, {(0, 1), (1, 0)}
    together = Together(options, WORTH, conflicts, {1: set()}, 2, OPEN)
    assert together.best(()) == (84.0, {1: 0, 2: 2})
    assert together.best([2]) == (38.0, {1: 0})


def test_what_floats_may_stand_on_one_that_is_not_found_or_on_one_that_is_chosen() -> None:
    alone = Together({1: [1]}, WORTH, set(), {1: {3}}, 2, OPEN)
    assert 24.0 < alone.best(())[0] < 39.0
    assert alone.best(())[1] == {1: 1}
    stacked = Together({1: [1], 2: [3]}, WORTH, set(), {1: {3}}, 2, OPEN)
    assert stacked.best(()) == (63.0, {1: 1, 2: 3})
    # Of two bodies that both float, neither carries the other: one of them is not there.
    apart = Together({1: [1], 2: [3]}, WORTH, set(), {1: set(), 3: set()}, 2, OPEN)
    assert apart.best(())[1] == {1: 1}


def test_what_another_hides_of_one_says_nothing_against_it() -> None:
    options = {1: [0], 2: [1, 3]}
    # of row 3 nats are missing where 0 is in front of it
    hidden = Hidden({0: np.array([2.0]), 3: np.array([-14.0])}, {(3, 0): ALL, (0, 1): ALL})
    together = Together(options, WORTH, set(), {}, 2, hidden)
    assert together.best(()) == (76.0, {1: 0, 2: 3})
    assert together.best([0]) == (39.0, {2: 1})
    assert hidden.gain(3, [0]) == 14.0
    assert hidden.gain(0, [3]) == 0.0


def test_what_two_others_hide_is_taken_back_once() -> None:
    hidden = Hidden(
        {0: np.array([-15.0, 3.0, -1.0])}, {(0, 1): np.array([1, 1, 0], bool), (0, 2): np.array([1, 0, 1], bool)}
    )
    assert hidden.gain(0, [1]) == 12.0
    assert hidden.gain(0, [1, 2]) == 13.0
    assert hidden.hope(0) == 16.0


def by_trying_all(together: Together, without: Sequence[int]) -> float:
    """What the best choice is worth."""
    columns = [[None, *(row for row in rows if row not in without)] for rows in together.options.values()]
    choices = [dict(enumerate(choice)) for choice in product(*columns)]
    chosen = [{at: row for at, row in choice.items() if row is not None} for choice in choices]
    possible = [
        each for each in chosen if not any(pair in together.conflicts for pair in product(each.values(), repeat=2))
    ]
    return max(together._value(each) for each in possible)


@pytest.mark.parametrize("seed", range(30))
def test_the_best_choice_is_found_without_trying_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    options, count = {}, 0
    for at in range(5):
        options[at] = list(range(count, count + int(rng.integers(0, 4))))
        count += len(options[at])
    owner = {row: at for at, rows in options.items() for row in rows}
    pairs = [(row, other) for row in owner for other in owner if owner[row] != owner[other]]
    conflicts = {pair for pair in pairs if pair[0] < pair[1] and rng.random() < 0.2}
    carriers = {
        row: {other for one, other in pairs if one == row and rng.random() < 0.2} for row in owner if rng.random() < 0.4
    }
    behind = {pair: rng.random(6) < 0.4 for pair in pairs if rng.random() < 0.3}
    hidden = Hidden({row: rng.normal(0.0, 4.0, 6) for row in owner}, behind)
    both = conflicts | {(other, one) for one, other in conflicts}
    together = Together(options, rng.uniform(1.0, 30.0, count), both, carriers, 5, hidden)
    for without in ([], [0], [1, 2]):
        value, chosen = together.best(without)
        assert value == pytest.approx(together._value(chosen), abs=1e-9), seed
        assert value == pytest.approx(by_trying_all(together, without), abs=1e-9), seed


def test_many_that_were_found_just_now_take_no_longer() -> None:
    """Each of them is there or not, and none has to do with another one."""
    options = {at: [at] for at in range(40)}
    together = Together(options, np.full(40, 20.0), set(), {}, 40, Hidden({row: np.zeros(0) for row in range(40)}, {}))
    assert together.best(()) == (800.0, {at: at for at in range(40)})
    assert together.best([3])[0] == 780.0


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
    assert set(hidden.behind) == {(1, 0)}
    assert hidden.gain(1, [0]) == pytest.approx(-4.0)  # its points' nats are as many for as against it
    half = at(-0.036, 0.0, 0.6)  # its right side is behind the other's left one
    gains = hidden_of(stacked([1, 2], [front, half], 0.04), [0, 1])
    assert set(gains.behind) == {(1, 0)}
    assert gains.gain(1, [0]) == pytest.approx(-2.0)


def test_poses_that_differ_in_how_far_away_they_are_show_the_same() -> None:
    judged = stacked([1, 1, 1], [at(0.0, 0.0, 0.6), at(0.0, 0.0, 0.612), at(0.008, 0.0, 0.6)], 0.04)
    assert look_alike(judged, 0, [0, 1, 2]) == [0, 1]
