"""Symbols of poses: with what certainty they hold, when they begin and end, and what of cubes that are not seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.tower.symbols import (
    CONFIRMED,
    NOTHING,
    PATIENCE,
    Symbols,
    Told,
    chance_held,
    chance_on,
    symbols_after,
)
from hierax.nodes.tracking.math.geometry import Floats, make_pose
from hierax.nodes.tracking.schema import TABLE

SIDE_M = 0.05


def box(number: int, x: float, z: float, sigma_m: float = 0.0005, status: str = "tracked") -> dict[str, Any]:
    """A cube upright at y = 0, its middle at some height."""
    covariance = np.diag([sigma_m**2] * 3 + [1e-4] * 3)
    pose = make_pose(np.eye(3), np.array([x, 0.0, z]))
    return {"id": number, "pose": pose, "size": np.full(3, SIDE_M), "covariance": covariance, "status": status}


EVERY = tuple((upper, lower) for upper in range(1, 5) for lower in (TABLE, 1, 2, 3, 4))
"""All that could carry anything does."""


def told(
    *boxes: dict[str, Any],
    carried: tuple[tuple[int, int], ...] = EVERY,
    holding: int | None = None,
    looking: bool = True,
    gripper: Floats | None = None,
) -> Told:
    return Told(boxes, carried, holding, np.eye(4) if gripper is None else gripper, SIDE_M, looking)


def after(*boxes: dict[str, Any], before: Symbols = NOTHING, **others: Any) -> Symbols:
    for _ in range(CONFIRMED):
        before = symbols_after(before, told(*boxes, **others))
    return before


def test_what_stands_on_what() -> None:
    symbols = after(box(1, 0.5, 0.025), box(2, 0.505, 0.075), box(3, 0.7, 0.025), box(4, 0.502, 0.125))
    assert symbols.on == ((2, 1), (4, 2))
    assert symbols.on_table == (1, 3)
    assert symbols.above(1) == [2, 4]
    assert [cube for cube in (1, 2, 3, 4) if symbols.is_clear(cube)] == [3, 4]
    assert symbols.certainty["on 2 1"] > 0.99


@pytest.mark.parametrize(("x", "z"), [(0.535, 0.075), (0.5, 0.09), (0.5, 0.06)])
def test_what_is_beside_above_or_within_does_not_stand(x: float, z: float) -> None:
    assert after(box(1, 0.5, 0.025), box(2, x, z)).on == ()


def test_a_vague_pose_makes_a_symbol_uncertain() -> None:
    lower = box(1, 0.5, 0.025)
    chances = [chance_on(box(2, 0.5, 0.075, sigma_m), lower) for sigma_m in (0.001, 0.005, 0.02, 0.1)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] > 0.99
    assert chances[-1] < 0.1


def test_a_symbol_ends_at_less_than_it_begins_at() -> None:
    """At this height either may be; what held before decides."""
    boxes = box(1, 0.5, 0.025), box(2, 0.5, 0.082)
    assert 0.5 < chance_on(boxes[1], boxes[0]) < 0.9
    assert after(*boxes).on == ()
    held = after(box(1, 0.5, 0.025), box(2, 0.5, 0.075))
    assert after(*boxes, before=held).on == ((2, 1),)
    assert after(box(1, 0.5, 0.025), box(2, 0.5, 0.095), before=held).on == ()


def test_what_is_not_seen_stays_as_it_was_until_it_is_lost() -> None:
    held = after(box(1, 0.5, 0.025), box(2, 0.5, 0.075))
    unseen = box(1, 0.5, 0.025), box(2, 0.6, 0.2, 0.03, "expected")
    assert after(*unseen, before=held).on == ((2, 1),)
    assert after(*unseen).on == ()
    lost = box(1, 0.5, 0.025), box(2, 0.5, 0.075, 0.03, "lost")
    for epoch in range(2 * PATIENCE):
        held = symbols_after(held, told(*lost, looking=epoch % 2 == 1))
        assert held.unknown == ((2,) if epoch == 2 * PATIENCE - 1 else ())
        assert held.on == (() if held.unknown else ((2, 1),))
    found = after(box(1, 0.5, 0.025), box(2, 0.5, 0.075), before=held)
    assert (found.on, found.unknown, found.lost) == (((2, 1),), (), ())


def test_of_what_the_hand_holds_nothing_else_is_so() -> None:
    symbols = after(box(1, 0.5, 0.025), box(2, 0.5, 0.075), box(3, 0.5, 0.125), holding=2)
    assert (symbols.on, symbols.holding, symbols.on_table) == ((), 2, (1,))


def test_what_is_so_for_an_instant_changes_nothing() -> None:
    stands = box(1, 0.5, 0.025), box(2, 0.5, 0.075)
    falls = box(1, 0.5, 0.025), box(2, 0.6, 0.025)
    held = after(*stands)
    for _ in range(3):
        for _ in range(CONFIRMED - 1):
            held = symbols_after(held, told(*falls))
            assert held.on == ((2, 1),)
        held = symbols_after(held, told(*stands))
    assert (held.doubts, after(*falls, before=held).on_table) == ({}, (1, 2))


def test_from_near_symbols_change_of_cubes_alone_of_which_none_holds() -> None:
    """Poses are wrong there for longer than an instant."""
    held = after(box(1, 0.5, 0.025), box(2, 0.5, 0.075))
    falls = box(1, 0.5, 0.025), box(2, 0.6, 0.025), box(3, 0.7, 0.025)
    near = after(*falls, before=held, looking=False)
    assert (near.on, near.on_table, near.doubts) == (((2, 1),), (1, 3), {})
    assert (after(*falls, before=near).on, after(*falls, before=near).on_table) == ((), (1, 2, 3))


def test_what_physics_does_not_have_carry_it_hardly_stands() -> None:
    """Poses alone leave it at the edge; that physics has it carried does not make it likelier than they do."""
    boxes = box(1, 0.5, 0.025), box(2, 0.5, 0.0812)
    chance = chance_on(boxes[1], boxes[0])
    assert 0.9 < chance < 0.97
    table = ((1, TABLE),)
    with_it, without = (after(*boxes, carried=carried) for carried in ((*table, (2, 1)), table))
    assert (with_it.on, with_it.certainty["on 2 1"]) == (((2, 1),), chance)
    assert without.on == ()
    assert without.certainty["on 2 1"] < 0.6
    assert after(*boxes, carried=()).on_table == (1,), "a pose that leaves no doubt is believed"


def test_each_symbol_has_its_certainty() -> None:
    boxes = box(1, 0.5, 0.025), box(2, 0.5, 0.075), box(3, 0.7, 0.025), box(4, 0.6, 0.2)
    gripper = make_pose(np.eye(3), np.array([0.602, 0.0, 0.2]))
    lost = {**boxes[2], "status": "lost"}
    symbols = NOTHING
    for _ in range(PATIENCE):
        symbols = symbols_after(symbols, told(*boxes[:2], lost, boxes[3], holding=4, gripper=gripper))
    certainty = symbols.certainty
    assert certainty["on 2 1"] > 0.99
    assert certainty["clear 2"] > 0.99
    assert "clear 1" not in certainty, "what is impossible is not noted"
    assert certainty["holding 4"] == chance_held(boxes[3], gripper, SIDE_M) > 0.99
    assert (symbols.unknown, certainty["unknown 3"]) == ((3,), 1.0)


@pytest.mark.parametrize(("away_m", "width_m"), [(0.03, SIDE_M), (0.0, 0.03), (0.0, 0.08)])
def test_what_is_beside_the_fingers_or_not_as_wide_is_hardly_held(away_m: float, width_m: float) -> None:
    gripper = make_pose(np.eye(3), np.array([0.6 + away_m, 0.0, 0.2]))
    assert chance_held(box(1, 0.6, 0.2), gripper, width_m) < 0.01
