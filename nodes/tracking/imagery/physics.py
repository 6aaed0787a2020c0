"""Rigid bodies that push one another: pybullet as a pure function of values.

A pybullet client that is only given poses and velocities goes on differently from the one that they came from (it keeps
contacts and solver state), so it is emptied and built again from the values at every call: about a millisecond for six
cubes, and equal to the bit however often and in whichever process it is done.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking.imagery.bullet import load_pybullet
from hierax.nodes.tracking.math.geometry import Floats, make_pose, quaternion_of, rotation_of

GRAVITY_M_S2 = 9.81
STEP_S = 1.0 / 240.0
MAX_STEPS = 480
TABLE_HALF_M = 10.0
HULL_MARGIN_M = 0.00055
HULL_DIRECTIONS = 240


class Motion(NamedTuple):
    """Where a body is and how it moves."""

    pose: Floats  # world_from_object, 4x4
    velocity: Floats  # linear (m/s) of the object's origin and angular (rad/s), both in the world frame, (6,)


@dataclass(frozen=True)
class Solid:
    """A body's shape and matter, all that contacts depend on."""

    # (n, 3), metres, in the object frame; the shape is their convex hull, of large meshes approximately
    vertices: Floats
    mass: float  # kg, evenly spread over the shape's bounding box
    friction: float = 0.7  # Coulomb's coefficient; that of two bodies in contact is the product
    centre: Floats = field(init=False)
    half: Floats = field(init=False)
    hull: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        object.__setattr__(self, "centre", (low + high) / 2)
        object.__setattr__(self, "half", (high - low) / 2)
        hull = self.vertices if len(self.vertices) <= HULL_DIRECTIONS else _support_points(self.vertices)
        # Bullet keeps hulls, unlike boxes, apart by a margin around each.
        shrunk = np.maximum(self.half - HULL_MARGIN_M, 0.5 * self.half) / np.maximum(self.half, 1e-9)
        object.__setattr__(self, "hull", (hull - self.centre) * shrunk)

    @property
    def is_box(self) -> bool:
        """Whether all vertices are corners of the bounding box."""
        return bool(np.allclose(np.abs(self.vertices - self.centre), self.half, atol=1e-6))


class Simulator:
    """Contacts and gravity over a horizontal table, the plane z = 0; its client is a cache."""

    def __init__(self) -> None:
        self._pybullet = load_pybullet()
        self._client: int | None = None

    def run(
        self,
        solids: Sequence[Solid],
        motions: Sequence[Motion],
        duration_s: float,
        drives: Mapping[int, Floats] | None = None,
    ) -> list[Motion]:
        """Let bodies fall, slide, push and settle.

        Args:
            solids, motions: of each body, in the same order.
            duration_s: how long, in seconds; done in equal steps of at most `STEP_S`, at most `MAX_STEPS` of them.
            drives: by index of a body, the horizontal velocity (2,), m/s, to which a thread
                draws it; it pulls against the friction of that body alone.

        Returns:
            The motions afterwards.
        """
        if not solids or duration_s <= 0.0:
            return list(motions)
        if self._client is None:
            self._client = self._pybullet.connect(self._pybullet.DIRECT)
            weakref.finalize(self, self._pybullet.disconnect, self._client)
        steps = min(MAX_STEPS, max(1, ceil(duration_s / STEP_S - 1e-6)))
        step_s = duration_s / steps
        self._prepare(step_s)
        handles = [self._create(solid, motion) for solid, motion in zip(solids, motions, strict=True)]
        for _ in range(steps):
            for index, drive in (drives or {}).items():
                self._draw_along(handles[index], solids[index], drive, step_s)
            self._pybullet.stepSimulation(physicsClientId=self._client)
        return [self._read(handle, solid) for handle, solid in zip(handles, solids, strict=True)]

    @property
    def _here(self) -> dict[str, Any]:
        return {"physicsClientId": self._client}

    def _prepare(self, step_s: float) -> None:
        pybullet, client = self._pybullet, self._here
        pybullet.resetSimulation(**client)
        pybullet.setPhysicsEngineParameter(fixedTimeStep=step_s, deterministicOverlappingPairs=1, **client)
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, **client)
        # A box, not a plane: against a plane a box has one contact in its first step, and rocks.
        half = [TABLE_HALF_M] * 3
        slab = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, **client)
        table = pybullet.createMultiBody(0.0, slab, basePosition=[0.0, 0.0, -TABLE_HALF_M], **client)
        pybullet.changeDynamics(table, -1, lateralFriction=1.0, **client)

    def _create(self, solid: Solid, motion: Motion) -> int:
        pybullet, client = self._pybullet, self._here
        if solid.is_box:
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=solid.half.tolist(), **client)
        else:
            shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=solid.hull.tolist(), **client)
        rotation = motion.pose[:3, :3]
        offset = rotation @ solid.centre
        handle: int = pybullet.createMultiBody(
            solid.mass, shape, -1, (motion.pose[:3, 3] + offset).tolist(), quaternion_of(rotation).tolist(), **client
        )
        linear = motion.velocity[:3] + np.cross(motion.velocity[3:], offset)
        pybullet.resetBaseVelocity(handle, linear.tolist(), motion.velocity[3:].tolist(), **client)
        pybullet.changeDynamics(handle, -1, lateralFriction=solid.friction, restitution=0.0, **client)
        return handle

    def _draw_along(self, handle: int, solid: Solid, drive: Floats, step_s: float) -> None:
        """Pull at the centre, hard enough to reach the velocity in one step against the table's friction."""
        pybullet, client = self._pybullet, self._here
        linear = np.array(pybullet.getBaseVelocity(handle, **client)[0][:2])
        speed = float(np.linalg.norm(drive))
        against_friction = solid.friction * GRAVITY_M_S2 * drive / speed if speed > 0.0 else np.zeros(2)
        force = solid.mass * ((drive - linear) / step_s + against_friction)
        centre = pybullet.getBasePositionAndOrientation(handle, **client)[0]
        pybullet.applyExternalForce(handle, -1, [*force.tolist(), 0.0], centre, pybullet.WORLD_FRAME, **client)

    def _read(self, handle: int, solid: Solid) -> Motion:
        pybullet, client = self._pybullet, self._here
        position, quaternion = pybullet.getBasePositionAndOrientation(handle, **client)
        linear, angular = (np.array(part) for part in pybullet.getBaseVelocity(handle, **client))
        rotation = rotation_of(quaternion)
        offset = rotation @ solid.centre
        pose = make_pose(rotation, np.array(position) - offset)
        return Motion(pose, np.concatenate([linear - np.cross(angular, offset), angular]))


def _support_points(vertices: Floats) -> Floats:
    """The vertices that are outermost in one of `HULL_DIRECTIONS` directions, spread evenly over the sphere."""
    index = np.arange(HULL_DIRECTIONS)
    height = 1.0 - (2.0 * index + 1.0) / HULL_DIRECTIONS
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    directions = np.stack((radius * np.cos(turn), radius * np.sin(turn), height))
    outermost: Floats = vertices[np.unique((vertices @ directions).argmax(axis=0))]
    return outermost
