"""The tracker's own alignment, on one picture again and again: whether an image confirms a first pose."""

from __future__ import annotations

from collections.abc import Sequence

from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.math.geometry import Floats
from hierax.nodes.tracking.render import SegmentedDepth
from hierax.nodes.tracking.schema import TRACKED, FirstBody, FirstPose, Picture
from hierax.nodes.tracking.spatial import SpatialNode

_IMAGES = 4  # so often is the picture seen, the first time to know the camera


def aligned(picture: Picture, bodies: Sequence[FirstBody]) -> Floats | None:
    """camera_from_object of the last of some bodies where the image has it; None where the image does not support it.

    Args: picture: the image. bodies: their ``pose`` is camera_from_object, as the camera's frame is the world's here;
        those before the last one are seen, too, and may hide it.
    """
    first: list[FirstPose] = [{"id": each["id"], "obj_id": each["obj_id"], "pose": each["pose"]} for each in bodies]
    arm, spatial, imagine = ArmNode(first), SpatialNode(bodies), SegmentedDepth()
    sensed, believed = arm.initial_belief(), spatial.initial_belief()
    for _ in range(_IMAGES):
        sensed = arm.observe((picture,), sensed)
        believed = spatial.predict((), (), spatial.observe(poses_seen(sensed), believed))
        last = sensed["objects"][-1]
        sensed = arm.predict(imagine(believed), (), sensed)
    return last["pose"] if last["status"] == TRACKED else None
