"""Arm, gripper, table and cubes: pybullet as a pure function of values.

As in `hierax.nodes.tracking.imagery.physics`, the client is emptied and built again from the values
at every call. What is lost thereby, the contacts that the solver had, it finds again within
a step: a cube that the gripper holds slips by a fraction of a millimetre a second
(docs/decisions/0017). There is no constraint between anything: a cube is held by friction.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.picking.panda import JOINTS, TORQUES_NM
from hierax.nodes.picking.panda_model import panda_text
from hierax.nodes.tracking.imagery.bullet import load_pybullet
from hierax.nodes.tracking.math.geometry import Floats, make_pose, quaternion_of, rotation_of

STEP_HZ = 240
STEP_S = 1.0 / STEP_HZ
GRAVITY_M_S2 = 9.81
DENSITY_KG_M3 = 600.0
CUBE_FRICTION = 0.7
FINGER_FRICTION = 1.0
TABLE_FRICTION = 1.0

GRIP_N = 20.0  # force of each finger
_FINGERS = (9, 10)
_FINGER_M_S = 0.06
_FINGER_GAIN = 10.0
_CENTRING_N_M = 500.0
_CENTRING_NS_M = 10.0
_SOLVER_ITERATIONS = 100
_TABLE_HALF_M = (2.0, 2.0, 0.5)


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
        self._pybullet = load_pybullet()
        self._client: int | None = None
        # pybullet reads models from files alone: this one is in memory, and ends with the process.
        self._model = os.memfd_create("panda.urdf")
        weakref.finalize(self, os.close, self._model)
        with open(self._model, "wb", closefd=False) as file:
            file.write(panda_text())

    def run(self, arm: Arm, cubes: Sequence[Cube], order: Order, steps: int) -> tuple[Arm, list[Cube], list[Touch]]:
        """Let the arm move and things fall, slide and be held.

        Args:
            arm, cubes: as they are.
            order: what the arm is to do.
            steps: how long, in steps of `STEP_S`.

        Returns:
            How arm and cubes are afterwards, and what each cube then touches.
        """
        if self._client is None:
            self._client = self._pybullet.connect(self._pybullet.DIRECT)
            weakref.finalize(self, self._pybullet.disconnect, self._client)
        table = self._prepare()
        robot = self._create_arm(arm, table)
        handles = [self._create_cube(cube) for cube in cubes]
        for step in range(1, steps + 1):
            self._drive_joints(robot, order.start + (order.end - order.start) * (step / steps))
            self._drive_fingers(robot, order.width_m)
            self._pybullet.stepSimulation(**self._here)
        after = [self._read_cube(handle, cube) for handle, cube in zip(handles, cubes, strict=True)]
        return self._read_arm(robot), after, [self._touch(handle, robot) for handle in handles]

    def constraints(self) -> int:
        """How many constraints hold things together in the client: none, ever."""
        if self._client is None:
            return 0
        return int(self._pybullet.getNumConstraints(**self._here))

    @property
    def _here(self) -> dict[str, Any]:
        return {"physicsClientId": self._client}

    def _prepare(self) -> int:
        pybullet, client = self._pybullet, self._here
        pybullet.resetSimulation(**client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=STEP_S, deterministicOverlappingPairs=1, numSolverIterations=_SOLVER_ITERATIONS, **client
        )
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, **client)
        slab = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=_TABLE_HALF_M, **client)
        table: int = pybullet.createMultiBody(0.0, slab, basePosition=[0.0, 0.0, -_TABLE_HALF_M[2]], **client)
        pybullet.changeDynamics(table, -1, lateralFriction=TABLE_FRICTION, **client)
        return table

    def _create_arm(self, arm: Arm, table: int) -> int:
        pybullet, client = self._pybullet, self._here
        robot: int = pybullet.loadURDF(f"/proc/self/fd/{self._model}", useFixedBase=1, **client)
        # Its foot stands on the table, and is fixed anyhow.
        pybullet.setCollisionFilterPair(robot, table, -1, -1, 0, **client)
        for joint in range(JOINTS):
            pybullet.resetJointState(robot, joint, arm.joints[joint], arm.speeds[joint], **client)
        for index, joint in enumerate(_FINGERS):
            pybullet.resetJointState(robot, joint, arm.fingers[index], arm.finger_speeds[index], **client)
            # Plain friction: the model's anchors pull back what has slipped, and remember where from.
            pybullet.changeDynamics(
                robot,
                joint,
                lateralFriction=FINGER_FRICTION,
                spinningFriction=0.0,
                frictionAnchor=0,
                contactStiffness=-1,
                contactDamping=-1,
                **client,
            )
        return robot

    def _create_cube(self, cube: Cube) -> int:
        pybullet, client = self._pybullet, self._here
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[cube.side_m / 2] * 3, **client)
        handle: int = pybullet.createMultiBody(
            DENSITY_KG_M3 * cube.side_m**3,
            shape,
            -1,
            cube.pose[:3, 3].tolist(),
            quaternion_of(cube.pose[:3, :3]).tolist(),
            **client,
        )
        pybullet.resetBaseVelocity(handle, cube.velocity[:3].tolist(), cube.velocity[3:].tolist(), **client)
        pybullet.changeDynamics(handle, -1, lateralFriction=CUBE_FRICTION, restitution=0.0, **client)
        return handle

    def _drive_joints(self, robot: int, targets: Floats) -> None:
        for joint in range(JOINTS):
            self._pybullet.setJointMotorControl2(
                robot,
                joint,
                self._pybullet.POSITION_CONTROL,
                targetPosition=targets[joint],
                positionGain=0.15,
                velocityGain=1.0,
                force=TORQUES_NM[joint],
                **self._here,
            )

    def _drive_fingers(self, robot: int, width_m: float) -> None:
        """Each finger at a bounded speed and force towards its place; where they squeeze, gently kept in the middle."""
        pybullet, client = self._pybullet, self._here
        (left, left_speed), (right, right_speed) = (
            state[:2] for state in pybullet.getJointStates(robot, _FINGERS, **client)
        )
        uneven = 0.0
        if width_m < left + right:
            uneven = _CENTRING_N_M * (left - right) + _CENTRING_NS_M * (left_speed - right_speed)
            uneven = min(max(uneven, -GRIP_N), GRIP_N)
        for joint, place, force in ((_FINGERS[0], left, GRIP_N + uneven), (_FINGERS[1], right, GRIP_N - uneven)):
            speed = _FINGER_GAIN * (width_m / 2 - place)
            pybullet.setJointMotorControl2(
                robot,
                joint,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=min(max(speed, -_FINGER_M_S), _FINGER_M_S),
                force=force,
                **client,
            )

    def _read_arm(self, robot: int) -> Arm:
        joints = self._pybullet.getJointStates(robot, range(JOINTS), **self._here)
        fingers = self._pybullet.getJointStates(robot, _FINGERS, **self._here)
        columns = [np.array([state[part] for state in states]) for states in (joints, fingers) for part in (0, 1)]
        return Arm(*columns)

    def _read_cube(self, handle: int, cube: Cube) -> Cube:
        position, quaternion = self._pybullet.getBasePositionAndOrientation(handle, **self._here)
        linear, angular = self._pybullet.getBaseVelocity(handle, **self._here)
        return Cube(cube.side_m, make_pose(rotation_of(quaternion), np.array(position)), np.array(linear + angular))

    def _touch(self, handle: int, robot: int) -> Touch:
        points = self._pybullet.getContactPoints(handle, **self._here)
        # body, its link and the force along the normal; those without force are merely near.
        pressed = [(point[2], point[4]) for point in points if point[9] > 0.0]
        parts = {link for body, link in pressed if body == robot}
        others = any(body != robot for body, _ in pressed)
        return Touch(parts.issuperset(_FINGERS), others or bool(parts.difference(_FINGERS)))
