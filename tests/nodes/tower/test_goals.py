"""Towers that are asked for: read, or refused in a line that says why."""

from __future__ import annotations

from typing import Any

import pytest

from hierax.nodes.tower.goals import read_towers


@pytest.mark.parametrize(
    ("given", "towers"),
    [
        ([3, 1], ((3, 1),)),
        ((2,), ((2,),)),
        ([[3, 1], [4, 2]], ((3, 1), (4, 2))),
        (((1,), (2,)), ((1,), (2,))),
        ({"2": None, "5": None}, (frozenset({2, 5}),)),
        ([[3, 1], {"2": None, "5": None}], ((3, 1), frozenset({2, 5}))),
    ],
)
def test_one_or_several_are_read(given: Any, towers: Any) -> None:
    assert read_towers(given, 5) == towers


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ([3, 6], "there is no cube 6; expected ids from 1 to 5"),
        ([0], "there is no cube 0"),
        ([1, 1], "cube 1 is asked for twice"),
        ([[1, 2], [2, 3]], "cube 2 is asked for twice"),
        ([], "expected ids of cubes"),
        ([[1], []], "expected ids of cubes"),
        ("31", "there is no cube '31'"),
        ([True], "there is no cube True"),
        ([[[1]]], "there is no cube"),
        (None, "there is no cube None"),
        ({}, "expected ids of cubes"),
        ({"2": 1}, "there is no cube {'2': 1}"),
        ({"x": None}, "there is no cube 'x'"),
        ([[3, 2], {"2": None}], "cube 2 is asked for twice"),
    ],
)
def test_what_cannot_be_built_is_refused(given: Any, why: str) -> None:
    with pytest.raises(ValueError, match="tower is") as raised:
        read_towers(given, 5)
    assert why in str(raised.value)
