from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.runtime import Node, Step, Value
from hierax.runtime.core.showing import Box, Curve, Graph, Image
from hierax.runtime.viewing.views import Kind, Placed, ShowError, placed, shown_by

STEP = Step(3, 0, 0.1, (), 1.0, (), (), "default", (), 2.0)


class Shower(Node):
    def __init__(self, things: Any = None) -> None:
        self.things = things

    def initial_belief(self) -> Value:
        return 0.0

    def metrics(self, belief: Value) -> dict[str, float]:
        return {"level": belief, "twice": 2 * belief}

    def show(self, step: Step, before: Value) -> Any:
        if isinstance(self.things, Exception):
            raise self.things
        return super().show(step, before) if self.things is None else self.things


def brief(things: tuple[Placed, ...]) -> list[tuple[str, Kind, str, str]]:
    return [(each.view.name, each.view.kind, each.path, each.label) for each in things]


def test_a_node_that_says_nothing_else_shows_its_figures() -> None:
    shown = shown_by("arm", Shower(), STEP, None)
    assert brief(shown) == [
        ("arm/metrics", Kind.PLOT, "arm/metrics/level", "level"),
        ("arm/metrics", Kind.PLOT, "arm/metrics/twice", "twice"),
    ]
    assert [each.thing for each in shown] == [2.0, 4.0]


def test_views_of_a_nodes_own_and_those_that_all_share() -> None:
    things = {
        "score": 0.5,
        "score/cube/top": Curve(0.5),
        "/scene/cube": Box([1, 1, 1]),
        "/scene": Box([2, 2, 2]),
        "note": "text",
        "/camera/image": Image(np.zeros((2, 2), np.uint8)),
        "/tree": Graph({}),
        "flag": np.bool_(True),
    }
    assert brief(placed("arm", things, "here")) == [
        ("arm/score", Kind.PLOT, "arm/score", "score"),
        ("arm/score", Kind.PLOT, "arm/score/cube/top", "cube/top"),
        ("scene", Kind.SCENE, "scene/arm/cube", "cube"),
        ("scene", Kind.SCENE, "scene/arm", "arm"),
        ("arm/note", Kind.TEXT, "arm/note", "note"),
        ("camera", Kind.PICTURE, "camera/arm/image", "image"),
        ("tree", Kind.GRAPH, "tree/arm", "arm"),
        ("arm/flag", Kind.PLOT, "arm/flag", "flag"),
    ]


@pytest.mark.parametrize(
    ("things", "what"),
    [
        (ValueError("no image"), "arm: show in epoch 3: ValueError: no image"),
        ([1], "arm: show in epoch 3: expected things by path, got list"),
        ({"a//b": 1.0}, "'a//b' is no path: expected 'view/thing' or '/view/thing'"),
        ({"": 1.0}, "'' is no path"),
        ({"/": 1.0}, "'/' is no path"),
        ({7: 1.0}, "7 is no path"),
        ({"/hierarchy/x": 1.0}, "/hierarchy/x: the view 'hierarchy' is the viewer's own"),
        ({"belief": "x"}, "belief: the view 'belief' is the viewer's own"),
        ({"a": None}, "3: a: expected a number, a text or a thing of hierax.runtime.core.showing, got NoneType"),
    ],
)
def test_what_cannot_be_shown_is_told(things: Any, what: str) -> None:
    with pytest.raises(ShowError) as caught:
        shown_by("arm", Shower(things), STEP, None)
    assert what in str(caught.value)
