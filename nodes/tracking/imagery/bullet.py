"""pybullet's clients, without the greeting: it tells standard error when it was built, once, when it is imported."""

from __future__ import annotations

import os
import weakref
from collections.abc import Sequence
from functools import cache, partial
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, make_pose, quaternion_of, rotation_of

GRAVITY_M_S2 = 9.81


class Bullet:
    """pybullet's functions and constants on a world of their own, which begins with the first that is asked for."""

    _client: int | None = None

    def __getattr__(self, name: str) -> Any:
        pybullet = _loaded()
        if self._client is None:
            self._client = pybullet.connect(pybullet.DIRECT)
            weakref.finalize(self, pybullet.disconnect, self._client)
        attribute = getattr(pybullet, name)
        return partial(attribute, physicsClientId=self._client) if callable(attribute) else attribute


@cache
def _loaded() -> ModuleType:
    try:
        kept = os.dup(2)
    except OSError:  # no standard error to keep clean
        return import_module("pybullet")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        return import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(nowhere)
        os.close(kept)


def prepare(bullet: Bullet, step_s: float, half_m: Sequence[float], friction: float, **solver: int) -> int:
    """Empty a client's world but for a table, whose handle is returned: a box of these halves, its top z = 0.

    A box, not a plane: against a plane a box has one contact in its first step, and rocks.
    """
    bullet.resetSimulation()
    bullet.setPhysicsEngineParameter(fixedTimeStep=step_s, deterministicOverlappingPairs=1, **solver)
    bullet.setGravity(0.0, 0.0, -GRAVITY_M_S2)
    slab = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_m)
    table = int(bullet.createMultiBody(0.0, slab, basePosition=[0.0, 0.0, -half_m[2]]))
    bullet.changeDynamics(table, -1, lateralFriction=friction)
    return table


def box_shape(bullet: Bullet, half_m: Sequence[float]) -> int:
    """The handle of a box's shape, by the halves of its sides, metres."""
    return int(bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_m))


def hull_shape(bullet: Bullet, vertices: Floats) -> int:
    """The handle of the shape of points' convex hull, metres."""
    return int(bullet.createCollisionShape(bullet.GEOM_MESH, vertices=vertices.tolist()))


def create_body(bullet: Bullet, shape: int, mass: float, friction: float, pose: Floats) -> int:
    """The handle of a new body (kg; Coulomb's coefficient) whose centre of mass is at a pose; it does not bounce."""
    place = pose[:3, 3].tolist(), quaternion_of(pose[:3, :3]).tolist()
    handle = int(bullet.createMultiBody(mass, shape, -1, *place))
    bullet.changeDynamics(handle, -1, lateralFriction=friction, restitution=0.0)
    return handle


def pose_of(bullet: Bullet, handle: int) -> Floats:
    """world_from_body."""
    position, quaternion = bullet.getBasePositionAndOrientation(handle)
    return make_pose(rotation_of(quaternion), np.array(position))
