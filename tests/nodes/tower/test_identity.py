"""The arm below a builder: it learns what colours cubes have, and does not see what has another one's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import pytest

import hierax
from hierax.nodes.picking.layout import planned
from hierax.nodes.picking.world import picture_and_hand_seen
from hierax.nodes.tower import identity
from hierax.nodes.tower.identity import LEARNED_EPOCHS, LEARNED_NATS, MISTAKEN_EPOCHS, chromaticities
from hierax.nodes.tracking.math.geometry import invert, pose_error
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED

CUBES = 3
SETTINGS = [f"cubes={CUBES}", "tower=[1, 3]", "pictures=1000"]
SKIN = (222, 170, 136)


@pytest.fixture(scope="module")
def learned() -> tuple[Any, Any]:
    """What the arm and the world believe when the colours are known."""
    with hierax.run("tower", seed=0, settings=SETTINGS) as run:
        for _ in zip(run, range(LEARNED_EPOCHS + 3), strict=False):
            pass
        return run.belief("arm"), run.belief("world")


def painted(world: Any, colours: Mapping[int, Any]) -> Any:
    """The picture, in which cubes, by id, are painted otherwise."""
    bodies = ({**body, "colour": colours.get(body["id"], body["colour"])} for body in world["bodies"])
    return picture_and_hand_seen({**world, "bodies": tuple(bodies)})


def colour_of(world: Any, number: int) -> Any:
    return next(body["colour"] for body in world["bodies"] if body["id"] == number)


def test_the_colours_are_those_that_cubes_are_painted_with(learned: Any) -> None:
    belief, _ = learned
    for known, place in zip(belief["colours"], planned(0, CUBES), strict=True):
        paint = np.array(place.colour) / sum(place.colour)
        assert (known["epochs"], known["mistaken"]) == (LEARNED_EPOCHS, 0)
        assert np.linalg.norm(known["chromaticity"] - paint) < 0.03, place


def test_what_has_another_ones_colour_is_not_seen_and_after_some_images_lost(learned: Any) -> None:
    """It is where it was expected, and nothing is learned of it; the others are seen as ever."""
    belief, world = learned
    node, picture = identity.arm(0, CUBES), painted(world, {1: colour_of(world, 2)})
    before = belief["objects"][0]
    for epoch in range(1, MISTAKEN_EPOCHS + 1):
        after = node.observe(picture, belief)
        one, *others = after["objects"]
        assert one["status"] == (LOST if epoch == MISTAKEN_EPOCHS else EXPECTED)
        assert pose_error(after["camera"] @ one["pose"], belief["camera"] @ before["pose"])[0] < 1e-9
        assert one["slots"] is before["slots"]
        assert np.trace(one["covariance"]) > np.trace(before["covariance"])
        assert (one["sought"], len(one["guesses"]), one["nats"], one["probability"]) == (True, 0, 0.0, 0.0)
        assert [other["status"] for other in others] == [TRACKED, TRACKED]
        belief = {**belief, "colours": after["colours"]}
    assert node.observe(painted(world, {}), belief)["colours"][0]["mistaken"] == 0


def test_what_was_lost_is_lost_again_if_it_is_found_in_another_one(learned: Any) -> None:
    """In the image in which it is found, its control points are those of the place where it might have been."""
    belief, world = learned
    first = belief["objects"][0]
    nothing = {name: part[:0] for name, part in first["controls"].items()}
    where = {"pose": first["pose"], "controls": first["controls"], "kept": True}
    far = {**where, "pose": first["pose"] + 0.1, "controls": nothing}
    lost = {**first, "status": LOST, "controls": nothing, "others": (far, where)}
    assert identity._controls(lost, lost) is first["controls"]
    own, other = (
        chromaticities(cv2.blur(picture["image"], (3, 3)), world["intrinsics"], first, identity._controls(lost, lost))
        for (picture,) in (painted(world, {}), painted(world, {1: colour_of(world, 2)}))
    )
    known = belief["colours"]
    assert identity._compared(known[0], first, own, known)["mistaken"] == 0
    assert identity._compared(known[0], first, other, known)["mistaken"] == 1
    node = identity.arm(0, CUBES)
    assert node._denied(1, lost, np.eye(4))["status"] == LOST


@pytest.mark.parametrize("colour", [SKIN, (128, 128, 128), (30, 30, 30)])
def test_what_has_nobodys_colour_is_not_taken_for_another_one(learned: Any, colour: tuple[int, int, int]) -> None:
    belief, world = learned
    after = identity.arm(0, CUBES).observe(painted(world, {1: colour}), belief)
    assert [known["mistaken"] for known in after["colours"]] == [0, 0, 0]


def test_cubes_of_one_colour_are_not_told_apart(learned: Any) -> None:
    belief, world = learned
    one, two, three = belief["colours"]
    alike = {**belief, "colours": (one, {**two, "chromaticity": one["chromaticity"]}, three)}
    after = identity.arm(0, CUBES).observe(painted(world, {2: colour_of(world, 1)}), alike)
    assert [known["mistaken"] for known in after["colours"]] == [0, 0, 0]


def test_a_colour_is_read_within_faces_and_where_enough_is_seen(learned: Any) -> None:
    belief, world = learned
    (picture,) = painted(world, {})
    image, item, intrinsics = picture["image"], belief["objects"][0], world["intrinsics"]
    seen = chromaticities(image, intrinsics, item, item["controls"])
    assert seen is not None
    near = np.linalg.norm(seen - belief["colours"][0]["chromaticity"], axis=1) < 0.05
    assert near.mean() > 0.75  # hardly anything of what is beside the cube
    hidden = {**item["controls"], "visible": np.zeros_like(item["controls"]["visible"])}
    assert chromaticities(image, intrinsics, item, hidden) is None
    assert chromaticities(image, intrinsics, {**item, "status": LOST}, item["controls"]) is None
    assert chromaticities(image, intrinsics, {**item, "pose": invert(item["pose"])}, item["controls"]) is None


@pytest.mark.parametrize(("nats", "probation"), [(LEARNED_NATS - 1.0, 0), (LEARNED_NATS, 1)])
def test_a_colour_that_is_not_surely_seen_is_not_learned(nats: float, probation: int) -> None:
    known = {"id": 1, "chromaticity": np.zeros(3), "epochs": 0, "mistaken": 0}
    item = {"nats": nats, "probation": probation}
    assert identity._compared(known, item, np.full((50, 3), 1 / 3), [known]) is known


def test_what_another_one_hides_in_part_is_not_taken_for_it(learned: Any) -> None:
    belief, _ = learned
    known = belief["colours"]
    for share, mistaken in ((0.8, 0), (0.95, 1)):
        hidden = np.arange(100) < 100 * share
        seen = np.where(hidden[:, None], known[1]["chromaticity"], known[0]["chromaticity"])
        assert identity._compared(known[0], belief["objects"][0], seen, known)["mistaken"] == mistaken


def test_without_a_picture_nothing_changes(learned: Any) -> None:
    belief, _ = learned
    assert identity.arm(0, CUBES).observe((), belief)["colours"] is belief["colours"]
