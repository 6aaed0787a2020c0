"""The world of the picking arm: cubes on a table, the arm, the camera in its hand. True poses are here alone."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.commands import CommandedNode
from hierax.nodes.picking.display import truth_things
from hierax.nodes.picking.layout import CUBES, disturbed, planned
from hierax.nodes.picking.panda import FOCAL_LENGTH, HOME_RAD, WIDEST_M, camera_of, gripper_at, joints_for
from hierax.nodes.picking.straight import WIDE_RAD, along, length_m
from hierax.nodes.picking.workcell import STEP_HZ, Arm, Cube, Guest, Order, Touch, Workcell
from hierax.nodes.tracking.errors import check_between
from hierax.nodes.tracking.math.geometry import Floats, log_so3
from hierax.nodes.tracking.simworld.shapes import Thing, box
from hierax.nodes.tracking.simworld.world import check_pictures, picture_of
from hierax.runtime import NO_TICK, Elements, Step, Tick, Value, World
from hierax.runtime.core.showing import Things

# How far a cube stands off its place in the plan at most, and how far it is turned.
OFF_PLAN_M = 0.004
OFF_PLAN_RAD = np.radians(1.8)

# A cube is grasped when it has been held so high for so long.
LIFTED_M = 0.10
HELD_S = 2.0

_ENOUGH_S = 2.5
# From frame to frame the arm moves a little: so few steps bring its gripper where it should be; its posture follows.
_ITERATIONS = 12
_NEAR = 1e-5  # metres or radians: a setpoint that is reached so nearly needs no further step
_ASTRAY = 0.02  # metres or radians: farther from where it should come the arm does not go
_TURN_RAD_S = 1.5  # so fast the joint turns that has the longest way, where the arm does not go straight
_TRUTH = 3


class PickWorld(CommandedNode, World):
    """An arm with a camera in its hand, over a table with cubes.

    The arm's controller moves the gripper on a straight line to where it is commanded, speeding up and slowing down, or
    by its joints, where that leads through the end of its wrist; joints are position controlled, fingers have a bounded
    force. Nothing but friction holds a cube.

    The belief: ``frame``, ``time_s``, the arm (``joints`` (7,), ``speeds`` (7,), ``fingers`` (2,), ``finger_speeds``
    (2,); rad, m, s), its controller (``targets`` (7,), rad; ``setpoint``, world_from_gripper; ``pace``, m/s;
    ``turns``, the world_from_gripper to which it goes by its joints, None where it goes straight), the camera
    (``camera``, world_from_camera; ``intrinsics``, ``size``, ``noise``, ``blur_px``) and ``bodies``, a tuple of ``id``,
    ``obj_id``, ``side_m``, ``colour``, ``pose`` (world_from_object), ``velocity`` (6,), ``floor_m`` (the height that it
    began at), ``lift_m`` (how far it is above that) and ``held_s`` (how long it has been lifted and touched by nothing
    but the fingers).

    Args:
        scene: number of the scene, from 0; cubes: how many cubes, from 1 to 6.
        frames: after how many the world has finished, if nothing has been held long enough by then.
        width, height: of the pictures, in pixels.
        noise: standard deviation of the sensor's noise, in grey levels of 256.
        blur_px: standard deviation of the lens's blur, in pixels; fps: frames per second, a divisor of 240.
        acceleration_m_s2: how fast the controller has the gripper speed up and slow down.
    """

    works_ahead = True

    def __init__(
        self,
        scene: int = 0,
        cubes: int = CUBES,
        frames: int = 400,
        width: int = 640,
        height: int = 480,
        noise: float = 2.0,
        blur_px: float = 0.7,
        fps: int = 20,
        acceleration_m_s2: float = 0.5,
    ) -> None:
        check_pictures(frames, width, height, noise, blur_px)
        check_between(0.01, 10, "a number", acceleration_m_s2=acceleration_m_s2)
        if fps < 1 or STEP_HZ % fps:
            raise ValueError(f"fps is {fps}; expected a divisor of {STEP_HZ}")
        self._frames, self._fps, self._acceleration_m_s2 = frames, fps, float(acceleration_m_s2)
        self._workcell = Workcell()
        arm = Arm(HOME_RAD, np.zeros(7), np.full(2, WIDEST_M / 2), np.zeros(2))
        gripper, focal = gripper_at(HOME_RAD), FOCAL_LENGTH * width
        controller = {"targets": HOME_RAD, "setpoint": gripper, "pace": 0.0, "turns": None}
        intrinsics = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2])
        pictures = {"size": (width, height), "noise": float(noise), "blur_px": float(blur_px)}
        camera = {"camera": camera_of(gripper), "intrinsics": intrinsics, **pictures}
        start = {"frame": 0, "time_s": 0.0, **arm._asdict(), **controller, **camera}
        self._first = {**start, "bodies": _placed(scene, cubes)}

    def initial_belief(self) -> Value:
        """Frame 0: everything at rest, the gripper open, the camera overlooking the table."""
        return self._first

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: one frame interval of the arm's controller and of physics."""
        return self.advanced(actions, belief, None)[0]

    def advanced(self, actions: Elements, belief: Value, guest: Guest | None) -> tuple[Value, Guest | None]:
        """The belief a frame interval later, where somebody's hand goes its way; and that hand."""
        interval_s = 1.0 / self._fps
        setpoint, pace, width = belief["setpoint"], 0.0, float(belief["fingers"].sum())
        if actions:
            setpoint, pace = _advanced(setpoint, belief["pace"], actions[0], interval_s, self._acceleration_m_s2)
            width = actions[0]["width"]
        targets, off = joints_for(setpoint, belief["targets"], _ITERATIONS, _NEAR)
        detour = _detour(actions[0]["gripper"], belief, off > _ASTRAY, interval_s) if actions else None
        if detour is not None:
            targets, setpoint, pace = detour.targets, gripper_at(detour.targets), 0.0
        arm = Arm(*(belief[name] for name in Arm._fields))
        cubes = [Cube(body["side_m"], body["pose"], body["velocity"]) for body in belief["bodies"]]
        order = Order(belief["targets"], targets, width)
        arm, cubes, touches, guest = self._workcell.run(arm, cubes, order, STEP_HZ // self._fps, guest)
        frame = {"frame": belief["frame"] + 1, "time_s": (belief["frame"] + 1) / self._fps}
        turns = actions[0]["gripper"] if detour is not None and not detour.ends else None
        controller = {"targets": targets, "setpoint": setpoint, "pace": pace, "turns": turns}
        moved = zip(belief["bodies"], cubes, touches, strict=True)
        bodies = tuple(_moved(body, cube, touch, interval_s) for body, cube, touch in moved)
        camera = camera_of(gripper_at(arm.joints))
        return {**belief, **arm._asdict(), **frame, **controller, "camera": camera, "bodies": bodies}, guest

    def time_s(self, belief: Value, epoch: int) -> float:
        return float(belief["time_s"])

    def finished(self, belief: Value) -> bool:
        """Whether a cube has been held long enough, or the frames are over."""
        return belief["frame"] >= self._frames or any(body["held_s"] >= _ENOUGH_S for body in belief["bodies"])

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Whether a cube was grasped (1 or 0), how high the highest is lifted (mm), how long one has been held (s)."""
        held_s, lift_m = (max(body[name] for body in belief["bodies"]) for name in ("held_s", "lift_m"))
        return {"grasped": float(held_s >= HELD_S - 1e-9), "lift_mm": 1000.0 * lift_m, "held_s": held_s}

    def show(self, step: Step, before: Value) -> Things:
        """Arm and cubes as they truly are, and the figures."""
        return {**truth_things(step), **super().show(step, before)}


def picture_and_hand_seen(belief: Value, tick: Tick = NO_TICK) -> Elements:
    """φ of the world: {"image", "camera", "intrinsics", "frame", "hand"}, the camera's picture and what the arm feels
    of itself, {"gripper": world_from_gripper, by the joints' angles; "width": metres between the finger pads}. The
    camera is mounted so that nothing of the arm is in its view. The arm throws no shadow. Where the belief has
    ``obstacles``, boxes as {"pose", "size", "colour"}, they are seen, too."""
    boxes = [Thing(each["pose"], box(each["size"]), each["colour"]) for each in belief.get("obstacles", ())]
    seen = picture_of(belief, tick, boxes)
    hand = {"gripper": gripper_at(belief["joints"]), "width": float(belief["fingers"].sum())}
    return ({**seen, "hand": hand},)


def _placed(scene: int, cubes: int) -> tuple[dict[str, Any], ...]:
    """The cubes where they truly stand: off the plan, each by a little; what stands on another moves with it."""
    places = planned(scene, cubes)
    rng = np.random.default_rng([scene, _TRUTH])
    bodies: list[dict[str, Any]] = []
    shifts: dict[int, Floats] = {}
    for place in places:
        angle, length = rng.uniform(-np.pi, np.pi), OFF_PLAN_M * np.sqrt(rng.uniform())
        shift = np.array([length * np.cos(angle), length * np.sin(angle), 0.0])
        shifts[place.id] = shifts[place.below] if place.below else shift
        turn = np.array([0.0, 0.0, rng.uniform(-OFF_PLAN_RAD, OFF_PLAN_RAD)])
        pose = disturbed(place.pose, shifts[place.id], turn)
        cube = {"id": place.id, "obj_id": place.id, "side_m": place.side_m, "colour": place.colour}
        lifted = {"floor_m": float(pose[2, 3]), "lift_m": 0.0, "held_s": 0.0}
        bodies.append({**cube, "pose": pose, "velocity": np.zeros(6), **lifted})
    return tuple(bodies)


def _advanced(
    setpoint: Floats, pace: float, wanted: Mapping[str, Any], interval_s: float, acceleration_m_s2: float
) -> tuple[Floats, float]:
    """The setpoint an interval later, on its way to the wanted pose, and its speed, m/s."""
    goal = wanted["gripper"]
    left = length_m(setpoint, goal)
    change = acceleration_m_s2 * interval_s
    # As fast as lets it still stop in time, at this braking and these intervals.
    stopping = float(np.sqrt(2.0 * acceleration_m_s2 * left + change**2 / 4)) - change / 2
    pace = max(min(pace + change, wanted["speed"], stopping), 0.0)
    return along(setpoint, goal, pace * interval_s), pace


class _Detour(NamedTuple):
    """A way by the joints."""

    targets: Floats  # (7,) the joints' angles an interval later, rad
    ends: bool  # whether it goes no farther


def _detour(goal: Floats, belief: Value, blocked: bool, interval_s: float) -> _Detour | None:
    """The way where the arm does not go straight: as it cannot, or as the shortest turn leads the wrist, which has less
    than a whole one, through its end. Then all joints turn to where they are to be, or stay where that is nowhere. What
    has begun so goes on so, until it is to come elsewhere: from its first step the straight way would lead back to
    where it was blocked. None: the straight way is free."""
    turns = belief["turns"] is not None and length_m(belief["turns"], goal) < _ASTRAY
    turn = log_so3(goal[:3, :3] @ belief["setpoint"][:3, :3].T)
    if not blocked and not turns and float(np.linalg.norm(turn)) < WIDE_RAD:
        return None
    targets: Floats = belief["targets"]
    there, off = joints_for(goal, HOME_RAD)
    way = there - targets
    if off > _ASTRAY:
        return _Detour(targets, True) if blocked else None
    # How far the hand, pointing down, turns about the vertical by the joints' way: the same, or by a whole turn less.
    if not blocked and not turns and abs(turn[2] - (way[0] - way[-1])) <= np.pi:
        return None
    part = _TURN_RAD_S * interval_s / max(float(np.abs(way).max()), 1e-12)
    return _Detour(targets + way * min(1.0, part), part >= 1.0)


def _moved(body: Mapping[str, Any], cube: Cube, touch: Touch, interval_s: float) -> dict[str, Any]:
    lift_m = float(cube.pose[2, 3]) - body["floor_m"]
    held = lift_m >= LIFTED_M and touch.fingers and not touch.other
    held_s = body["held_s"] + interval_s if held else 0.0
    return {**body, "pose": cube.pose, "velocity": cube.velocity, "lift_m": lift_m, "held_s": held_s}
