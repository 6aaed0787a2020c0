"""The tracking nodes as they stand between the world and the grasp node.

Both do what they do in `hierax.nodes.tracking`, and two things more: what the arm feels of its hand goes up through
them, and the grasp node's commands go down."""

from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.commands import Command, CommandedNode
from hierax.nodes.picking.layout import CUBES, TABLE_MIDDLE_M, guessed, planned
from hierax.nodes.picking.panda import CAMERA_FROM_GRIPPER, HOME_RAD, camera_of, gripper_at
from hierax.nodes.picking.straight import WIDE_RAD, along, length_m
from hierax.nodes.tracking.arm import ArmNode, poses_seen
from hierax.nodes.tracking.math.geometry import invert, pose_error
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.schema import FirstBody, FirstPose, Model
from hierax.nodes.tracking.spatial import SpatialNode
from hierax.runtime import NO_TICK, Elements, Tick, Value

# Of the arm: standard deviations of where joints say that the camera is, in each axis, from one image to the next, and
# in the long run; cubes are as their models. The table's texture, which would add little, is not looked at.
KNOWN = {
    "camera_m": 0.0002,
    "camera_rad": 0.0003,
    "drift_m": 0.001,
    "drift_rad": 0.001,
    "model_tolerance_mm": 0.0,
    "table_texture": False,
}


class PickArm(CommandedNode, ArmNode):
    """An arm node that also knows its hand.

    What stands above it knows where things are by this node's camera, whose pose it corrects. So it says where the hand
    is by the same camera, and turns what is asked of the hand, which is meant beside what the camera sees, into where
    the joints have to bring it. While the hand grips, the camera sees little but what moves with it, of which it cannot
    learn where it is itself: the correction stays what it was.

    The belief is that of `ArmNode`, with ``hand``, as the world gave it (None before the first image),
    ``joints_from_camera`` ((4, 4): from where the camera has things to where the joints have them) and ``grips``,
    whether the last command was to close the fingers."""

    def initial_belief(self) -> Value:
        """The belief of `ArmNode`; nothing is known of the hand yet, and nothing corrected."""
        return {**super().initial_belief(), "hand": None, "joints_from_camera": np.eye(4), "grips": False}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ of `ArmNode`, and the hand as it is felt."""
        if not observations:
            return belief
        felt = {**super().observe(observations, belief), "grips": belief["grips"], "hand": observations[0]["hand"]}
        if belief["grips"]:
            return {**felt, "joints_from_camera": belief["joints_from_camera"]}
        return {**felt, "joints_from_camera": felt["hand"]["gripper"] @ invert(felt["camera"] @ CAMERA_FROM_GRIPPER)}

    def carried_out(self, wanted: Command, belief: Value) -> Command:
        """The command by the camera, as one by the joints' angles."""
        return {**wanted, "gripper": belief["joints_from_camera"] @ wanted["gripper"]}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """γ of `ArmNode`; its command changes nothing in what it expects to see, as the camera's pose is measured."""
        expected = super().predict(context, (), belief, tick)
        return {**expected, "grips": any(action["width"] <= 0.0 for action in actions)}


class PickSpatial(CommandedNode, SpatialNode):
    """A spatial node in whose imagination the cube that the hand holds moves with the hand. Its belief has ``hand``, as
    the arm felt it (None before the first observation), and ``hand_before``, the same an epoch earlier."""

    table_middle_m = TABLE_MIDDLE_M

    def initial_belief(self) -> Value:
        """The belief of `SpatialNode`; nothing is known of the hand yet."""
        return {**super().initial_belief(), "hand": None, "hand_before": None}

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """τ of `SpatialNode`, and the hand as the arm felt it."""
        sensed = super().observe(observations, belief, tick)
        hands = [item["hand"] for item in observations if "hand" in item]
        return {**sensed, "hand": hands[0], "hand_before": belief["hand"]} if hands else sensed

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ of `SpatialNode`, but for the cube that the grasp node says is held, {"held": id of a cube, or None}: with
        the hand it goes on to where the command has that come, as fast as it went."""
        predicted = super().predict((), (), belief)
        held = context[0]["held"] if context else None
        if held is None or belief["hand_before"] is None:
            return predicted
        now, before = (belief[name]["gripper"] for name in ("hand", "hand_before"))
        moved = now @ invert(before)
        if actions and pose_error(now, actions[0]["gripper"])[1] < WIDE_RAD:  # else it may turn the long way round
            moved = along(now, actions[0]["gripper"], length_m(before, now)) @ invert(now)
        seen = {body["id"]: body["pose"] for body in belief["bodies"]}
        bodies = tuple(
            {**body, "pose": moved @ seen[held], "velocity": np.zeros(6), "hangs": 0} if body["id"] == held else body
            for body in predicted["bodies"]
        )
        return {**predicted, "bodies": bodies}


def arm(scene: int = 0, cubes: int = CUBES, **options: Any) -> PickArm:
    """The arm node with a first guess at the cubes' poses, and nothing of their shapes; options are further ones of
    `ArmNode`, and others than `KNOWN`."""
    return PickArm(first_poses(scene, cubes), **KNOWN | options)


def spatial(scene: int = 0, cubes: int = CUBES, **options: Any) -> PickSpatial:
    """The spatial node with a first guess at the cubes' poses, and with their models; the table carries them. Options
    are further ones of `SpatialNode`."""
    return PickSpatial(first_bodies(scene, cubes), table=True, **options)


def first_poses(scene: int, cubes: int) -> list[FirstPose]:
    """A first guess at the poses of a scene's cubes, as the camera sees them from home."""
    camera_from_world = invert(camera_of(gripper_at(HOME_RAD)))
    poses = enumerate(guessed(scene, cubes), start=1)
    return [{"id": number, "obj_id": number, "pose": camera_from_world @ pose} for number, pose in poses]


def first_bodies(scene: int, cubes: int) -> list[FirstBody]:
    """The cubes of a scene with their models, and a first guess at their poses."""
    objects: list[FirstBody] = []
    for place, pose in zip(planned(scene, cubes), guessed(scene, cubes), strict=True):
        mesh = box_mesh([place.side_m] * 3)
        model: Model = {"vertices": mesh.vertices, "faces": mesh.faces}
        objects.append({"id": place.id, "obj_id": place.id, "pose": pose, "model": model})
    return objects


def poses_and_hand_seen(belief: Value) -> Elements:
    """φ of the arm: what `poses_seen` gives, then {"hand": {"gripper", "width"}} by its camera; none before it sees."""
    poses = poses_seen(belief)
    if not poses:
        return ()
    gripper = invert(belief["joints_from_camera"]) @ belief["hand"]["gripper"]
    return (*poses, {"hand": {**belief["hand"], "gripper": gripper}})


def scene_known(belief: Value) -> Elements:
    """φ of the spatial node: of each body {"id", "pose": world_from_box, its centre in the origin, "size": (3,) m,
    "covariance", "status"}, then {"hand", "carried": who is carried by whom, by the physics of the imagination, as in
    `SpatialBelief`}; none before the first observation."""
    if belief["hand"] is None:
        return ()
    boxes = []
    for body in belief["bodies"]:
        vertices = body["model"]["vertices"]
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        pose = body["pose"].copy()
        pose[:3, 3] += pose[:3, :3] @ ((low + high) / 2)
        known = {"covariance": body["covariance"], "status": body["status"]}
        boxes.append({"id": body["id"], "pose": pose, "size": high - low, **known})
    return (*boxes, {"hand": belief["hand"], "carried": belief["carried"]})


class KnownScene(NamedTuple):
    """What `scene_known` tells."""

    bodies: tuple[Value, ...]
    hand: Value
    carried: tuple[tuple[int, int], ...]


def read_scene(observations: Elements) -> KnownScene:
    """What a node is told of the scene from below."""
    rest = next(item for item in observations if "hand" in item)
    return KnownScene(tuple(item for item in observations if "pose" in item), rest["hand"], rest["carried"])
