"""What a node takes over from the one that it replaces, by default."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hierax.runtime import Node, Value

INITIAL = {"pose": np.zeros((2, 3)), "seen": None, "objects": [], "gain": 1.0, "part": {"on": True}}
TAKEN = {"pose": np.ones((5, 3)), "seen": "cube", "objects": ("a", "b"), "gain": 0.5, "part": {"on": False}}


class Tracker(Node):
    def initial_belief(self) -> Value:
        return INITIAL


def test_a_belief_that_is_built_like_the_initial_one_is_taken_over() -> None:
    assert Tracker().take_over(TAKEN) is TAKEN


@pytest.mark.parametrize(
    ("part", "what"),
    [
        (
            {"pose": np.zeros((2, 3), np.float32)},
            "belief.pose: expected an array of float64, 2-d, got one of float32, 2-d",
        ),
        ({"pose": np.zeros(3)}, "belief.pose: expected an array of float64, 2-d, got one of float64, 1-d"),
        ({"pose": None}, "belief.pose: expected ndarray, got NoneType"),
        ({"gain": 1}, "belief.gain: expected float, got int"),
        ({"part": {"on": 1}}, "belief.part.on: expected bool, got int"),
        ({"part": {}}, "belief.part: expected the keys ['on'], got []"),
        ({"more": 1}, "belief: expected the keys ['gain', 'objects', 'part', 'pose', 'seen'], got ['gain', 'more',"),
    ],
)
def test_another_belief_is_refused_with_the_place(part: dict[str, Value], what: str) -> None:
    with pytest.raises(ValueError, match=re.escape(what)):
        Tracker().take_over({**TAKEN, **part})


def test_no_belief_is_no_belief_of_another_kind() -> None:
    with pytest.raises(ValueError, match="belief: expected dict, got NoneType"):
        Tracker().take_over(None)
