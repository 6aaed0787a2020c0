"""The spatial node below one that reasons: what was put somewhere, and is not seen, stays there."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hierax.nodes.picking.layout import CUBES
from hierax.nodes.picking.tracker import PickSpatial, first_bodies
from hierax.nodes.tracking.estimation.tracked import diagonal_covariance
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.schema import EXPECTED, TRACKED
from hierax.runtime import Elements, Value

# How well it is known, in each axis, where something stands that was put there, and is not seen just now.
STANDS_M, STANDS_RAD = 0.003, np.radians(3.0)
_STAYS = ("pose", "velocity", "covariance")


class TowerSpatial(PickSpatial):
    """A spatial node that is told which cubes stand where they were put, and whether the camera overlooks the table:
    {"held": id or None, "stands": ids, "looks": bool}.

    Without that, a cube that the camera has lost carries nothing, so that what stands on it falls in the imagination,
    and is looked for where it is not. And what the camera cannot see from near, while the hand is among the cubes, is
    looked for everywhere, in vain."""

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ of `PickSpatial`, but that cubes of which it is known that they stand stay where they were, about as well
        known as ever, unless they are seen. While the camera overlooks the table, what is lost is lost all the same."""
        told: Value = context[0] if context else {"held": None, "stands": (), "looks": True}
        kept = {
            body["id"]: {**body, "status": EXPECTED, "velocity": np.zeros(6), "covariance": _bounded(body)}
            for body in belief["bodies"]
            if body["status"] != TRACKED and body["id"] in told["stands"] and body["id"] != told["held"]
        }
        bodies = tuple(kept.get(body["id"], body) for body in belief["bodies"])
        after = super().predict(context, actions, {**belief, "bodies": bodies})
        said = {body["id"]: body["status"] for body in belief["bodies"]}
        return {
            **after,
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


def _bounded(body: Mapping[str, Any]) -> Floats:
    """A covariance that is no greater than `STANDS_M` and `STANDS_RAD` make it."""
    vague = float(np.trace(body["covariance"][:3, :3])) > 3.0 * STANDS_M**2
    return diagonal_covariance(STANDS_M, STANDS_RAD) if vague else body["covariance"]


def spatial(scene: int = 0, cubes: int = CUBES, **options: Any) -> TowerSpatial:
    """The spatial node as `hierax.nodes.picking.tracker.spatial` has it, below a builder."""
    return TowerSpatial(first_bodies(scene, cubes), table=True, **options)
