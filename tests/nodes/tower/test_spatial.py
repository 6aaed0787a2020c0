"""The spatial node below a builder: what stands stays, what cannot be where it is seen is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.layout import planned
from hierax.nodes.tower.spatial import ODD_EPOCHS, STANDS_M, spatial
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED

CUBES = 3
LOOKS = {"held": None, "stands": (), "looks": True}


def shown(**changed: Any) -> Any:
    """A belief in which the second cube, or as is said, is tracked where the plan has it."""
    belief = spatial(0, CUBES).initial_belief()
    places = {place.id: place.pose for place in planned(0, CUBES)}
    bodies = tuple({**body, "status": TRACKED, "pose": places[body["id"]]} for body in belief["bodies"])
    return {
        **belief,
        "interval_s": 0.05,
        "bodies": tuple({**body, **(changed if body["id"] == 2 else {})} for body in bodies),
    }


def lifted(height_m: float, x_m: float = 0.0) -> Any:
    pose = planned(0, CUBES)[1].pose.copy()
    pose[:3, 3] += (x_m, 0.0, height_m)
    return pose


def status_after(belief: Any, epochs: int, context: Any) -> str:
    """What the second cube is after so many epochs in which it is seen where it is in the belief."""
    node, bodies = spatial(0, CUBES), belief["bodies"]
    for _ in range(epochs):
        belief = node.predict((context,), (), {**belief, "bodies": bodies})
    return str(next(body["status"] for body in belief["bodies"] if body["id"] == 2))


@pytest.mark.parametrize("height_m", [0.1, -0.03])
def test_what_is_seen_in_the_air_or_in_the_table_is_lost_after_a_while(height_m: float) -> None:
    odd = shown(pose=lifted(height_m))
    assert status_after(odd, ODD_EPOCHS, LOOKS) == TRACKED
    assert status_after(odd, ODD_EPOCHS + 1, LOOKS) == LOST
    assert status_after(odd, ODD_EPOCHS + 1, {**LOOKS, "held": 2}) == TRACKED
    assert status_after(odd, ODD_EPOCHS + 1, {**LOOKS, "looks": False}) == TRACKED
    assert status_after(shown(), ODD_EPOCHS + 1, LOOKS) == TRACKED


def test_what_lies_on_another_one_is_not_in_the_air() -> None:
    one, two = planned(0, CUBES)[:2]
    on = one.pose.copy()
    on[2, 3] += (one.side_m + two.side_m) / 2
    assert status_after(shown(pose=on), ODD_EPOCHS + 1, LOOKS) == TRACKED


def test_what_is_expected_beyond_the_table_is_lost() -> None:
    away = shown(pose=lifted(0.0, 2.0), status=EXPECTED)
    assert status_after(away, ODD_EPOCHS + 1, LOOKS) == LOST


def test_what_stands_and_is_not_seen_stays_as_well_known_as_ever() -> None:
    vague = shown(status=LOST, covariance=np.eye(6))
    node = spatial(0, CUBES)
    told = {"held": None, "stands": (1, 2, 3), "looks": False}
    after = next(body for body in node.predict((told,), (), vague)["bodies"] if body["id"] == 2)
    assert after["status"] == EXPECTED
    assert after["covariance"][0, 0] == pytest.approx(STANDS_M**2)
    np.testing.assert_array_equal(after["pose"], vague["bodies"][1]["pose"])
    looking = next(body for body in node.predict(({**told, "looks": True},), (), vague)["bodies"] if body["id"] == 2)
    assert looking["status"] == LOST
