"""Rigid bodies that push one another: pybullet as a pure function of values.

A pybullet client that is only given poses and velocities goes on differently from the one that they came from (it keeps
contacts and solver state), so bodies are taken away and built again from the values at every call: less than a
millisecond for six cubes, and equal to the bit however often and in whichever process it is done."""

import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from importlib import import_module
from math import ceil, inf
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking.math.geometry import Floats, cross, make_pose, quaternion_of, rotation_of

STEP_S = 1.0 / 240.0
MAX_STEPS = 480
TABLE_HALF_M = 10.0
HULL_MARGIN_M = 0.00055
HULL_DIRECTIONS = 240

GRAVITY_M_S2 = 9.81
CARRIES = 0.25  # of a body's weight; what pushes it up by less only touches it

MADE_MOST = 4000
"""So many bodies may have been in a world before it is emptied: of each that is gone pybullet keeps 900 bytes."""


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
        hull = self.vertices if len(self.vertices) <= HULL_DIRECTIONS else support_points(self.vertices)
        # Bullet keeps hulls, unlike boxes, apart by a margin around each.
        shrunk = np.maximum(self.half - HULL_MARGIN_M, 0.5 * self.half) / np.maximum(self.half, 1e-9)
        object.__setattr__(self, "hull", (hull - self.centre) * shrunk)

    @cached_property
    def is_box(self) -> bool:
        """Whether all vertices are corners of the bounding box."""
        return bool(np.allclose(np.abs(self.vertices - self.centre), self.half, atol=1e-6))


class Simulator:
    """Contacts and gravity over a horizontal table, the plane z = 0; its client is a cache."""

    def __init__(self) -> None:
        self._bullet = Bullet()
        self._handles: list[int] | None = None  # of bodies on the table; None: not even that is there
        self._moved: dict[int, float] = {}  # of the bodies of the last call, by handle, what they weigh, kg

    def run(
        self,
        solids: Sequence[Solid],
        motions: Sequence[Motion],
        duration_s: float,
        drives: Mapping[int, Floats] | None = None,
    ) -> list[Motion]:
        """Let bodies fall, slide, push and settle for so many seconds, in equal steps of at most `STEP_S`, at most
        `MAX_STEPS` of them: the motions afterwards. `drives` is by index of a body the horizontal velocity (2,), m/s,
        to which a thread draws it; it pulls against the friction of that body alone."""
        self._moved = {}
        if not solids or duration_s <= 0.0:
            return list(motions)
        steps = min(MAX_STEPS, max(1, ceil(duration_s / STEP_S - 1e-6)))
        step_s = duration_s / steps
        self._clear(step_s)
        handles = [self._create(solid, motion) for solid, motion in zip(solids, motions, strict=True)]
        self._handles = handles
        self._moved = {handle: solid.mass for handle, solid in zip(handles, solids, strict=True)}
        for _ in range(steps):
            for index, drive in (drives or {}).items():
                self._draw_along(handles[index], solids[index], drive, step_s)
            self._bullet.stepSimulation()
        return [self._read(handle, solid) for handle, solid in zip(handles, solids, strict=True)]

    def carried(self) -> list[tuple[int, int | None]]:
        """Which of the bodies of the last call were carried at its end, and by what: pairs of an index and that of the
        other body, None for the table. What carries a body pushes it up by a part of its weight at least."""
        at = {handle: index for index, handle in enumerate(self._moved)}
        if not at:
            return []
        upwards: dict[tuple[int, int], float] = {}
        for _, one, other, *_, normal, _, force in (point[:10] for point in self._bullet.getContactPoints()):
            lift = force * normal[2]  # the normal points from the other one to the first
            pair = (one, other) if lift > 0.0 else (other, one)
            upwards[pair] = upwards.get(pair, 0.0) + abs(lift)
        least = {handle: CARRIES * mass * GRAVITY_M_S2 for handle, mass in self._moved.items()}
        # nothing carries the table, which has no least
        carried = [pair for pair, lift in upwards.items() if lift >= least.get(pair[0], inf)]
        return sorted(
            ((at[upper], at.get(lower)) for upper, lower in carried),
            key=lambda pair: (pair[0], -1 if pair[1] is None else pair[1]),
        )

    def _clear(self, step_s: float) -> None:
        """Have nothing there but the table: to begin anew takes far longer than to take away what is on it."""
        if self._handles is None or self._bullet.is_worn:
            prepare(self._bullet, step_s, [TABLE_HALF_M] * 3, 1.0)
            return
        self._bullet.setPhysicsEngineParameter(fixedTimeStep=step_s)
        remove_bodies(self._bullet, self._handles)
        self._handles = None

    def _create(self, solid: Solid, motion: Motion) -> int:
        bullet = self._bullet
        shape = box_shape(bullet, solid.half.tolist()) if solid.is_box else hull_shape(bullet, solid.hull)
        rotation = motion.pose[:3, :3]
        offset = rotation @ solid.centre
        centre = make_pose(rotation, motion.pose[:3, 3] + offset)
        handle = create_body(bullet, shape, solid.mass, solid.friction, centre)
        linear = motion.velocity[:3] + _turned(motion.velocity[3:], offset)
        bullet.resetBaseVelocity(handle, linear.tolist(), motion.velocity[3:].tolist())
        return handle

    def _draw_along(self, handle: int, solid: Solid, drive: Floats, step_s: float) -> None:
        """Pull at the centre, hard enough to reach the velocity in one step against the table's friction."""
        bullet = self._bullet
        linear = np.array(bullet.getBaseVelocity(handle)[0][:2])
        speed = float(np.linalg.norm(drive))
        against_friction = solid.friction * GRAVITY_M_S2 * drive / speed if speed > 0.0 else np.zeros(2)
        force = solid.mass * ((drive - linear) / step_s + against_friction)
        centre = bullet.getBasePositionAndOrientation(handle)[0]
        bullet.applyExternalForce(handle, -1, [*force.tolist(), 0.0], centre, bullet.WORLD_FRAME)

    def _read(self, handle: int, solid: Solid) -> Motion:
        pose = pose_of(self._bullet, handle)
        linear, angular = (np.array(part) for part in self._bullet.getBaseVelocity(handle))
        offset = pose[:3, :3] @ solid.centre
        pose[:3, 3] -= offset
        return Motion(pose, np.concatenate([linear - _turned(angular, offset), angular]))


def _turned(angular: Floats, offset: Floats) -> Floats:
    """By how much a point so far from the centre moves, m/s."""
    return np.asarray(cross(angular[None], offset[None])[0])


def support_points(vertices: Floats, count: int = HULL_DIRECTIONS) -> Floats:
    """The vertices that are outermost in one of so many directions, spread evenly over the sphere."""
    index = np.arange(count)
    height = 1.0 - (2.0 * index + 1.0) / count
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    directions = np.stack((radius * np.cos(turn), radius * np.sin(turn), height))
    return np.asarray(vertices[np.unique((vertices @ directions).argmax(axis=0))])


class Bullet:
    """pybullet's functions and constants on a world of their own, which begins with the first that is asked for."""

    _client: int | None = None

    def __init__(self) -> None:
        # Handles by form: pybullet keeps shapes when bodies are gone, so equal ones share one.
        self.shapes: dict[tuple[str, bytes], int] = {}
        self.made = 0  # bodies, since the world was empty

    @property
    def is_worn(self) -> bool:
        """Whether its world is to be emptied, as too much is kept of bodies that are gone."""
        return self.made > MADE_MOST

    def __getattr__(self, name: str) -> Any:
        pybullet = _loaded()
        if self._client is None:
            self._client = pybullet.connect(pybullet.DIRECT)
            weakref.finalize(self, pybullet.disconnect, self._client)
        attribute = getattr(pybullet, name)
        return partial(attribute, physicsClientId=self._client) if callable(attribute) else attribute


@cache
def _loaded() -> ModuleType:
    """pybullet, without its greeting: it tells standard error when it was built, once, when it is imported."""
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
    """Empty a client's world but for a table, whose handle is returned: a box of these halves, its top z = 0. A box,
    not a plane: against a plane a box has one contact in its first step, and rocks."""
    bullet.resetSimulation()
    bullet.shapes.clear()
    bullet.made = 0
    bullet.setPhysicsEngineParameter(fixedTimeStep=step_s, deterministicOverlappingPairs=1, **solver)
    bullet.setGravity(0.0, 0.0, -GRAVITY_M_S2)
    table = int(bullet.createMultiBody(0.0, box_shape(bullet, half_m), basePosition=[0.0, 0.0, -half_m[2]]))
    bullet.changeDynamics(table, -1, lateralFriction=friction)
    return table


def box_shape(bullet: Bullet, half_m: Sequence[float]) -> int:
    """The handle of a box's shape, by the halves of its sides, metres."""
    return _shared(bullet, "GEOM_BOX", np.array(half_m), halfExtents=half_m)


def hull_shape(bullet: Bullet, vertices: Floats) -> int:
    """The handle of the shape of points' convex hull, metres."""
    return _shared(bullet, "GEOM_MESH", vertices, vertices=vertices.tolist())


def _shared(bullet: Bullet, geometry: str, form: Floats, **said: Sequence[Any]) -> int:
    key = geometry, form.tobytes()
    if key not in bullet.shapes:
        bullet.shapes[key] = int(bullet.createCollisionShape(getattr(bullet, geometry), **said))
    return bullet.shapes[key]


def create_body(bullet: Bullet, shape: int, mass: float, friction: float, pose: Floats) -> int:
    """The handle of a new body (kg; Coulomb's coefficient) whose centre of mass is at a pose; it does not bounce."""
    bullet.made += 1
    handle = int(bullet.createMultiBody(mass, shape, -1, *place_of(pose)))
    bullet.changeDynamics(handle, -1, lateralFriction=friction, restitution=0.0)
    return handle


def remove_bodies(bullet: Bullet, handles: Sequence[int]) -> None:
    """Take bodies away, the last one first: numbers and places of those to come are then the same again."""
    for handle in reversed(handles):
        bullet.removeBody(handle)


def place_of(pose: Floats) -> tuple[list[float], list[float]]:
    """Position and quaternion of a pose, as pybullet has them."""
    return pose[:3, 3].tolist(), quaternion_of(pose[:3, :3]).tolist()


def pose_of(bullet: Bullet, handle: int) -> Floats:
    """world_from_body."""
    position, quaternion = bullet.getBasePositionAndOrientation(handle)
    return make_pose(rotation_of(quaternion), np.array(position))
