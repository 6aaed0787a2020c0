"""The spatial node below one that reasons: what was put somewhere, and is not seen, stays there."""

from typing import Any

import numpy as np

from hierax.nodes.picking.layout import SIDES_M
from hierax.nodes.picking.tracker import PickSpatial, first_bodies
from hierax.nodes.tracking.schema import EXPECTED, TRACKED
from hierax.runtime import Elements, Value


class TowerSpatial(PickSpatial):
    """A spatial node that is told which cubes stand where they were put, and whether the camera overlooks the table:
    {"held": id or None, "stands": ids, "looks": bool}.

    Without that, a cube that the camera has lost carries nothing, so that what stands on it falls in the imagination,
    and is looked for where it is not. And what the camera cannot see from near, while the hand is among the cubes, is
    looked for everywhere, in vain."""

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ of `PickSpatial`, but that cubes of which it is known that they stand stay, unless they are seen."""
        told: Value = context[0] if context else {"held": None, "stands": (), "looks": True}
        kept = {
            body["id"]: {**body, "status": EXPECTED, "velocity": np.zeros(6)}
            for body in belief["bodies"]
            if body["status"] != TRACKED and body["id"] in told["stands"] and body["id"] != told["held"]
        }
        bodies = tuple(kept.get(body["id"], body) for body in belief["bodies"])
        after = super().predict(context, actions, {**belief, "bodies": bodies})
        stay = ("pose", "velocity")
        return {
            **after,
            "sweeping": after["sweeping"] if told["looks"] else (),
            "bodies": tuple(
                {**body, **{name: kept[body["id"]][name] for name in stay}} if body["id"] in kept else body
                for body in after["bodies"]
            ),
        }


def spatial(scene: int = 0, cubes: int = len(SIDES_M), **options: Any) -> TowerSpatial:
    """The spatial node as `hierax.nodes.picking.tracker.spatial` has it, below a builder."""
    return TowerSpatial(first_bodies(scene, cubes), table=True, **options)
