from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from hierax.runtime.core.showing import (
    Axes,
    Box,
    Camera,
    Curve,
    Depth,
    Graph,
    Image,
    Labels,
    Lines2D,
    Mesh,
    Points2D,
    Points3D,
    colour_of,
)

GREY = np.zeros((2, 3), np.uint8)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (
            lambda: Image(np.zeros((2, 2))),
            "Image: pixels: expected h × w or h × w × 3 of uint8, got float64 of shape (2, 2)",
        ),
        (lambda: Image(np.zeros((2, 2, 4), np.uint8)), "of shape (2, 2, 4)"),
        (lambda: Depth([1.0, 2.0]), "Depth: metres: expected n × k numbers, got float64 of shape (2,)"),
        (lambda: Depth([["a"]]), "Depth: metres: expected n × k numbers, got <U1"),
        (lambda: Labels([[0.5]]), "Labels: labels: expected n × k whole numbers, got float64"),
        (lambda: Labels([[256]]), "Labels: labels: expected 0 to 255, got 256 to 256"),
        (lambda: Points2D([[1, 2, 3]]), "Points2D: points: expected n × 2 numbers, got int64 of shape (1, 3)"),
        (lambda: Points3D([[1, 2, 3]], labels=("a", "b")), "Points3D: labels: expected 1 or none, got 2"),
        (lambda: Lines2D([[1, 2]]), "Lines2D: lines: expected n × k × 2 numbers, got int64 of shape (1, 2)"),
        (lambda: Lines2D([], colour=(1, 2)), "Lines2D: colour: expected three or four numbers from 0 to 255, got"),
        (lambda: Box([1, 2, 3], colour=(1, 2, 256)), "Box: colour: expected three or four numbers from 0 to 255"),
        (lambda: Box([1, 2]), "Box: size: expected 3 numbers, got int64 of shape (2,)"),
        (lambda: Mesh([[0, 0, 0]], [[0, 0, 1]]), "Mesh: faces: expected indices of 1 vertices, got up to 1"),
        (lambda: Axes(np.eye(3)), "Axes: pose: expected 4 × 4 numbers, got float64 of shape (3, 3)"),
        (lambda: Camera(np.eye(4), [1, 2, 3], (4, 4)), "Camera: intrinsics: expected 4 numbers"),
        (lambda: Graph({"a": ""}, [("a", "b")]), "Graph: edges: there is no node 'b'"),
        (lambda: Graph({"a": "", "b": ""}, places={"a": (0, 0)}), "Graph: places: expected one for each node"),
    ],
)
def test_what_is_built_wrongly_is_refused(make: Callable[[], object], what: str) -> None:
    with pytest.raises(ValueError, match=re.escape(what)):
        make()


def test_arrays_may_be_lists_and_there_may_be_none_of_a_kind() -> None:
    assert np.asarray(Lines2D([]).lines).shape == (0, 0, 2)
    assert np.asarray(Mesh([], []).faces).shape == (0, 3)
    assert np.asarray(Points3D([[1, 2, 3]]).points).dtype == np.float64
    assert np.array_equal(np.asarray(Box([1, 2, 3]).pose), np.eye(4))
    assert Curve(np.float32(0.5)).value == 0.5  # type: ignore[arg-type]


def test_nothing_that_is_given_is_changed() -> None:
    points = np.array([[1, 2]])
    Points2D(points).points[0, 0] = 7.0  # type: ignore[index]
    assert points[0, 0] == 1
    assert Image(GREY).pixels is GREY


def test_colours_of_numbers_differ_and_repeat() -> None:
    assert len({colour_of(number) for number in range(1, 11)}) == 10
    assert colour_of(11) == colour_of(1)
