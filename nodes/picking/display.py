"""What the nodes of an arm that picks things up show: `hierax view`.

The views: ``beside``, arm, table and cubes by the truth, from beside the table; in ``scene``, beside what the tracking
nodes show there, the true axes and whatever no node knows of; and of nodes that move the gripper, the gripper."""

from functools import cache

import numpy as np

from hierax.nodes.picking.views import SceneView
from hierax.nodes.tracking.display import world_things
from hierax.nodes.tracking.math.geometry import Floats, transform
from hierax.runtime import Step
from hierax.runtime.core import showing

_SIZE = (480, 360)  # of the picture from beside the table
_FINGER_M, _STEM_M = 0.05, 0.09  # how long fingers are drawn, and where the hand's stem begins, from the pads' middle

_scene_view = cache(SceneView)  # a cache of the arm's meshes


def truth_things(step: Step) -> dict[str, showing.Thing]:
    """The world as it was when the camera saw it: the picture from beside, true axes, and the boxes of a person."""
    belief = step.sensed
    boxes = {
        f"/scene/person/{number}": showing.Box(each["size"], each["pose"], each["colour"], filled=True)
        for number, each in enumerate(belief.get("obstacles", ()))
    }
    return {"/beside/picture": showing.Image(_scene_view().beside(belief, _SIZE)), **world_things(step), **boxes}


def gripper_lines(gripper: Floats, width_m: float) -> Floats:
    """(4, 2, 3) lines of a gripper, metres in the world: two fingers, what joins them, and the hand's stem.

    Args: gripper: world_from_gripper; width_m: between the fingers."""
    left, right = (np.array([0.0, side * width_m / 2, 0.0]) for side in (-1.0, 1.0))
    back, stem = np.array([0.0, 0.0, -_FINGER_M]), np.array([0.0, 0.0, -_STEM_M])
    ends = [(left, left + back), (right, right + back), (left + back, right + back), (back, stem)]
    return transform(gripper, np.array(ends).reshape(-1, 3)).reshape(-1, 2, 3)
