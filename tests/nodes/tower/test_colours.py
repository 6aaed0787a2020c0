"""What an arm makes of cubes by their colours: what has another one's is not it, and is given up in the end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import hierax
from hierax.nodes.picking.tracker import arm
from hierax.nodes.picking.world import picture_and_hand_seen
from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.math.geometry import pose_error
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED

CUBES, EPOCHS = 3, 15
SETTINGS = [f"cubes={CUBES}", "tower=[1, 3]", "pictures=1000"]


@pytest.fixture(scope="module")
def learned() -> tuple[Any, Any]:
    """What the arm and the world believe when the colours are known."""
    with hierax.run("tower", seed=0, settings=SETTINGS) as run:
        for _ in zip(run, range(EPOCHS), strict=False):
            pass
        return run.belief("arm"), run.belief("world")


def painted(world: Any, colours: Mapping[int, Any]) -> Any:
    """The picture, in which cubes, by id, are painted otherwise."""
    bodies = ({**body, "colour": colours.get(body["id"], body["colour"])} for body in world["bodies"])
    return picture_and_hand_seen({**world, "bodies": tuple(bodies)})


def colour_of(world: Any, number: int) -> Any:
    return next(body["colour"] for body in world["bodies"] if body["id"] == number)


def test_what_has_another_ones_colour_is_where_it_was_expected_and_at_last_lost(learned: Any) -> None:
    """Nothing is learned of it; the others are seen as ever."""
    belief, world = learned
    node, picture, before = arm(0, CUBES), painted(world, {1: colour_of(world, 2)}), belief["objects"][0]
    one = before
    for epoch in range(1, const.PATIENCE + 1):
        objects = ({**one, "pose": before["pose"], "before": before["before"]}, *belief["objects"][1:])
        after = node.observe(picture, {**belief, "objects": objects})
        one, *others = after["objects"]
        assert (one["status"], one["denied"]) == (LOST if epoch == const.PATIENCE else EXPECTED, epoch)
        assert pose_error(after["camera"] @ one["pose"], belief["camera"] @ before["pose"])[0] < 1e-9
        np.testing.assert_array_equal(one["slots"]["dye"], before["slots"]["dye"])
        assert one["probability"] == 0.0
        assert [other["status"] for other in others] == [TRACKED, TRACKED]


def test_in_its_own_colour_it_is_seen_and_learned_on(learned: Any) -> None:
    belief, world = learned
    after = arm(0, CUBES).observe(painted(world, {}), belief)
    assert [item["status"] for item in after["objects"]] == [TRACKED] * CUBES
    assert [item["denied"] for item in after["objects"]] == [0] * CUBES
    for now, was in zip(after["objects"], belief["objects"], strict=True):
        assert now["slots"]["dyed"] > was["slots"]["dyed"] > 5.0


def test_cubes_of_one_colour_are_not_told_apart(learned: Any) -> None:
    belief, world = learned
    one, two, three = belief["objects"]
    alike = ({**one, "slots": {**one["slots"], "dye": two["slots"]["dye"]}}, two, three)
    after = arm(0, CUBES).observe(painted(world, {1: colour_of(world, 2)}), {**belief, "objects": alike})
    assert [item["status"] for item in after["objects"]] == [TRACKED] * CUBES
