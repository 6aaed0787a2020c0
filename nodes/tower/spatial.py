"""The spatial node below one that reasons: what was put somewhere stays there, unless it is surely seen elsewhere."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.phases import is_sure
from hierax.nodes.picking.tracker import PickSpatial, first_bodies
from hierax.nodes.tower.plausible import carriers, hangs, is_sunk, odd_bodies
from hierax.nodes.tracking.estimation.tracked import diagonal_covariance
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, invert, log_so3, make_pose, pose_error
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED
from hierax.runtime import NO_TICK, Elements, Tick, Value

# How well it is known, in each axis, where something stands that was put there, and is not seen just now.
STANDS_M, STANDS_RAD = 0.003, np.radians(3.0)
NEAR_M = 0.005  # from near, what stands is believed no farther from where it was when the camera overlooked the table
# How well it is known where one must be that carries another one.
CARRIES_M, CARRIES_RAD = 0.006, np.radians(8.0)
ODD_EPOCHS = 30  # what is seen for so long where it cannot be is not there
# What the fingers hold turns and slides so slowly, an epoch, and is not seen farther off than this where it truly is.
SLIPS_M, SLIPS_RAD = 0.0002, np.radians(0.2)
OFF_M, OFF_RAD = 0.005, np.radians(5.0)
FIRM_M, FIRM_RAD, FIRM_EPOCHS = (
    0.002,
    np.radians(2.0),
    8,
)  # seen so near to where the hand has it, and for so long, it is known how a cube is held
_DENIED = {"status": LOST, "velocity": np.zeros(6)}
_STAYS = ("pose", "velocity", "covariance")
_NO_HOLD = {"hold": None, "firm": 0}
_NOTHING_TOLD: Value = {"held": None, "stands": (), "looks": True}


class TowerSpatial(PickSpatial):
    """A spatial node that is told which cubes stand where they were put, and whether the camera overlooks the table:
    {"held": id or None, "stands": ids, "looks": bool}.

    Without that, a cube that the camera has lost carries nothing, so that what stands on it falls in the imagination,
    and is looked for where it is not. And what the camera cannot see from near, while the hand is among the cubes, is
    looked for everywhere, in vain.

    From near the camera also sees cubes where they are not: a face of one, taken for another. So a cube that stands is
    believed elsewhere only if it is surely seen there, and can be there; and one that the hand holds moves with the
    hand. A cube that is seen in the air, or in the table, for longer than somebody may hold it there, is not there:
    what is seen is another one, nearer or farther.

    The belief has ``told``; ``rests``, pairs of an id and the pose in which a cube that stands was believed last;
    ``doubted``, the ids of those that were seen elsewhere just now, and not believed to be there; ``odd``, of each cube
    for how many epochs that is so, or it is seen where it cannot be, less those in which it is not; ``hold``,
    gripper_from_object of the cube that the hand holds (None: it is not known), and ``firm``, for how many epochs it
    was seen to move with the hand."""

    def initial_belief(self) -> Value:
        """The belief of `PickSpatial`; nothing is told and nothing odd yet."""
        known = super().initial_belief()
        odd = tuple((body["id"], 0) for body in known["bodies"])
        return {**known, "told": _NOTHING_TOLD, "rests": (), "doubted": (), "odd": odd, "hold": None, "firm": 0}

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ of `PickSpatial`, but that cubes that stand, and the one that is held, are where they were, if that is
        likelier."""
        sensed = _hand_believed(super().observe(observations, belief, tick))
        rests = _rests(belief)
        others = [{**body, "pose": rests.get(body["id"], body["pose"])} for body in sensed["bodies"]]
        others = [body for body in others if body["id"] in rests or body["status"] != LOST]
        looks = belief["told"]["looks"]
        seen = {body["id"]: body for body in sensed["bodies"] if body["status"] == TRACKED and body["id"] in rests}
        doubted = tuple(number for number, body in seen.items() if not _is_believed(body, rests[number], others, looks))
        if looks:
            rests |= {number: body["pose"] for number, body in seen.items() if number not in doubted}
        bodies = tuple(
            _unseen_at(body, rests[body["id"]]) if body["id"] in doubted else body for body in sensed["bodies"]
        )
        return {**sensed, "bodies": bodies, "rests": tuple(sorted(rests.items())), "doubted": doubted}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ of `PickSpatial`, but that cubes of which it is known that they stand stay where they were, about as well
        known as ever, unless they are seen. While the camera overlooks the table, what is lost is lost all the same.
        Where nothing is told, it is that of `PickSpatial`."""
        told: Value = context[0] if context else _NOTHING_TOLD
        counts = bool(context) and told["looks"]
        odd = _counted(belief, told) if counts else dict(belief["odd"])
        denied = {number for number, count in odd.items() if counts and count > ODD_EPOCHS}
        kept, said = _kept(belief, told, denied, counts)
        bodies = tuple(
            {**kept.get(body["id"], body), **(_DENIED if body["id"] in denied else {})} for body in belief["bodies"]
        )
        after = super().predict(context, actions, {**belief, "bodies": bodies})
        stay = {
            number: {**{name: body[name] for name in _STAYS}, "status": said.get(number, EXPECTED)}
            for number, body in kept.items()
        }
        return {
            **after,
            "told": told,
            **(_NO_HOLD if told["held"] is None or told["held"] != belief["told"]["held"] else {}),
            "odd": tuple(odd.items()),
            "sweeping": after["sweeping"] if told["looks"] else (),
            "bodies": tuple({**body, **stay.get(body["id"], {})} for body in after["bodies"]),
        }


def _kept(belief: Value, told: Value, denied: Collection[int], counts: bool) -> tuple[dict[int, Value], dict[int, str]]:
    """The cubes that are imagined where they are told to stand, or where one must be that carries another one, whatever
    the camera sees; and the status of those that have another than `EXPECTED` all the same."""
    stands = {*told["stands"]} - {told["held"], *denied}
    kept = {
        body["id"]: {**body, "status": EXPECTED, "velocity": np.zeros(6), "covariance": _bounded(body)}
        for body in belief["bodies"]
        if body["status"] != TRACKED and body["id"] in stands
    }
    known = {body["id"]: body for body in belief["bodies"]}
    said = {number: known[number]["status"] for number in kept} if told["looks"] else {}
    for number, pose in (carriers(belief["bodies"]) if counts else {}).items():
        kept[number] = _unseen_at(known[number], pose, CARRIES_M, CARRIES_RAD)
        said.pop(number, None)
    return kept, said


def _counted(belief: Value, told: Value) -> dict[int, int]:
    """For how many epochs each cube is odd, where the camera overlooks the table; with one that is lost it begins
    anew."""
    now = (odd_bodies(belief["bodies"]) | {*belief["doubted"]}) - {told["held"]}
    lost = {body["id"] for body in belief["bodies"] if body["status"] == LOST}
    return {
        number: min(count + 1, ODD_EPOCHS + 1) if number in now else 0 if number in lost else max(count - 1, 0)
        for number, count in belief["odd"]
    }


def _rests(belief: Value) -> dict[int, Floats]:
    """Where each cube stands that is told to: as it was believed last, or, of what has just come to stand, expected."""
    stands = {*belief["told"]["stands"]} - {belief["told"]["held"]}
    expected = {body["id"]: body["pose"] for body in belief["bodies"] if body["status"] != LOST}
    known = expected | dict(belief["rests"])
    return {number: known[number] for number in sorted(stands) if number in known}


def _is_believed(body: Value, rest: Floats, others: Sequence[Value], looks: bool) -> bool:
    """Whether a cube that stands is where it is seen now. While the camera overlooks the table, it may be in the air,
    in somebody's hand, or anywhere else; from near, that is not seen well enough."""
    if not is_sure(body) or is_sunk(body, others):
        return False
    return looks or (pose_error(body["pose"], rest)[0] < NEAR_M and not hangs(body, others))


def _unseen_at(body: Value, pose: Floats, sigma_m: float = STANDS_M, sigma_rad: float = STANDS_RAD) -> Value:
    """A body as if it had not been seen, at a pose, which is so well known."""
    still = {"velocity": np.zeros(6), "drift": np.zeros(6), "seen": None}
    return {**body, "pose": pose, "status": EXPECTED, "covariance": diagonal_covariance(sigma_m, sigma_rad), **still}


def _hand_believed(sensed: Value) -> Value:
    """What was sensed, with the cube that is held where the hand has it, if it is known how it is held and it is not
    seen to slip but to jump."""
    held, hold = sensed["told"]["held"], sensed["hold"]
    if held is None or sensed["hand"] is None:
        return sensed
    gripper = sensed["hand"]["gripper"]
    body = next(body for body in sensed["bodies"] if body["id"] == held)
    if body["status"] != TRACKED:
        at = body if hold is None else {**body, "pose": gripper @ hold}
        return {**sensed, "bodies": _with(sensed["bodies"], at)}
    firm = sensed["firm"]
    if hold is not None:
        moved = gripper @ hold
        distance_m, angle_rad = pose_error(moved, body["pose"])
        if firm >= FIRM_EPOCHS:
            jumps = distance_m > OFF_M or angle_rad > OFF_RAD
            body = _unseen_at(body, moved) if jumps else {**body, "pose": _slipped(moved, body["pose"])}
        else:
            firm = firm + 1 if distance_m < FIRM_M and angle_rad < FIRM_RAD else 0
    hold = invert(gripper) @ body["pose"]
    return {**sensed, "bodies": _with(sensed["bodies"], body), "hold": hold, "firm": firm}


def _slipped(moved: Floats, seen: Floats) -> Floats:
    """A pose that was expected, brought towards the one that was seen, as far as something slips in an epoch."""
    shift, turn = seen[:3, 3] - moved[:3, 3], log_so3(seen[:3, :3] @ moved[:3, :3].T)
    shift, turn = (
        part * min(1.0, most / max(float(np.linalg.norm(part)), 1e-12))
        for part, most in ((shift, SLIPS_M), (turn, SLIPS_RAD))
    )
    return make_pose(exp_so3(turn) @ moved[:3, :3], moved[:3, 3] + shift)


def _with(bodies: Sequence[Value], changed: Value) -> tuple[Value, ...]:
    return tuple(changed if body["id"] == changed["id"] else body for body in bodies)


def _bounded(body: Value) -> Floats:
    """A covariance that is no greater than `STANDS_M` and `STANDS_RAD` make it."""
    vague = float(np.trace(body["covariance"][:3, :3])) > 3.0 * STANDS_M**2
    return diagonal_covariance(STANDS_M, STANDS_RAD) if vague else body["covariance"]


def spatial(scene: int = 0, cubes: int = CUBES, **options: Any) -> TowerSpatial:
    """The spatial node as `hierax.nodes.picking.tracker.spatial` has it, below a builder."""
    return TowerSpatial(first_bodies(scene, cubes), table=True, **options)
