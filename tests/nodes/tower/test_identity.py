"""The arm below a builder: it learns what colours cubes have, and loses what has another one's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hierax
from hierax.nodes.picking.layout import planned
from hierax.nodes.picking.world import picture_and_hand_seen
from hierax.nodes.tower import identity
from hierax.nodes.tower.identity import LEARNED_EPOCHS, LEARNED_NATS, MISTAKEN_EPOCHS, chromaticity
from hierax.nodes.tracking.math.geometry import invert, project
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED

CUBES = 3
SETTINGS = [f"cubes={CUBES}", "tower=[1, 3]", "pictures=1000"]


@pytest.fixture(scope="module")
def learned() -> Any:
    """What the arm and the world believe when the colours are known."""
    with hierax.run("tower", seed=0, settings=SETTINGS) as run:
        for _ in zip(run, range(LEARNED_EPOCHS + 3), strict=False):
            pass
        return run.belief("arm"), run.belief("world")


def test_the_colours_are_those_that_cubes_are_painted_with(learned: Any) -> None:
    belief, _ = learned
    for known, place in zip(belief["colours"], planned(0, CUBES), strict=True):
        paint = np.array(place.colour) / sum(place.colour)
        assert known["epochs"] == LEARNED_EPOCHS
        assert known["mistaken"] == 0
        assert np.linalg.norm(known["chromaticity"] - paint) < 0.03, place


def test_what_has_another_ones_colour_for_some_images_is_lost(learned: Any) -> None:
    belief, world = learned
    node = identity.arm(0, CUBES)
    one, two = (next(body for body in world["bodies"] if body["id"] == number) for number in (1, 2))
    painted = tuple({**body, "colour": two["colour"]} if body is one else body for body in world["bodies"])
    (picture,) = picture_and_hand_seen({**world, "bodies": painted})
    statuses = []
    for _ in range(MISTAKEN_EPOCHS):
        after = node.observe((picture,), belief)
        statuses.append([item["status"] for item in after["objects"]])
        belief = {**belief, "colours": after["colours"]}
    assert [each[0] for each in statuses] == [EXPECTED] * (MISTAKEN_EPOCHS - 1) + [LOST]
    assert all(each[1:] == [TRACKED, TRACKED] for each in statuses)


def test_of_what_too_little_is_seen_no_colour_is_told(learned: Any) -> None:
    belief, world = learned
    item, intrinsics = belief["objects"][0], world["intrinsics"]
    image = np.full((480, 640, 3), (200, 50, 50), np.uint8)
    np.testing.assert_allclose(chromaticity(image, intrinsics, item), np.array([201, 51, 51]) / 303, atol=1e-9)
    middle = project((item["pose"][:3, 3])[None], intrinsics)[0]
    assert (middle > 0).all()
    assert chromaticity(image, intrinsics, {**item, "status": LOST}) is None
    hidden = {**item["controls"], "visible": np.zeros_like(item["controls"]["visible"])}
    assert chromaticity(image, intrinsics, {**item, "controls": hidden}) is None
    away = {**item, "pose": invert(item["pose"])}
    assert chromaticity(image, intrinsics, away) is None


def test_a_colour_that_is_not_surely_seen_is_not_learned() -> None:
    item = {"nats": LEARNED_NATS - 1.0}
    known = {"id": 1, "chromaticity": np.zeros(3), "epochs": 0, "mistaken": 0}
    assert identity._compared(known, item, np.full(3, 1 / 3), [known]) == known
