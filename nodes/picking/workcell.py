"""Arm, gripper, table and cubes: pybullet as a pure function of values.

As in `hierax.nodes.tracking.imagery.physics`, what is there is built again from the values at every call; the arm,
which takes longer to build than all else to compute, is put in its place as if it had been built there. What is
lost thereby, the contacts that the solver had, it finds again within a step: a cube that the gripper holds slips by a
fraction of a millimetre a second (docs/decisions/0017). There is no constraint between anything: a cube is held by
friction.

Of pybullet_data's Panda what is only to be seen is left out, which makes building it five times as fast, and the
fingers are boxes: the model's finger is a mesh with a rounded inside, which in its first step against a box has one
point of contact, against which the box turns; a box in its place has four."""

import os
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pybullet_data

from hierax.nodes.picking.panda import JOINTS, TORQUES_NM
from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.imagery.physics import (
    Bullet,
    box_shape,
    create_body,
    place_of,
    pose_of,
    prepare,
    remove_bodies,
)
from hierax.nodes.tracking.math.geometry import Floats, exp_so3, log_so3, make_pose

STEP_HZ = 240
STEP_S = 1.0 / STEP_HZ
DENSITY_KG_M3 = 600.0
CUBE_FRICTION = 0.7
FINGER_FRICTION = 1.0
TABLE_FRICTION = 1.0

GRIP_N = 20.0  # force of each finger
FINGERS = (9, 10)  # joints of the model
# By the name of its link, on which side of the middle a finger is, along the gripper's y.
FINGER_SIDES = {"panda_leftfinger": 1.0, "panda_rightfinger": -1.0}
# The pad and the rest of a finger in its link's frame, lowest and highest corners, measured from the mesh.
FINGER_BOXES_M = (
    ((-0.00875, 0.0, 0.036), (0.00875, 0.0145, 0.0538)),
    ((-0.01045, 0.0075, 0.0), (0.01045, 0.0264, 0.036)),
)
_FINGER_M_S = 0.06
_FINGER_GAIN = 10.0
_CENTRING_N_M = 500.0
_CENTRING_NS_M = 10.0
_SOLVER_ITERATIONS = 100
_GAINS = {"positionGains": [0.15] * JOINTS, "velocityGains": [1.0] * JOINTS}
_TABLE_HALF_M = (2.0, 2.0, 0.5)
_FAR_M = 1000.0

# Somebody's hand: half of its sides, metres; what it weighs, kg; and with how much force it is drawn, and grips, N.
GUEST_HALF_M = np.array([0.03, 0.035, 0.012])
GUEST_KG, GUEST_N, GUEST_GRIP_N, GUEST_FRICTION = 0.4, 80.0, 60.0, 0.4


class Arm(NamedTuple):
    """The arm's joints."""

    joints: Floats  # (7,) radians; `speeds`: (7,) rad/s
    speeds: Floats
    fingers: Floats  # (2,) how far each finger is from the middle, metres; `finger_speeds`: (2,) m/s
    finger_speeds: Floats


class Cube(NamedTuple):
    """A cube: its side in metres, world_from_object, and its velocity (6,), m/s and rad/s in the world's axes."""

    side_m: float
    pose: Floats
    velocity: Floats


class Grip(NamedTuple):
    """What somebody's hand holds: the number of the cube among those given, from 1, and palm_from_cube."""

    cube: int
    holds: Floats


class Guest(NamedTuple):
    """Somebody's hand, a box that is drawn along by a bounded force: world_from_palm and its velocity (6,), between
    which poses it is drawn at an even pace, and what it grips."""

    pose: Floats
    velocity: Floats
    start: Floats
    end: Floats
    grip: Grip | None


class Order(NamedTuple):
    """What the arm's controller does during a call."""

    start: Floats  # start, end: (7,) joint angles, radians, between which the targets go at an even pace
    end: Floats
    width_m: float  # between the finger pads; less than what is between them means to squeeze it


class Touch(NamedTuple):
    """What a cube touches at the end of a call: both fingers; anything else."""

    fingers: bool
    other: bool


class Workcell:
    """An arm over a table with cubes on it; its client is a cache."""

    def __init__(self) -> None:
        self.bullet = Bullet()  # as the last call has left it
        self._robot: int | None = None
        self._foot: tuple[Sequence[float], Sequence[float]] = ((), ())
        self._handles: list[int] = []
        # pybullet reads models from files alone: this one is in memory, and ends with the process.
        self._model = os.memfd_create("panda.urdf")
        weakref.finalize(self, os.close, self._model)
        with open(self._model, "wb", closefd=False) as file:
            file.write(panda_text())

    def run(
        self, arm: Arm, cubes: Sequence[Cube], order: Order, steps: int, guest: Guest | None = None
    ) -> tuple[Arm, list[Cube], list[Touch], Guest | None]:
        """Let the arm follow an order, somebody's hand go its way, and things fall, slide and be held, for so many
        steps of `STEP_S`: how arm, cubes and hand are afterwards, and what each cube then touches."""
        if self._robot is None or guest is not None or self.bullet.is_worn:
            self._robot = self._create_arm()
        robot = self._robot
        remove_bodies(self.bullet, self._handles)
        self._place_arm(robot, arm)
        handles = self._handles = [self._create_cube(cube) for cube in cubes]
        hand = None if guest is None else self._create_guest(guest, handles)
        for step in range(1, steps + 1):
            if guest is not None and hand is not None:
                self._draw_guest(hand, guest, step / steps)
            self._drive_joints(robot, order.start + (order.end - order.start) * (step / steps))
            self._drive_fingers(robot, order.width_m)
            self.bullet.stepSimulation()
        after = [self._read_cube(handle, cube) for handle, cube in zip(handles, cubes, strict=True)]
        touches = [self._touch(handle, robot) for handle in handles]
        left = None if guest is None or hand is None else self._read_guest(hand, guest)
        if guest is not None:
            self._robot = None  # what ties its hand to things goes with the whole client
        return self._read_arm(robot), after, touches, left

    def _create_arm(self) -> int:
        """The arm's handle, in a client that has nothing but it and the table."""
        bullet = self.bullet
        self._handles = []
        iterations = {"numSolverIterations": _SOLVER_ITERATIONS}
        table = prepare(bullet, STEP_S, _TABLE_HALF_M, TABLE_FRICTION, **iterations)
        robot = int(bullet.loadURDF(f"/proc/self/fd/{self._model}", useFixedBase=1))
        # Its foot stands on the table, and is fixed anyhow.
        bullet.setCollisionFilterPair(robot, table, -1, -1, 0)
        # Plain friction: the model's anchors pull back what has slipped, and remember where from.
        plain = {"spinningFriction": 0.0, "frictionAnchor": 0, "contactStiffness": -1, "contactDamping": -1}
        for joint in FINGERS:
            bullet.changeDynamics(robot, joint, lateralFriction=FINGER_FRICTION, **plain)
        self._foot = bullet.getBasePositionAndOrientation(robot)
        return robot

    def _place_arm(self, robot: int, arm: Arm) -> None:
        """Put the arm where it is, as if it had not been anywhere.

        Around each link bullet keeps a box that is wider than the link, and larger where it was: what is in it belongs
        to the link's island, and is solved in another order. A box of what was far away begins anew."""
        bullet = self.bullet
        bullet.resetBasePositionAndOrientation(robot, [0.0, 0.0, _FAR_M], self._foot[1])
        for joint in range(JOINTS):
            bullet.resetJointState(robot, joint, arm.joints[joint], arm.speeds[joint])
        for index, joint in enumerate(FINGERS):
            bullet.resetJointState(robot, joint, arm.fingers[index], arm.finger_speeds[index])
        bullet.performCollisionDetection()
        bullet.resetBasePositionAndOrientation(robot, *self._foot)

    def _create_cube(self, cube: Cube) -> int:
        shape = box_shape(self.bullet, [cube.side_m / 2] * 3)
        handle = create_body(self.bullet, shape, DENSITY_KG_M3 * cube.side_m**3, CUBE_FRICTION, cube.pose)
        self.bullet.resetBaseVelocity(handle, cube.velocity[:3].tolist(), cube.velocity[3:].tolist())
        return handle

    def _create_guest(self, guest: Guest, cubes: Sequence[int]) -> tuple[int, int]:
        """The handles of somebody's hand, and of what draws it along."""
        bullet = self.bullet
        shape = box_shape(bullet, GUEST_HALF_M.tolist())
        hand = create_body(bullet, shape, GUEST_KG, GUEST_FRICTION, guest.pose)
        bullet.resetBaseVelocity(hand, guest.velocity[:3].tolist(), guest.velocity[3:].tolist())
        origin = [0.0, 0.0, 0.0]
        place, turn = place_of(guest.start)
        towards = int(bullet.createConstraint(hand, -1, -1, -1, bullet.JOINT_FIXED, origin, origin, place, None, turn))
        if guest.grip is not None:
            cube = cubes[guest.grip.cube - 1]
            place, turn = place_of(guest.grip.holds)
            fixed = bullet.createConstraint(hand, -1, cube, -1, bullet.JOINT_FIXED, origin, place, origin, turn)
            bullet.changeConstraint(fixed, maxForce=GUEST_GRIP_N)
            bullet.setCollisionFilterPair(hand, cube, -1, -1, 0)
        return hand, towards

    def _draw_guest(self, hand: tuple[int, int], guest: Guest, part: float) -> None:
        way = guest.end[:3, 3] - guest.start[:3, 3]
        turn = log_so3(guest.end[:3, :3] @ guest.start[:3, :3].T)
        place, turned = place_of(make_pose(exp_so3(part * turn) @ guest.start[:3, :3], guest.start[:3, 3] + part * way))
        self.bullet.changeConstraint(hand[1], place, turned, maxForce=GUEST_N)

    def _read_guest(self, hand: tuple[int, int], guest: Guest) -> Guest:
        linear, angular = self.bullet.getBaseVelocity(hand[0])
        return guest._replace(pose=pose_of(self.bullet, hand[0]), velocity=np.array(linear + angular))

    def _drive_joints(self, robot: int, targets: Floats) -> None:
        way = {"targetPositions": targets.tolist(), "forces": TORQUES_NM, **_GAINS}
        self.bullet.setJointMotorControlArray(robot, range(JOINTS), self.bullet.POSITION_CONTROL, **way)

    def _drive_fingers(self, robot: int, width_m: float) -> None:
        """Each finger at a bounded speed and force towards its place; where they squeeze, gently kept in the middle."""
        bullet = self.bullet
        (left, left_speed), (right, right_speed) = (state[:2] for state in bullet.getJointStates(robot, FINGERS))
        uneven = 0.0
        if width_m < left + right:
            uneven = _CENTRING_N_M * (left - right) + _CENTRING_NS_M * (left_speed - right_speed)
            uneven = min(max(uneven, -GRIP_N), GRIP_N)
        for joint, place, force in ((FINGERS[0], left, GRIP_N + uneven), (FINGERS[1], right, GRIP_N - uneven)):
            speed = min(max(_FINGER_GAIN * (width_m / 2 - place), -_FINGER_M_S), _FINGER_M_S)
            bullet.setJointMotorControl2(robot, joint, bullet.VELOCITY_CONTROL, targetVelocity=speed, force=force)

    def _read_arm(self, robot: int) -> Arm:
        joints = self.bullet.getJointStates(robot, range(JOINTS))
        fingers = self.bullet.getJointStates(robot, FINGERS)
        columns = [np.array([state[part] for state in states]) for states in (joints, fingers) for part in (0, 1)]
        return Arm(*columns)

    def _read_cube(self, handle: int, cube: Cube) -> Cube:
        linear, angular = self.bullet.getBaseVelocity(handle)
        return Cube(cube.side_m, pose_of(self.bullet, handle), np.array(linear + angular))

    def _touch(self, handle: int, robot: int) -> Touch:
        points = self.bullet.getContactPoints(handle)
        # body, its link and the force along the normal; those without force are merely near.
        pressed = [(point[2], point[4]) for point in points if point[9] > 0.0]
        parts = {link for body, link in pressed if body == robot}
        others = any(body != robot for body, _ in pressed)
        return Touch(parts.issuperset(FINGERS), others or bool(parts.difference(FINGERS)))


def panda_file() -> Path:
    """The model as it comes with pybullet_data, to be looked at."""
    return Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf"


def panda_text() -> bytes:
    """The model for physics, URDF; its meshes are named by absolute paths. Raises DataError: pybullet_data's model is
    missing or damaged."""
    path = panda_file()
    try:
        robot = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        side = FINGER_SIDES.get(link.get("name", ""))
        if side is not None:
            _with_boxes(link, side)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").replace("package://", f"{path.parent}{os.sep}"))
    return ElementTree.tostring(robot)


def _with_boxes(link: ElementTree.Element, side: float) -> None:
    """Put the boxes of a finger in the place of its mesh."""
    for collision in link.findall("collision"):
        link.remove(collision)
    for low, high in np.array(FINGER_BOXES_M):
        box = ((low + high) / 2 * (1, side, 1), high - low)
        middle, size = (" ".join(f"{number:.9f}" for number in each) for each in box)
        collision = ElementTree.SubElement(link, "collision")
        ElementTree.SubElement(collision, "origin", rpy="0 0 0", xyz=middle)
        ElementTree.SubElement(ElementTree.SubElement(collision, "geometry"), "box", size=size)
