"""The spatial node below a builder: what stands stays, what cannot be where it is seen is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hierax.nodes.picking.layout import planned
from hierax.nodes.picking.tracker import spatial as picking_spatial
from hierax.nodes.tower.spatial import FIRM_EPOCHS, ODD_EPOCHS, SLIPS_M, STANDS_M, spatial
from hierax.nodes.tracking.math.geometry import make_pose
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED
from hierax.runtime import Tick
from hierax.runtime.core.difference import first_unlike

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


def test_what_is_seen_in_the_air_most_of_the_time_is_lost_all_the_same() -> None:
    """A pose that wanders is not seen in every image."""
    node, odd, unseen = spatial(0, CUBES), shown(pose=lifted(0.1)), shown(status=EXPECTED)
    belief, statuses = odd, []
    for epoch in range(2 * ODD_EPOCHS):
        belief = node.predict((LOOKS,), (), {**belief, "bodies": (unseen if epoch % 5 == 4 else odd)["bodies"]})
        statuses.append(belief["bodies"][1]["status"])
    assert LOST not in statuses[:ODD_EPOCHS]
    assert LOST in statuses


def test_what_is_lost_is_expected_where_it_must_carry_another_one() -> None:
    """The first on the second, and above it the third, as high as if the first were there."""
    one, two, three = planned(0, CUBES)
    node, height_m = spatial(0, CUBES), two.pose[2, 3] + two.side_m / 2
    above = two.pose.copy()
    above[2, 3] = height_m + one.side_m + three.side_m / 2
    belief = shown()
    changed = {1: {"status": LOST}, 3: {"pose": above}}
    for told, lower_m, status in ((LOOKS, 0.0, EXPECTED), (LOOKS, 0.02, LOST), ({**LOOKS, "looks": False}, 0.0, LOST)):
        lowered = above.copy()
        lowered[2, 3] -= lower_m
        changed[3] = {"pose": lowered}
        bodies = tuple({**body, **changed.get(body["id"], {})} for body in belief["bodies"])
        first = node.predict((told,), (), {**belief, "bodies": bodies})["bodies"][0]
        assert first["status"] == status
        if status == EXPECTED:
            np.testing.assert_allclose(first["pose"][:3, 3], [*two.pose[:2, 3], height_m + one.side_m / 2], atol=1e-6)


def test_what_a_lost_one_may_carry_is_not_in_the_air() -> None:
    one = planned(0, CUBES)[0]
    for height_m, status in ((one.side_m, TRACKED), (one.side_m + 0.03, LOST)):
        odd = shown(pose=lifted(height_m))
        bodies = tuple({**body, "status": LOST} if body["id"] == 1 else body for body in odd["bodies"])
        assert status_after({**odd, "bodies": bodies}, ODD_EPOCHS + 1, LOOKS) == status


def test_what_is_found_again_has_as_long_as_at_first() -> None:
    odd, lost = shown(pose=lifted(0.1)), shown(status=LOST)
    node, belief = spatial(0, CUBES), odd
    for seen, epochs in ((odd, ODD_EPOCHS + 1), (lost, 1), (odd, ODD_EPOCHS)):
        for _ in range(epochs):
            belief = node.predict((LOOKS,), (), {**belief, "bodies": seen["bodies"]})
    assert belief["bodies"][1]["status"] == TRACKED


def test_while_the_arm_does_not_look_nothing_is_counted() -> None:
    odd, near = shown(pose=lifted(0.1)), {**LOOKS, "looks": False}
    node, belief = spatial(0, CUBES), odd
    for told, epochs in ((LOOKS, ODD_EPOCHS), (near, 20), (LOOKS, 1)):
        for _ in range(epochs):
            belief = node.predict((told,), (), {**belief, "bodies": odd["bodies"]})
            assert told is LOOKS or belief["bodies"][1]["status"] == TRACKED
    assert belief["bodies"][1]["status"] == LOST


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


# --- what stands, or is held, and is seen elsewhere

SURELY, VAGUELY = np.diag([1e-7] * 3 + [1e-5] * 3), np.diag([3e-5] * 3 + [1e-3] * 3)
STAND = {"held": None, "stands": (1, 2, 3), "looks": False}
AFAR = {**STAND, "looks": True}
HOLDS = {"held": 2, "stands": (1, 3), "looks": False}


class Seen:
    """A spatial node that is told something, and what its arm sees, epoch by epoch."""

    def __init__(self, told: Any) -> None:
        self.node, self.told = spatial(0, CUBES), told
        self.belief = self.node.initial_belief()
        self.places = {place.id: place.pose for place in planned(0, CUBES)}
        self.covariances = dict.fromkeys(self.places, SURELY)
        self.statuses = dict.fromkeys(self.places, TRACKED)
        self.gripper = make_pose(np.eye(3), np.array([0.5, 0.0, 0.3]))
        self.time_s = 0.0

    def epochs(self, count: int) -> Any:
        """What is believed of the second cube at the end, before the prediction."""
        for _ in range(count):
            self.time_s += 0.05
            sensed = self.node.observe(
                (*map(self._seen, self.places), self._hand()), self.belief, Tick(time_s=self.time_s)
            )
            self.belief = self.node.predict((self.told,), (), sensed)
        return next(body for body in sensed["bodies"] if body["id"] == 2)

    def move(self, *by_m: float) -> None:
        self.places[2] = self.places[2].copy()
        self.places[2][:3, 3] += by_m

    def _hand(self) -> Any:
        return {"hand": {"gripper": self.gripper, "width": 0.05}}

    def _seen(self, number: int) -> Any:
        rest = {"obj_id": number, "score": 1.0, "motion_scale": 0.0, "sought": False, "guesses": np.zeros((0, 4, 4))}
        pose, covariance = self.places[number], self.covariances[number]
        return {"id": number, "pose": pose, "covariance": covariance, "status": self.statuses[number], **rest}


def standing(told: Any) -> Seen:
    """Where the camera has overlooked the table before."""
    scene = Seen(AFAR)
    scene.epochs(3)
    scene.told = told
    scene.epochs(1)
    return scene


@pytest.mark.parametrize(("told", "by_m"), [(STAND, 0.004), (AFAR, 0.05)])
def test_what_stands_is_elsewhere_where_it_is_surely_seen_and_can_be(told: Any, by_m: float) -> None:
    scene = standing(told)
    scene.move(0.0, -by_m, 0.0)
    body = scene.epochs(1)
    assert body["status"] == TRACKED
    np.testing.assert_allclose(body["pose"][:3, 3], scene.places[2][:3, 3], atol=1e-9)


@pytest.mark.parametrize("steps", [1, 10])
def test_from_near_it_is_not_elsewhere_neither_at_once_nor_bit_by_bit(steps: int) -> None:
    scene = standing(STAND)
    before = scene.epochs(1)["pose"].copy()
    for _ in range(steps):
        scene.move(0.0, -0.05 / steps, 0.0)
        body = scene.epochs(5)
    assert body["status"] == EXPECTED
    np.testing.assert_allclose(body["pose"], before, atol=1e-9)


@pytest.mark.parametrize("told", [STAND, AFAR])
@pytest.mark.parametrize("why", ["vague", "in the table", "in another one"])
def test_what_stands_stays_where_it_was_where_it_is_seen_vaguely_or_cannot_be(told: Any, why: str) -> None:
    scene = standing(told)
    before = scene.epochs(1)["pose"].copy()
    if why == "vague":
        scene.move(0.0, -0.05, 0.0)
        scene.covariances[2] = VAGUELY
    elif why == "in the table":
        scene.move(0.0, 0.0, -0.03)
    else:
        scene.places[2] = scene.places[1]
    body = scene.epochs(5)
    assert body["status"] == EXPECTED
    np.testing.assert_allclose(body["pose"], before, atol=1e-9)
    assert scene.epochs(ODD_EPOCHS)["status"] == EXPECTED
    lost = {body["id"]: body["status"] for body in scene.belief["bodies"]}
    assert lost[2] == (LOST if told["looks"] else EXPECTED)  # and is looked for from afar


def test_in_the_air_it_may_be_in_a_hand_if_that_is_seen_from_afar() -> None:
    for told, status in ((AFAR, TRACKED), (STAND, EXPECTED)):
        scene = Seen(told)
        scene.epochs(3)
        scene.move(0.0, 0.0, 0.1)
        assert scene.epochs(1)["status"] == status


def test_what_the_hand_has_put_down_and_nobody_sees_stays_there() -> None:
    scene = Seen(HOLDS)
    scene.move(0.0, 0.0, 0.1)
    scene.epochs(3)
    scene.told, scene.statuses[2] = {**STAND, "stands": (1, 2, 3)}, EXPECTED
    scene.epochs(1)
    body = scene.epochs(20)
    np.testing.assert_allclose(body["pose"][:3, 3], scene.places[2][:3, 3], atol=1e-9)


def held_for(epochs: int) -> Seen:
    """The second cube, after it was seen so long to move with the hand that holds it."""
    scene = Seen(HOLDS)
    scene.epochs(2)
    for _ in range(epochs):
        scene.gripper = scene.gripper.copy()
        scene.gripper[2, 3] += 0.004
        scene.move(0.0, 0.0, 0.004)
        scene.epochs(1)
    return scene


def test_what_is_held_moves_with_the_hand_wherever_it_seems_to_be() -> None:
    scene = held_for(FIRM_EPOCHS + 2)
    true = scene.places[2].copy()
    scene.move(0.003, 0.0, -0.010)
    body = scene.epochs(20)
    assert body["status"] == EXPECTED
    np.testing.assert_allclose(body["pose"], true, atol=1e-6)
    scene.places[2] = true
    scene.move(0.003, 0.0, 0.0)  # so little may be a slip
    body = scene.epochs(2)
    assert body["status"] == TRACKED
    assert body["pose"][0, 3] - true[0, 3] == pytest.approx(2 * SLIPS_M, abs=1e-6)
    scene.epochs(20)
    np.testing.assert_allclose(scene.epochs(1)["pose"], scene.places[2], atol=1e-6)


def test_before_it_is_known_how_a_cube_is_held_it_is_where_it_is_seen() -> None:
    scene = held_for(FIRM_EPOCHS - 3)
    scene.move(0.003, 0.0, -0.010)
    np.testing.assert_allclose(scene.epochs(1)["pose"], scene.places[2], atol=1e-9)


def test_without_context_it_believes_what_picking_believes() -> None:
    """Nothing is lost for being odd: what the hand holds is in the air."""
    node, plain, belief = spatial(0, CUBES), picking_spatial(0, CUBES), shown(pose=lifted(0.1))
    known = {name: belief[name] for name in plain.initial_belief()}
    for _ in range(ODD_EPOCHS + 5):
        after, wanted = node.predict((), (), belief), plain.predict((), (), known)
        assert first_unlike({name: after[name] for name in wanted}, wanted, "") is None
        belief, known = ({**each, "bodies": belief["bodies"]} for each in (after, wanted))
    assert status_after(belief, 1, LOOKS) == TRACKED
