"""The spatial node below one that reasons: what was put somewhere, and is not seen, stays there."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.tracker import PickSpatial, first_bodies
from hierax.nodes.tracking.estimation.tracked import diagonal_covariance
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import EXPECTED, LOST, TRACKED
from hierax.runtime import Elements, Value

# How well it is known, in each axis, where something stands that was put there, and is not seen just now.
STANDS_M, STANDS_RAD = 0.003, np.radians(3.0)
ODD_M, ODD_EPOCHS = 0.012, 30  # so far off what could carry it, and for so long, a cube cannot be seen to be
_MIDDLE_M, _REACH_M = np.array([0.5, 0.0]), 0.6  # of the table, in which cubes are looked for
_DENIED = {"status": LOST, "velocity": np.zeros(6)}
_STAYS = ("pose", "velocity", "covariance")


class TowerSpatial(PickSpatial):
    """A spatial node that is told which cubes stand where they were put, and whether the camera overlooks the table:
    {"held": id or None, "stands": ids, "looks": bool}.

    Without that, a cube that the camera has lost carries nothing, so that what stands on it falls in the imagination,
    and is looked for where it is not. And what the camera cannot see from near, while the hand is among the cubes, is
    looked for everywhere, in vain.

    And a cube that is seen in the air, or in the table, for longer than somebody may hold it there, is not there: what
    is seen is another one, nearer or farther. The belief has ``odd``, of each cube for how many epochs that is so."""

    def initial_belief(self) -> Value:
        """The belief of `PickSpatial`; nothing is odd yet."""
        known = super().initial_belief()
        return {**known, "odd": tuple((body["id"], 0) for body in known["bodies"])}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ of `PickSpatial`, but that cubes of which it is known that they stand stay where they were, about as well
        known as ever, unless they are seen. While the camera overlooks the table, what is lost is lost all the same."""
        told: Value = context[0] if context else {"held": None, "stands": (), "looks": True}
        kept = {
            body["id"]: {**body, "status": EXPECTED, "velocity": np.zeros(6), "covariance": _bounded(body)}
            for body in belief["bodies"]
            if body["status"] != TRACKED and body["id"] in told["stands"] and body["id"] != told["held"]
        }
        now = _odd(belief["bodies"]) - {told["held"]} if told["looks"] else set()
        odd = {number: count + 1 if number in now else 0 for number, count in belief["odd"]}
        bodies = tuple(
            {**kept.get(body["id"], body), **(_DENIED if odd[body["id"]] > ODD_EPOCHS else {})}
            for body in belief["bodies"]
        )
        after = super().predict(context, actions, {**belief, "bodies": bodies})
        said = {body["id"]: body["status"] for body in belief["bodies"]}
        return {
            **after,
            "odd": tuple(odd.items()),
            "sweeping": after["sweeping"] if told["looks"] else (),
            "bodies": tuple(
                {
                    **body,
                    **{name: kept[body["id"]][name] for name in _STAYS},
                    "status": said[body["id"]] if told["looks"] else EXPECTED,
                }
                if body["id"] in kept
                else body
                for body in after["bodies"]
            ),
        }


def _odd(bodies: Sequence[Mapping[str, Any]]) -> set[int]:
    """Cubes that are seen where nothing carries them or they cannot be, or expected beyond all that is looked at."""
    known = {body["id"]: (body, *_foot_and_top(body)) for body in bodies if body["status"] != LOST}
    return {number for number in known if _is_odd(number, known)}


def _is_odd(number: int, known: Mapping[int, tuple[Mapping[str, Any], float, float]]) -> bool:
    """Likewise of one, by those that are not lost, each with how high its foot and its top are, m."""
    body, foot, _ = known[number]
    if body["status"] != TRACKED:
        return bool(np.linalg.norm(body["pose"][:2, 3] - _MIDDLE_M) > _REACH_M)
    if abs(foot) < ODD_M:
        return False
    carried = any(
        abs(foot - top) < ODD_M and _beside_m(body, other) < _extent_m(other)
        for other, _, top in known.values()
        if other is not body
    )
    return foot < 0.0 or not carried


def _foot_and_top(body: Mapping[str, Any]) -> tuple[float, float]:
    heights = body["model"]["vertices"] @ body["pose"][2, :3] + body["pose"][2, 3]
    return float(heights.min()), float(heights.max())


def _beside_m(body: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    return float(np.linalg.norm(body["pose"][:2, 3] - other["pose"][:2, 3]))


def _extent_m(body: Mapping[str, Any]) -> float:
    return float(np.ptp(body["model"]["vertices"], axis=0).max())


def _bounded(body: Mapping[str, Any]) -> Floats:
    """A covariance that is no greater than `STANDS_M` and `STANDS_RAD` make it."""
    vague = float(np.trace(body["covariance"][:3, :3])) > 3.0 * STANDS_M**2
    return diagonal_covariance(STANDS_M, STANDS_RAD) if vague else body["covariance"]


def spatial(scene: int = 0, cubes: int = CUBES, **options: Any) -> TowerSpatial:
    """The spatial node as `hierax.nodes.picking.tracker.spatial` has it, below a builder."""
    return TowerSpatial(first_bodies(scene, cubes), table=True, **options)
